"""Trajectories for other tools: evo reads them and measures the same errors; CSV holds what the poses are."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from evo.core import metrics, sync
from evo.tools import file_interface

import deepgps
from deepgps.positioner.pose import Poses
from deepgps.robot_io.trajectories import Trajectory, find_trajectories, open_drives, write_table, write_trajectories
from deepgps.terminal.progress import ignore
from sim.alignment import fit_alignment
from sim.errors import InputError
from sim.recording.format import open_truth


@pytest.fixture(scope="module")
def run(finished_run: Path) -> deepgps.Run:
    return deepgps.load(finished_run)


def measure_by_evo(folder: Path, method: str, align: bool) -> float:
    """RMS of the absolute error of positions [m], by evo."""
    pair = [file_interface.read_tum_trajectory_file(str(folder / f"{name}.tum")) for name in ("truth", method)]
    truth, found = sync.associate_trajectories(*pair)
    if align:
        found.align(truth)
    error = metrics.APE(metrics.PoseRelation.translation_part)
    error.process_data((truth, found))
    return error.get_statistic(metrics.StatisticsType.rmse)


@pytest.mark.parametrize("frame", ["world", "map"])
def test_evo_measures_the_same_error(run: deepgps.Run, frame: deepgps.api.run.Frame, tmp_path: Path):
    write_trajectories(tmp_path, find_trajectories(run, None, frame, ignore), ["tum"])
    images, truth = run.recording.observation, open_truth(run.folder / "recording").pose
    for method in run.methods:
        position = run.position(images, method, frame)
        if frame == "map":
            position = fit_alignment(position, truth[:, :2], "E2").apply(position)
        rms = np.sqrt(np.mean(np.sum((position - truth[:, :2]) ** 2, axis=1)))
        assert measure_by_evo(tmp_path / "tum" / "training", method, frame == "map") == pytest.approx(rms, abs=1e-6)


def test_csv_holds_the_poses(run: deepgps.Run, tmp_path: Path):
    write_trajectories(tmp_path, find_trajectories(run, "deepgps_compass", "world", ignore), ["csv"])
    with (tmp_path / "csv" / "training" / "deepgps_compass.csv").open() as file:
        rows = list(csv.DictReader(file))
    pose, time_s = run.pose(run.recording.observation, "deepgps_compass"), run.recording.observation_time
    assert pose.yaw is not None and time_s is not None and len(rows) == len(pose.position)
    read = np.array([[row[name] or np.nan for name in ("time_s", "x_m", "y_m", "yaw_rad")] for row in rows], float)
    order = np.argsort(time_s, kind="stable")
    expected = np.column_stack([time_s, pose.position, pose.yaw])[order]
    np.testing.assert_allclose(read, expected, atol=1e-6)
    assert (tmp_path / "csv" / "training" / "truth.csv").read_text().startswith("time_s,x_m,y_m,yaw_rad\n")
    poses = Poses(np.zeros((2, 2)), yaw=np.array([np.nan, 1.0]), accepted=np.array([True, False]))
    write_table(tmp_path / "one.csv", Trajectory("use", "deepgps", np.array([1.5, 1e9]), poses))
    assert (tmp_path / "one.csv").read_text().splitlines()[1:] == ["1.500000,0,0,,1", "1000000000.000000,0,0,1,0"]


def test_observations_without_times_have_no_trajectory(run: deepgps.Run):
    recording = replace(run.recording, observation_time=np.full(len(run.recording.observation), np.nan))
    without = deepgps.load(run.folder)
    vars(without)["recording"] = recording  # where a cached property keeps its value
    with pytest.raises(InputError, match="has no times of its observations, which a trajectory needs"):
        find_trajectories(without, None, None, ignore)
    assert list(open_drives(run)) == ["training", "use"]
