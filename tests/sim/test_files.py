import errno
import os
import re
import resource
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.errors import DamagedError, InputError, WorkError
from sim.files.atomic import check_overwrite, check_space, remove_files, sweep, write_atomic
from sim.files.checksums import (
    check_sum,
    read_arrays,
    read_json,
    write_array,
    write_arrays,
    write_blocks,
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


def test_whatever_ends_a_write_no_part_stays(tmp_path):
    for error in (KeyboardInterrupt, SystemExit, InputError, WorkError, RuntimeError):

        def fail(part: Path, error=error) -> None:
            part.write_text("half")
            raise error

        with pytest.raises(error):
            write_atomic(tmp_path / "x", fail)
        assert not any(tmp_path.iterdir())


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


def test_a_sum_beside_a_file_tells_whether_it_changed(tmp_path: Path):
    for name in (b"table.parquet", "Möbel.csv".encode(), b"M\xf6bel.csv"):
        path = tmp_path / os.fsdecode(name)
        path.write_bytes(b"figures")
        check_sum(path)  # it has none
        write_sum(path)
        check_sum(path)
        assert path.with_name(f"{path.name}.sha256").read_bytes()[64:] == b"  " + name + b"\n"
        flip(path, 3)
        with pytest.raises(DamagedError, match=re.escape(path.name)):
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


def test_blocks_give_the_bytes_of_the_whole_and_too_few_are_no_file(tmp_path):
    with pytest.raises(ValueError, match="blocks of 2 bytes for an array of 5"):
        write_blocks(tmp_path / "x.npy", (5,), np.dtype(np.uint8), [np.zeros(2, np.uint8)])
    assert not list(tmp_path.iterdir())
    for shape in ((0, 3), (5,), (5, 3, 2)):
        array = np.random.default_rng(0).integers(0, 255, shape).astype(np.uint8)
        write_array(tmp_path / "whole.npy", array)
        write_blocks(tmp_path / "blocks.npy", shape, array.dtype, (array[at : at + 2] for at in range(0, 5, 2)))
        assert (tmp_path / "whole.npy").read_bytes() == (tmp_path / "blocks.npy").read_bytes()


def write_in_a_library_of_its_own(part: Path) -> None:
    """Fail as torch, safetensors and Rerun do: with an error that says nothing of the disk."""
    try:
        part.write_bytes(bytes(1 << 20))
    except OSError:
        raise RuntimeError("writer failed") from None


@contextmanager
def largest_file(size: int) -> Iterator[None]:
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_file_for_which_there_is_no_space_is_one_clear_line(tmp_path):
    path = tmp_path / "x.npy"
    path.write_text("old")
    for write in (
        lambda: write_array(path, np.zeros(1 << 20)),
        lambda: write_arrays(path, {"x": np.zeros(1 << 20)}),
        lambda: write_blocks(path, (1 << 20,), np.dtype(np.uint8), [np.zeros(1 << 20, np.uint8)]),
        lambda: write_atomic(path, write_in_a_library_of_its_own),
    ):
        complaint = rf"{path} cannot be written: File too large; at least .* are needed; with a higher"
        with largest_file(1 << 16), pytest.raises(WorkError, match=complaint):
            write()
        assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == {"x.npy": b"old"}


def test_an_error_is_no_full_disk_where_the_rest_has_space(tmp_path):
    for written_mb in (0, 2, 3):

        def fail(part: Path, written_mb=written_mb) -> None:
            part.write_bytes(bytes(written_mb << 20))
            raise RuntimeError("writer failed")

        with largest_file(4 << 20), pytest.raises(RuntimeError, match="writer failed"):
            write_atomic(tmp_path / "x", fail, 4 << 20)
        assert not any(tmp_path.iterdir())


@pytest.mark.skipif(os.geteuid() != 0, reason="only root mounts a small disk")
def test_a_full_disk_ends_no_process(tmp_path):
    disk, array = tmp_path / "disk", np.zeros((100, 1000), np.uint8)
    disk.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", disk], check=False).returncode:
        pytest.skip("no disk can be mounted here")
    try:
        with pytest.raises(
            WorkError, match=r"No space left on device; at least .* are needed and 65536 bytes are free"
        ):
            write_blocks(disk / "x.npy", array.shape, array.dtype, [array])
        with pytest.raises(WorkError, match="No space left on device"):
            check_space(disk / "below" / "x.npy", 1 << 17)
        subprocess.run(["mount", "-o", "remount,size=1m", disk], check=True)
        write_blocks(disk / "x.npy", array.shape, array.dtype, [array])
        np.testing.assert_array_equal(np.load(disk / "x.npy"), array)
    finally:
        subprocess.run(["umount", disk], check=True)


def test_no_bit_of_an_archive_changes_or_hides_an_array_unnoticed(tmp_path):
    arrays = {"x": np.arange(3.0), "name": np.array("mesa"), "y": np.eye(2, dtype=bool)}
    path = tmp_path / "x.npz"
    write_arrays(path, arrays)
    whole, found = path.read_bytes(), 0
    for place in range(len(whole)):
        data = bytearray(whole)
        data[place] ^= 1 << place % 8
        path.write_bytes(data)
        try:
            read = read_arrays(path)
        except DamagedError:
            found += 1
        else:
            assert {name: array.tobytes() for name, array in read.items()} == {
                name: array.tobytes() for name, array in arrays.items()
            }
    assert found > len(whole) / 2
