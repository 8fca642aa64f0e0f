from pathlib import Path

import numpy as np
import torch

from deepgps.config.learning import LearnSettings
from deepgps.methods import baselines
from deepgps.methods.fit import fit_method
from deepgps.terminal.progress import ignore
from sim.recording.format import open_truth
from tests.helpers.toy import QUICK, make_toy


def test_true_positions_are_learned_in_the_frame_of_the_world(tmp_path: Path):
    recording = make_toy(tmp_path / "toy")
    positioner = fit_method("posenet", recording, LearnSettings.model_validate(QUICK), 0, tmp_path / "run" / "posenet")
    truth = open_truth(recording.folder).test_pose[:, 0, :2]
    error = np.linalg.norm(positioner(recording.test_observation[:, 0]) - truth, axis=1)
    assert np.sqrt(np.mean(error**2)) < 0.05


def test_noisy_labels_are_off_by_what_was_asked_and_the_same_for_one_seed(tmp_path: Path, monkeypatch):
    recording = make_toy(tmp_path / "toy")
    told = []
    monkeypatch.setattr(baselines, "prepare", lambda *_: None)
    monkeypatch.setattr(baselines, "fit_positions", lambda data, index, label, *rest: told.append(label))
    for seed, noise in ((0, 0.01), (0, 0.01), (1, 0.01), (0, 0.0)):
        monkeypatch.setattr(baselines, "LABEL_NOISE_M", noise)
        baselines.fit_posenet_noisy(recording, LearnSettings(), seed, tmp_path, ignore)
    truth = torch.from_numpy(open_truth(recording.folder).pose[:, :2])
    first, again, other, exact = (label - truth for label in told)
    assert torch.equal(first, again)
    assert not torch.equal(first, other)
    assert exact.abs().max() < 1e-6
    assert 0.008 < first.std() < 0.012
    assert first.mean().abs() < 0.003


def test_noisy_labels_teach_nearly_the_same(tmp_path: Path):
    recording = make_toy(tmp_path / "toy")
    positioner = fit_method(
        "posenet_noisy", recording, LearnSettings.model_validate(QUICK), 0, tmp_path / "run" / "posenet_noisy"
    )
    truth = open_truth(recording.folder).test_pose[:, 0, :2]
    error = np.linalg.norm(positioner(recording.test_observation[:, 0]) - truth, axis=1)
    assert np.sqrt(np.mean(error**2)) < 0.06
