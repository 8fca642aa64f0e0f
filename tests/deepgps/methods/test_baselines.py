"""Methods that DeepGPS is compared with: taught by true positions or dead-reckoned ones, and neighbours."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from deepgps.config.learning import LearnSettings, PcaSettings
from deepgps.methods import baselines
from deepgps.methods.baselines import draw_turns, turn_scans
from deepgps.methods.fit import fit_method
from deepgps.positioner.stored_positioner import read_training
from deepgps.positioner.without_features import ScanPositioner
from deepgps.terminal.progress import ignore
from sim.alignment import fit_alignment
from sim.errors import InputError
from sim.planar.drive import collect
from sim.planar.worlds import LidarWorld
from sim.recording.format import Recording, open_recording, open_truth
from sim.settings import DriveSettings, GridSettings, LidarSettings, SimSettings
from tests.helpers.toy import QUICK, make_toy

WHOLE_LEARNING = LearnSettings.model_validate(QUICK)
SHORT_LEARNING = WHOLE_LEARNING.model_copy(update={"train": WHOLE_LEARNING.train.model_copy(update={"steps": 120})})
LIDAR = SimSettings(
    world="obstacles",
    lidar=LidarSettings(rays=64, headings=4),
    drive=DriveSettings(spacing_m=0.04, samples=500),
    grid=GridSettings(spacing_m=0.2, headings=3),
)
LEARN = LearnSettings(pca=PcaSettings(headings=64))


@pytest.fixture(scope="module")
def toy(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return make_toy(tmp_path_factory.mktemp("baselines") / "toy")


@pytest.fixture(scope="module")
def scans(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    folder = tmp_path_factory.mktemp("lidar") / "recording"
    collect(LIDAR, 3, folder, ignore)
    return open_recording(folder)


@pytest.fixture(scope="module")
def nearest(scans: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a trained pca_knn."""
    folder = tmp_path_factory.mktemp("nearest") / "pca_knn"
    fit_method("pca_knn", scans, LEARN, 0, folder)
    return folder


def measure(
    method: str, recording: Recording, folder: Path, align: bool = False, learn: LearnSettings = SHORT_LEARNING
) -> float:
    """RMS error of a method where it is tested, in the world's frame or after alignment [m]."""
    positioner, truth = fit_method(method, recording, learn, 0, folder / method), open_truth(recording.folder)
    found = positioner(recording.test_observation[:, 0])
    if align:
        found = fit_alignment(positioner(recording.observation), truth.pose[:, :2], "SE2").apply(found)
    return float(np.sqrt(np.mean(np.sum((found - truth.test_pose[:, 0, :2]) ** 2, axis=1))))


def test_true_positions_are_learned_in_the_frame_of_the_world(toy: Recording, tmp_path: Path):
    assert measure("posenet", toy, tmp_path) < 0.08


@pytest.mark.slow
def test_longer_trainings_are_as_exact_as_their_labels(toy: Recording, tmp_path: Path):
    assert measure("posenet", toy, tmp_path, learn=WHOLE_LEARNING) < 0.05
    assert measure("posenet_noisy", toy, tmp_path, learn=WHOLE_LEARNING) < 0.06
    assert measure("dead_reckoned_labels", toy, tmp_path, align=True, learn=WHOLE_LEARNING) < 0.06


