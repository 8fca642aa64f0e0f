"""DeepGPS: positions from distances alone, restarts and starts."""

import shutil
from pathlib import Path

import numpy as np
import pytest
import torch

from deepgps.config.learning import LearnSettings, LiftSettings
from deepgps.data.segments import Segments, read_segments, subsample
from deepgps.learning.batches import Batch
from deepgps.learning.losses import FLATTENING_END, FLATTENING_START, find_plane, flatten_later, imitate_first
from deepgps.methods import registration
from deepgps.methods.deepgps import SLACK_M, choose_start
from deepgps.methods.fit import fit_method
from deepgps.positioner.positioner import Positioner
from deepgps.positioner.stored_positioner import read_training
from deepgps.terminal.progress import ignore
from sim.alignment import fit_alignment
from sim.errors import InputError
from sim.recording.format import Recording, open_truth
from tests.deepgps.learning.test_trainer import Cut, cut_at
from tests.helpers.toy import QUICK, make_toy

SETTINGS = LearnSettings.model_validate(QUICK)
STEPS = 120
SHORT_SETTINGS = SETTINGS.model_copy(update={"train": SETTINGS.train.model_copy(update={"steps": STEPS})})


@pytest.fixture(scope="module")
def toy(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return make_toy(tmp_path_factory.mktemp("deepgps") / "toy", samples=500)


@pytest.fixture(scope="module")
def trained(toy: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("trained") / "deepgps"
    fit_method("deepgps", toy, SHORT_SETTINGS, 0, folder)
    return folder


def measure(positioner: Positioner, recording: Recording) -> np.ndarray:
    truth = open_truth(recording.folder)
    alignment = fit_alignment(positioner(recording.observation), truth.pose[:, :2], "E2")
    found = alignment.apply(positioner(recording.test_observation[:, 0]))
    return np.linalg.norm(found - truth.test_pose[:, 0, :2], axis=1)


def test_it_finds_positions_from_distances_alone(toy: Recording, trained: Path):
    error = measure(fit_method("deepgps", toy, SHORT_SETTINGS, 0, trained, cut_at(1)), toy)  # done work is not repeated
    assert np.sqrt(np.mean(error**2)) < 0.1
    training = read_training(trained)
    assert training["steps"] == STEPS and training["attempts"] == 1 and not training["fold"]["found"]


def test_registration_on_distances_says_that_its_map_is_folded(
    toy: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    place = open_truth(toy.folder).pose[:, :2]
    monkeypatch.setattr(registration, "refine_distances", lambda recording, data, places, rng: places)
    for name, found in (("flat", place), ("folded", np.abs(place))):
        monkeypatch.setattr(registration, "make_initial_map", lambda *_, found=found: (torch.from_numpy(found), None))
        fit_method("registration_distances", toy, SETTINGS, 0, tmp_path / name)
        assert read_training(tmp_path / name)["fold"]["found"] == (name == "folded")


@pytest.mark.slow
def test_in_a_longer_drive_and_training_it_is_twice_as_exact(tmp_path: Path):
    recording = make_toy(tmp_path / "toy")
    error = measure(fit_method("deepgps", recording, SETTINGS, 0, tmp_path / "deepgps"), recording)
    assert np.sqrt(np.mean(error**2)) < 0.05


def test_what_a_killed_training_left_beside_finished_work_is_cleared_away(toy: Recording, trained: Path):
    (trained / "attempt0").mkdir()
    theirs = [trained / name / "history.npz" for name in ("attempt_mine", "attempt0x", "mine/attempt0")]
    for path in theirs:
        path.parent.mkdir(parents=True)
        path.write_text("a user's")
    fit_method("deepgps", toy, SHORT_SETTINGS, 0, trained)
    assert not (trained / "attempt0").exists()
    assert [path.read_text() for path in theirs] == ["a user's"] * 3


def test_the_truth_is_never_opened(toy: Recording, trained: Path, tmp_path: Path):
    shutil.copytree(toy.folder, tmp_path / "blind")
    shutil.rmtree(tmp_path / "blind" / "truth")
    blind = Recording(tmp_path / "blind", toy.manifest, toy.observation, toy.reading, toy.time, toy.test_observation)
    fit_method("deepgps", blind, SHORT_SETTINGS, 0, tmp_path / "run" / "deepgps")
    weights = (tmp_path / "run" / "deepgps" / "weights.safetensors").read_bytes()
    assert weights == (trained / "weights.safetensors").read_bytes()


@pytest.mark.slow
def test_a_long_recording_is_unfolded_on_a_part_of_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    recording = make_toy(tmp_path / "toy", samples=2400)
    looked_at = []

    def subsample_less(segments: Segments, observations: int) -> tuple[Segments, torch.Tensor]:
        kept, chosen = subsample(segments, observations, 800)
        looked_at.append(len(chosen))
        return kept, chosen

    monkeypatch.setattr("deepgps.methods.deepgps.subsample", subsample_less)
    monkeypatch.setattr("deepgps.data.segments.subsample", subsample_less)
    error = measure(fit_method("deepgps", recording, SETTINGS, 0, tmp_path / "run" / "deepgps"), recording)
    assert max(looked_at) <= 800
    assert np.sqrt(np.mean(error**2)) < 0.05


def test_cut_off_it_continues_to_the_same_bytes(toy: Recording, trained: Path, tmp_path: Path):
    folder = tmp_path / "run" / "deepgps"
    for step in (60, 110):
        with pytest.raises(Cut):
            fit_method("deepgps", toy, SHORT_SETTINGS, 0, folder, cut_at(step))
    fit_method("deepgps", toy, SHORT_SETTINGS, 0, folder)
    for name in ("weights.safetensors", "history.npz", "positioner.json"):
        assert (folder / name).read_bytes() == (trained / name).read_bytes()
    assert not list(folder.glob("attempt*"))


@pytest.mark.slow
def test_two_readings_a_segment_are_learned_by_lifting(tmp_path: Path):
    recording = make_toy(tmp_path / "toy", samples=1500, endpoint=True)
    train = SETTINGS.train.model_copy(update={"steps": 600, "segments": 128, "samples": 2})
    positioner = fit_method(
        "deepgps", recording, SETTINGS.model_copy(update={"train": train}), 0, tmp_path / "run" / "deepgps"
    )
    assert np.median(measure(positioner, recording)) < 0.12


def test_a_fold_restarts_training_and_the_best_attempt_is_kept(
    toy: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    train = SETTINGS.train.model_copy(update={"steps": 40})
    monkeypatch.setattr("deepgps.initial_map.distances.folding.LENGTH_ERROR_LIMIT", 1e-9)
    once_more = SETTINGS.fold.model_copy(update={"restarts": 1})
    settings = SETTINGS.model_copy(update={"train": train, "fold": once_more, "start": "random"})
    labels = []
    fit_method("deepgps", toy, settings, 0, tmp_path / "run" / "deepgps", lambda label, *_: labels.append(label))
    training = read_training(tmp_path / "run" / "deepgps")
    assert training["attempts"] == 2 and training["fold"]["found"] and training["steps"] == 80
    assert set(labels) == {"deepgps", "deepgps, restart 1"}


def test_attempts_start_by_paths_where_segments_have_three_readings_and_else_by_lifting(toy: Recording, tmp_path: Path):
    segments = read_segments(toy)
    assert [choose_start(SETTINGS, segments, number) for number in range(3)] == ["paths", "lifting", "lifting"]
    recording = make_toy(tmp_path / "toy", samples=60, endpoint=True)
    segments, by_paths = read_segments(recording), SETTINGS.model_copy(update={"start": "paths"})
    assert choose_start(SETTINGS, segments) == "lifting"
    with pytest.raises(InputError, match=r"learn\.start 'paths': most segments have only two readings"):
        fit_method("deepgps", recording, by_paths, 0, tmp_path / "run" / "deepgps", ignore)


def test_a_plane_in_space_is_found():
    generator = torch.Generator().manual_seed(0)
    flat = torch.randn((50, 2), generator=generator, dtype=torch.float64) * torch.tensor([3.0, 1.0])
    basis = torch.linalg.qr(torch.randn((6, 2), generator=generator, dtype=torch.float64))[0]
    centre, axes = find_plane(flat @ basis.T + 5.0)
    found = (flat @ basis.T + 5.0 - centre) @ axes
    assert torch.allclose(torch.cdist(found, found), torch.cdist(flat, flat), atol=1e-5)


def test_the_penalty_is_the_distance_from_the_plane_and_grows():
    points = torch.tensor([[3.0, 0, 0], [-3.0, 0, 0], [0, 2.0, 0], [0, -2.0, 0], [0, 0, 0.5], [0, 0, -0.5]])
    batch = Batch(torch.arange(6), torch.zeros(6), torch.ones(6, dtype=torch.bool))
    loss = flatten_later(lambda out, batch, done: out.sum() * 0.0, LiftSettings())
    times = (FLATTENING_START, (FLATTENING_START + FLATTENING_END) / 2.0, 0.9)
    values = [loss(points, batch, torch.tensor(done)).item() for done in times]
    assert values == pytest.approx([0.0, 0.5 / 6.0, 1.0 / 6.0])


def test_imitation_ends_in_a_leash():
    known = torch.tensor([[1.0, 1.0]] * 3 + [[float("nan")] * 2])
    batch = Batch(torch.arange(4), torch.zeros(4), torch.tensor([True, True, False, True]))
    slack = SLACK_M["paths"]
    loss = imitate_first(lambda out, batch, done: out.nan_to_num().sum() * 0.0, known, slack)
    values = [loss(torch.zeros((4, 2)), batch, done).item() for done in torch.tensor([0.0, 0.1, 0.5])]
    assert values == pytest.approx([2.0**0.5, 2.0**0.5 - slack / 2.0, 2.0**0.5 - slack])
    assert loss(known + slack / 2.0, batch, torch.tensor(0.5)).item() == 0.0
    nobody = Batch(torch.tensor([3]), torch.zeros(1), torch.ones(1, dtype=torch.bool))
    assert loss(torch.ones((1, 2)), nobody, torch.tensor(0.0)).item() == 0.0
    out = torch.zeros((4, 2), requires_grad=True)
    loss(out, batch, torch.tensor(0.1)).backward()
    assert out.grad is not None and torch.isfinite(out.grad).all()
