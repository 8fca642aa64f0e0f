from pathlib import Path

import numpy as np
import pytest

from deepgps.config.learning import LearnSettings
from deepgps.methods.fit import fit_method
from sim.recording.format import open_truth
from tests.helpers.toy import make_toy


def test_neighbours_interpolate_true_positions(tmp_path: Path):
    recording = make_toy(tmp_path / "toy", samples=3000)
    positioner = fit_method("knn", recording, LearnSettings(), 0, tmp_path / "run" / "knn")
    truth = open_truth(recording.folder)
    error = np.linalg.norm(positioner(recording.test_observation[:, 0]) - truth.test_pose[:, 0, :2], axis=1)
    assert np.median(error) < 0.03
    known = positioner(np.asarray(recording.observation[:50]))
    assert np.abs(known - truth.pose[:50, :2]).max() < 0.05


def test_one_neighbour_is_a_stored_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("deepgps.methods.baselines.NEIGHBOURS", 1)
    recording = make_toy(tmp_path / "toy", samples=500)
    positioner = fit_method("knn", recording, LearnSettings(), 0, tmp_path / "run" / "knn")
    stored = {tuple(place) for place in open_truth(recording.folder).pose[:, :2].tolist()}
    assert all(tuple(place) in stored for place in positioner(recording.test_observation[:, 0]).tolist())
