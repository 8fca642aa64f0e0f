"""The TUM format, read back by evo."""

from pathlib import Path

import numpy as np
from evo.tools import file_interface

from deepgps.tracking.track import is_tum, write_tum


def test_evo_reads_what_was_written(tmp_path: Path):
    rng = np.random.default_rng(0)
    time, pose = np.arange(20) * 0.1 + 1.7e9, rng.uniform(-3.0, 3.0, (20, 3))
    pose[4] = np.nan
    write_tum(tmp_path / "path.tum", time, pose)
    read = file_interface.read_tum_trajectory_file(tmp_path / "path.tum")
    kept = np.isfinite(pose).all(axis=1)
    assert np.allclose(read.timestamps, time[kept])
    assert np.allclose(read.positions_xyz[:, :2], pose[kept, :2], atol=1e-8)
    assert np.allclose(read.get_orientations_euler()[:, 2], pose[kept, 2], atol=1e-8)
    assert is_tum((tmp_path / "path.tum").read_bytes())
    assert not is_tum(b"0 0 0 0 0 0 0 1\n")


def test_positions_without_yaw_look_along_x(tmp_path: Path):
    write_tum(tmp_path / "path.tum", np.arange(3.0), np.ones((3, 2)))
    assert (tmp_path / "path.tum").read_text().splitlines()[1] == "0.000000 1 1 0 0 0 0 1"
