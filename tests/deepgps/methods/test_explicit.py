"""Explicit positioning: its derivative by differences, its equations by the truth, its answers by the world."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from deepgps.config.learning import LearnSettings
from deepgps.data.segments import read_segments
from deepgps.methods.explicit import Equations, choose_readings, set_up, start_by_mds
from deepgps.methods.fit import fit_method
from deepgps.positioner.stored_positioner import read_training
from sim.alignment import fit_alignment
from sim.errors import InputError
from sim.planar.drive import collect
from sim.recording.format import Recording, Truth, open_recording, open_truth
from sim.settings import EncoderSettings, GridSettings, LandmarksSettings, SimSettings

SETTINGS = LearnSettings.model_validate({"explicit": {"readings": 400}})


def make(folder: Path, reach_m: float | None) -> Recording:
    settings = SimSettings(
        world="landmarks",
        landmarks=LandmarksSettings(count=40, segments=40, reach_m=reach_m),
        encoder=EncoderSettings(ticks_per_rev=65536),
        grid=GridSettings(spacing_m=0.2, headings=1),
    )
    collect(settings, 0, folder, lambda *_: None)
    return open_recording(folder)


@pytest.fixture(scope="module")
def complete(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return make(tmp_path_factory.mktemp("complete") / "recording", None)


@pytest.fixture(scope="module")
def incomplete(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return make(tmp_path_factory.mktemp("incomplete") / "recording", 0.9)


def measure(positioner, recording: Recording) -> np.ndarray:
    truth: Truth = open_truth(recording.folder)
    alignment = fit_alignment(positioner(recording.observation), truth.pose[:, :2], "E2")
    found = alignment.apply(positioner(recording.test_observation[:, 0]))
    return np.linalg.norm(found - truth.test_pose[:, 0, :2], axis=1)


@given(seed=st.integers(0, 1000))
def test_the_jacobian_is_the_derivative_of_the_residuals(seed: int):
    rng = np.random.default_rng(seed)
    first, second = rng.integers(0, 6, (2, 15))
    second = np.where(first == second, (first + 1) % 6, second)
    equations = Equations(first, second, rng.uniform(0.1, 2.0, 15))
    unknown, step = rng.normal(size=12), 1e-6
    jacobian = equations.jacobian(unknown)
    assert jacobian.nnz == 4 * 15
    difference = [
        (equations.residual(unknown + step * unit) - equations.residual(unknown - step * unit)) / (2 * step)
        for unit in np.eye(12)
    ]
    nearest = np.linalg.norm(np.diff(unknown.reshape(-1, 2)[np.stack([first, second])], axis=0)[0], axis=1).min()
    assert np.abs(jacobian.toarray() - np.array(difference).T).max() < 1e-8 / min(1.0, nearest**2)
    together = Equations(np.array([0]), np.array([1]), np.array([1.0]))  # points on one another have no direction
    assert together.residual(np.zeros(4)).tolist() == [-1.0]
    assert together.jacobian(np.zeros(4)).toarray().tolist() == [[0.0] * 4]


@pytest.mark.parametrize("which", ["complete", "incomplete"])
def test_the_truth_solves_the_equations(which: str, request: pytest.FixtureRequest):
    recording: Recording = request.getfixturevalue(which)
    truth, segments = open_truth(recording.folder), read_segments(recording)
    landmark = np.load(recording.folder / "truth" / "landmark.npy")
    reach_m = recording.manifest.settings["landmarks"]["reach_m"] or np.inf
    equations = set_up(np.asarray(recording.observation), reach_m, segments)
    unknown = np.concatenate([truth.pose[:, :2], landmark]).ravel()
    assert np.abs(equations.residual(unknown)).max() < 1e-5
    pairs = int((segments.count * (segments.count - 1) // 2).sum())
    assert len(equations.length) == pairs + int((recording.observation < np.float32(reach_m)).sum())


def test_readings_are_thinned_along_their_segments(complete: Recording):
    segments = read_segments(complete)
    fewer, chosen = choose_readings(segments, 200)
    assert 100 < fewer.count.sum() <= 200 + len(segments.count)
    assert torch.equal(fewer.index[fewer.valid].unique(), torch.arange(len(chosen)))
    for row, count in enumerate(fewer.count.tolist()):
        kept = chosen[fewer.index[row, :count]]
        place = torch.searchsorted(segments.index[row, 1 : segments.count[row]].contiguous(), kept[1:]) + 1
        assert kept[0] == segments.index[row, 0]
        assert torch.equal(segments.index[row, place], kept[1:])
        assert torch.equal(segments.distance[row, place], fewer.distance[row, 1:count])


@pytest.mark.parametrize("which", ["complete", "incomplete"])
def test_from_mds_the_world_is_found_exactly_and_without_the_truth(
    which: str, request: pytest.FixtureRequest, tmp_path: Path
):
    recording: Recording = request.getfixturevalue(which)
    blind = replace(recording, folder=tmp_path / "nowhere")
    error = measure(fit_method("explicit_mds", blind, SETTINGS, 0, tmp_path / "explicit_mds"), recording)
    assert error.max() < 1e-4
    training = read_training(tmp_path / "explicit_mds")
    assert training["converged"] and training["residual_rms_m"] < 1e-5


def test_mds_alone_is_already_close(complete: Recording):
    distance = np.asarray(complete.observation)
    _, landmark = start_by_mds(distance, np.inf, np.random.default_rng(0))
    true = np.load(complete.folder / "truth" / "landmark.npy")
    off = np.linalg.norm(fit_alignment(landmark, true, "E2").apply(landmark) - true, axis=1)
    assert np.median(off) < 0.05


def test_a_random_start_depends_on_its_seed_and_done_work_is_loaded(complete: Recording, tmp_path: Path):
    settings = LearnSettings.model_validate({"explicit": {"readings": 100, "evaluations": 3}})
    first, again, other = (
        fit_method("explicit", complete, settings, seed, tmp_path / name)(complete.test_observation[:, 0])
        for seed, name in ((0, "a"), (0, "b"), (1, "c"))
    )
    assert np.array_equal(first, again) and not np.array_equal(first, other)
    written = (tmp_path / "a" / "positioner.json").stat().st_mtime_ns
    assert np.array_equal(
        fit_method("explicit", complete, settings, 5, tmp_path / "a")(complete.test_observation[:, 0]), first
    )
    assert (tmp_path / "a" / "positioner.json").stat().st_mtime_ns == written


def test_landmarks_without_a_common_map_are_refused():
    apart = np.full((4, 4), 1.0, np.float32)
    apart[:2, :2] = apart[2:, 2:] = 0.5
    with pytest.raises(InputError, match="they have no common map"):
        start_by_mds(apart, 1.0, np.random.default_rng(0))
