"""Trajectories for other tools: evo reads them and measures the same errors."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from evo.core import metrics, sync
from evo.tools import file_interface

import deepgps
from deepgps.robot_io.trajectories import write_trajectories
from deepgps.terminal.progress import ignore
from sim.alignment import fit_alignment
from sim.errors import InputError
from sim.recording.format import open_truth
from sim.recording.manifest import Manifest


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
    write_trajectories(tmp_path, run, None, frame, ignore)
    images, truth = run.recording.observation, open_truth(run.folder / "recording").pose
    for method in run.methods:
        position = run.position(images, method, frame)
        if frame == "map":
            position = fit_alignment(position, truth[:, :2], "E2").apply(position)
        rms = np.sqrt(np.mean(np.sum((position - truth[:, :2]) ** 2, axis=1)))
        assert measure_by_evo(tmp_path / "training", method, frame == "map") == pytest.approx(rms, abs=1e-6)


def test_observations_without_times_have_no_trajectory(run: deepgps.Run, tmp_path: Path):
    recording = replace(run.recording, observation_time=np.full(len(run.recording.observation), np.nan))
    without = deepgps.load(run.folder)
    vars(without)["recording"] = recording  # where a cached property keeps its value
    with pytest.raises(InputError, match="has no times of its observations, which a trajectory needs"):
        write_trajectories(tmp_path, without, None, None, ignore)
    assert not list(tmp_path.iterdir())


def test_times_count_from_the_beginning_of_an_imported_log(run: deepgps.Run):
    assert run.recording.manifest.start_ns == 0
    values = run.recording.manifest.model_dump(by_alias=True)
    for written, read in ((7, 7), ("x", 0), ([1], 0), (None, 0)):
        assert Manifest.model_validate({**values, "log": {"start_ns": written}}).start_ns == read
