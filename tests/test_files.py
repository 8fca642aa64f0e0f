import errno
import json
import os
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.errors import DamagedError, InputError, WorkError
from sim.files import (
    check_overwrite,
    check_sum,
    read_arrays,
    read_json,
    remove_files,
    sweep,
    write_array,
    write_arrays,
    write_atomic,
    write_json,
    write_sum,
)


def test_a_failed_write_leaves_the_old_file(tmp_path):
    path = tmp_path / "value.json"
    write_json(path, {"a": 1})

    def fail(part):
        part.write_text("half")
        raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        write_atomic(path, fail)
    assert read_json(path) == {"a": 1}
    (tmp_path / "movie.1.deepgps-part").write_text("a user's")
    sweep(tmp_path, re.compile(r"value\.json"))
    assert sorted(os.listdir(tmp_path)) == ["movie.1.deepgps-part", "value.json"]


def test_equal_arrays_give_equal_bytes(tmp_path):
    for name in ("one", "two"):
        write_arrays(tmp_path / f"{name}.npz", {"x": np.arange(5), "y": np.eye(2)})
        write_array(tmp_path / f"{name}.npy", np.arange(5))
    assert (tmp_path / "one.npz").read_bytes() == (tmp_path / "two.npz").read_bytes()
    assert (tmp_path / "one.npy").read_bytes() == (tmp_path / "two.npy").read_bytes()


def test_objects_are_never_pickled(tmp_path):
    with pytest.raises(ValueError, match="allow_pickle"):
        write_array(tmp_path / "x.npy", np.array([{}]))
    assert not (tmp_path / "x.npy").exists()


VALUE = {"a": 1, "text": "é", "list": [0.1, None, True], "group": {"b": 2.5}}


def flip(path: Path, bit: int) -> None:
    data = bytearray(path.read_bytes())
    data[bit // 8 % len(data)] ^= 1 << bit % 8
    path.write_bytes(data)


@given(bit=st.integers(0, 10**6))
def test_a_flipped_bit_of_json_is_found_or_changes_no_value(tmp_path_factory: pytest.TempPathFactory, bit: int):
    path = tmp_path_factory.mktemp("json") / "value.json"
    write_json(path, VALUE)
    flip(path, bit)
    try:
        read = read_json(path)
    except DamagedError as error:
        assert str(path) in str(error)
    else:
        assert {name: read[name] for name in VALUE} == VALUE


@given(bit=st.integers(0, 10**6))
def test_a_flipped_bit_of_arrays_is_found_or_changes_no_array(tmp_path_factory: pytest.TempPathFactory, bit: int):
    path = tmp_path_factory.mktemp("npz") / "arrays.npz"
    arrays = {"x": np.arange(7), "y": np.eye(2)}
    write_arrays(path, arrays)
    flip(path, bit)
    try:
        read = read_arrays(path)
    except DamagedError as error:
        assert str(path) in str(error)
    else:
        assert all(np.array_equal(read[name], arrays[name]) for name in arrays)


def test_json_of_an_earlier_version_has_no_checksum_and_is_read(tmp_path: Path):
    (tmp_path / "old.json").write_text(json.dumps(VALUE))
    assert read_json(tmp_path / "old.json") == VALUE


def test_a_sum_beside_a_file_tells_whether_it_changed(tmp_path: Path):
    path = tmp_path / "table.parquet"
    path.write_bytes(b"figures")
    check_sum(path)  # an earlier version wrote none
    write_sum(path)
    check_sum(path)
    flip(path, 3)
    with pytest.raises(DamagedError, match=r"table\.parquet"):
        check_sum(path)


def test_a_full_disk_names_the_file_and_leaves_no_part(tmp_path: Path):
    def fill(part: Path) -> None:
        part.write_bytes(b"x" * 1000)
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with pytest.raises(WorkError, match=r"value\.bin .*No space left.*2\.0 MB are needed.*are free"):
        write_atomic(tmp_path / "value.bin", fill, 2_000_000)
    assert not any(tmp_path.iterdir())


def test_only_files_of_ours_are_removed_and_links_are_not_followed(tmp_path: Path):
    ours, folder, outside = (
        re.compile(r"value\.json|runs/[0-9a-f]{8}/a\.npy|link"),
        tmp_path / "f",
        tmp_path / "outside",
    )
    outside.mkdir()
    (outside / "value.json").write_text("theirs")
    kept = ["notes.txt", "runs/deadbeef/notes.txt", "runs/mine/a.npy", "value.json.bak", "empty/value.json/x"]
    gone = ["value.json", "value.json.7.deepgps-part", "runs/deadbeef/a.npy", "runs/00000000/a.npy"]
    for name in kept + gone:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(name)
    (folder / "link").symlink_to(outside)
    (folder / "other").symlink_to(outside)
    remove_files(folder, ours)
    left = sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if not path.is_dir() or path.is_symlink())
    assert left == sorted([*kept, "other"])
    assert not (folder / "runs/00000000").exists()
    assert (outside / "value.json").read_text() == "theirs"


def test_nothing_is_written_over_that_is_not_ours(tmp_path: Path):
    path = tmp_path / "rooms.png"
    check_overwrite(path, lambda data: False)
    path.write_bytes(b"holiday")
    with pytest.raises(InputError, match="did not write it"):
        check_overwrite(path, lambda data: data == b"ours")
    path.write_bytes(b"ours")
    check_overwrite(path, lambda data: data == b"ours")
