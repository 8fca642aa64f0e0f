import os

import numpy as np
import pytest

from sim.files import read_json, sweep, write_array, write_arrays, write_atomic, write_json


def test_a_failed_write_leaves_the_old_file(tmp_path):
    path = tmp_path / "value.json"
    write_json(path, {"a": 1})

    def fail(part):
        part.write_text("half")
        raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        write_atomic(path, fail)
    assert read_json(path) == {"a": 1}
    sweep(tmp_path)
    assert os.listdir(tmp_path) == ["value.json"]


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