def test_noisy_labels_are_off_by_what_was_asked_and_the_same_for_one_seed(
    toy: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    told = []
    monkeypatch.setattr(baselines, "prepare", lambda *_: None)
    monkeypatch.setattr(baselines, "fit_positions", lambda data, index, label, *rest: told.append(label))
    for seed, noise in ((0, 0.01), (0, 0.01), (1, 0.01), (0, 0.0)):
        monkeypatch.setattr(baselines, "LABEL_NOISE_M", noise)
        baselines.fit_posenet_noisy(toy, LearnSettings(), seed, tmp_path, ignore)
    truth = torch.from_numpy(open_truth(toy.folder).pose[:, :2])
    first, again, other, exact = (label - truth for label in told)
    assert torch.equal(first, again)
    assert not torch.equal(first, other)
    assert exact.abs().max() < 1e-6
    assert 0.008 < first.std() < 0.012
    assert first.mean().abs() < 0.003


def test_exact_encoders_teach_as_well_as_the_truth_even_where_readings_are_lost(toy: Recording, tmp_path: Path):
    arrived = np.random.default_rng(0).random(len(toy.reading)) < 0.7
    thinned = replace(toy, reading=toy.reading[arrived], time=toy.time[arrived])
    assert measure("dead_reckoned_labels", thinned, tmp_path, align=True) < 0.2


def test_a_wrong_track_spoils_the_map(toy: Recording, tmp_path: Path):
    odometry = {**toy.manifest.odometry, "track_m": 0.15}
    drifting = replace(toy, manifest=toy.manifest.model_copy(update={"odometry": odometry}))
    assert measure("dead_reckoned_labels", drifting, tmp_path, align=True) > 0.3


def test_neighbours_interpolate_true_positions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    recording = make_toy(tmp_path / "toy", samples=3000)
    positioner, truth = fit_method("knn", recording, LearnSettings(), 0, tmp_path / "knn"), open_truth(recording.folder)
    error = np.linalg.norm(positioner(recording.test_observation[:, 0]) - truth.test_pose[:, 0, :2], axis=1)
    assert np.median(error) < 0.03
    known = positioner(np.asarray(recording.observation[:50]))
    assert np.abs(known - truth.pose[:50, :2]).max() < 0.05
    monkeypatch.setattr(baselines, "NEIGHBOURS", 1)
    positioner = fit_method("knn", recording, LearnSettings(), 0, tmp_path / "one" / "knn")
    stored = {tuple(place) for place in truth.pose[:, :2].tolist()}
    assert all(tuple(place) in stored for place in positioner(recording.test_observation[:, 0]).tolist())


def test_a_turned_scan_is_what_a_turned_robot_sees(scans: Recording):
    poses = open_truth(scans.folder).pose[:20]
    turns = np.random.default_rng(0).integers(0, 256, (20, 3))
    turned = turn_scans(np.asarray(scans.observation[:20]), turns).reshape(20, 3, 64)
    world = LidarWorld(LIDAR, 3)
    for k in range(3):
        seen = world.observe(poses + np.outer(2 * np.pi * turns[:, k] / 256, [0, 0, 1]))[:, 0]
        assert (np.abs(turned[:, k] - seen) < 1e-4).mean() > 0.99  # corners are hit or missed by a rounding error


def test_turns_of_a_place_differ_and_are_at_most_all_there_are():
    turns = draw_turns(5, 30, 10, np.random.default_rng(0))
    assert turns.shape == (5, 10)
    assert all(len(set(row)) == 10 for row in turns.tolist())
    assert draw_turns(2, 8, 100, np.random.default_rng(0)).tolist() == [list(range(8))] * 2


def test_the_nearest_scan_is_the_nearest_in_principal_components(scans: Recording, nearest: Path):
    positioner = fit_method("pca_knn", scans, LEARN, 0, nearest)
    assert isinstance(positioner, ScanPositioner)
    seen = np.asarray(scans.test_observation[:, 1])
    projected, known = positioner.project(seen[:, 0]).astype(float), positioner.known.astype(float)
    apart = ((projected[:, None] - known[None]) ** 2).sum(axis=-1)
    assert np.array_equal(positioner(seen), positioner.places[apart.argmin(axis=1) // positioner.turns])
    assert positioner(seen[:0]).shape == (0, 2)
    known_places = open_truth(scans.folder).pose[:, :2]
    assert np.median(np.linalg.norm(positioner(np.asarray(scans.observation)) - known_places, axis=1)) < 0.02


@pytest.mark.slow
def test_of_many_scans_the_nearest_is_centimetres_away(tmp_path: Path):
    many = LIDAR.model_copy(update={"drive": DriveSettings(spacing_m=0.04, samples=1500)})
    collect(many, 3, tmp_path / "recording", ignore)
    recording = open_recording(tmp_path / "recording")
    found = fit_method("pca_knn", recording, LEARN, 0, tmp_path / "pca_knn")(recording.test_observation[:, 1])
    assert np.median(np.linalg.norm(found - open_truth(recording.folder).test_pose[:, 1, :2], axis=1)) < 0.05


def test_it_is_saved_whole_and_counts_what_it_stores(scans: Recording, nearest: Path, tmp_path: Path):
    first = fit_method("pca_knn", scans, LEARN, 0, nearest)
    again = fit_method("pca_knn", scans, LEARN, 0, tmp_path / "pca_knn")
    seen = np.asarray(scans.test_observation[:, 0])
    assert np.array_equal(first(seen), again(seen))
    assert read_training(nearest)["parameters"] == 500 * 64 * 64 + 500 * 2 + 64 * 64 + 64


def test_other_observations_are_refused(scans: Recording, toy: Recording, nearest: Path, tmp_path: Path):
    with pytest.raises(InputError, match="pca_knn needs scans"):
        fit_method("pca_knn", toy, LEARN, 0, tmp_path / "pca_knn")
    positioner = fit_method("pca_knn", scans, LEARN, 0, nearest)
    with pytest.raises(InputError, match=r"observations of shape \(32,\), but trained on shape \(64,\)"):
        positioner(np.zeros((2, 1, 32)))
