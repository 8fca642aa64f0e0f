"""The nearest stored scan: turned scans are those that a turned robot sees, and what is stored is found again."""

from pathlib import Path

import numpy as np
import pytest

from deepgps.config.learning import LearnSettings, PcaSettings
from deepgps.methods.baselines import draw_turns, turn_scans
from deepgps.methods.fit import fit_method
from deepgps.positioner.nearest_scan import ScanPositioner
from sim.errors import InputError
from sim.planar.obstacles import LidarWorld, collect
from sim.recording.format import Recording, open_recording, open_truth
from sim.settings import DriveSettings, GridSettings, LidarSettings, SimSettings
from tests.helpers.toy import make_toy

SETTINGS = SimSettings(
    world="obstacles",
    lidar=LidarSettings(rays=64, headings=4),
    drive=DriveSettings(spacing_m=0.04, samples=1500),
    grid=GridSettings(spacing_m=0.2, headings=3),
)
LEARN = LearnSettings(pca=PcaSettings(headings=64))


def quiet(label: str, done: int, total: int) -> None:
    pass


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    folder = tmp_path_factory.mktemp("lidar") / "recording"
    collect(SETTINGS, 3, folder, quiet)
    return open_recording(folder)


def test_a_turned_scan_is_what_a_turned_robot_sees(recording: Recording):
    poses = open_truth(recording.folder).pose[:20]
    turns = np.random.default_rng(0).integers(0, 256, (20, 3))
    turned = turn_scans(np.asarray(recording.observation[:20]), turns).reshape(20, 3, 64)
    world = LidarWorld(SETTINGS, 3)
    for k in range(3):
        seen = world.observe(poses + np.outer(2 * np.pi * turns[:, k] / 256, [0, 0, 1]))[:, 0]
        assert (np.abs(turned[:, k] - seen) < 1e-4).mean() > 0.99  # corners are hit or missed by a rounding error


def test_turns_of_a_place_differ_and_are_at_most_all_there_are():
    turns = draw_turns(5, 30, 10, np.random.default_rng(0))
    assert turns.shape == (5, 10)
    assert all(len(set(row)) == 10 for row in turns.tolist())
    assert draw_turns(2, 8, 100, np.random.default_rng(0)).tolist() == [list(range(8))] * 2


def test_the_nearest_scan_is_the_nearest_in_principal_components(recording: Recording, tmp_path: Path):
    positioner = fit_method("pca_knn", recording, LEARN, 0, tmp_path / "pca_knn")
    assert isinstance(positioner, ScanPositioner)
    scans = np.asarray(recording.test_observation[:, 1])
    projected, known = positioner.project(scans[:, 0]).astype(float), positioner.known.astype(float)
    apart = ((projected[:, None] - known[None]) ** 2).sum(axis=-1)
    assert np.array_equal(positioner(scans), positioner.places[apart.argmin(axis=1) // positioner.headings])
    error = np.linalg.norm(positioner(scans) - open_truth(recording.folder).test_pose[:, 1, :2], axis=1)
    assert np.median(error) < 0.05
    known_places = open_truth(recording.folder).pose[:, :2]
    assert np.median(np.linalg.norm(positioner(np.asarray(recording.observation)) - known_places, axis=1)) < 0.02
    assert positioner(scans[:0]).shape == (0, 2)


def test_it_is_saved_whole_and_counts_what_it_stores(recording: Recording, tmp_path: Path):
    first = fit_method("pca_knn", recording, LEARN, 0, tmp_path / "pca_knn")
    again = fit_method("pca_knn", recording, LEARN, 0, tmp_path / "pca_knn")
    scans = np.asarray(recording.test_observation[:, 0])
    assert np.array_equal(first(scans), again(scans))
    text = (tmp_path / "pca_knn" / "training.json").read_text()
    assert f'"parameters": {1500 * 64 * 64 + 1500 * 2 + 64 * 64 + 64}' in text


def test_other_observations_are_refused(recording: Recording, tmp_path: Path):
    with pytest.raises(InputError, match="holds no scans; pca_knn needs world obstacles or sensor lidar"):
        fit_method("pca_knn", make_toy(tmp_path / "toy", samples=50), LEARN, 0, tmp_path / "pca_knn")
    positioner = fit_method("pca_knn", recording, LEARN, 0, tmp_path / "scans")
    with pytest.raises(InputError, match=r"observations of shape \(1, 32\), but trained on scans of 64 rays"):
        positioner(np.zeros((2, 1, 32)))
