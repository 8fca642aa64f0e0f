from pathlib import Path

import numpy as np

from deepgps.posenet import fit
from deepgps.settings import LearnSettings
from sim.records import open_truth
from tests.toy import QUICK, make_toy


def test_true_positions_are_learned_in_the_frame_of_the_world(tmp_path: Path):
    recording = make_toy(tmp_path / "toy")
    positioner = fit(recording, LearnSettings.model_validate(QUICK), 0, tmp_path / "run" / "posenet")
    truth = open_truth(recording.folder).test_pose[:, 0, :2]
    error = np.linalg.norm(positioner(recording.test_observation[:, 0]) - truth, axis=1)
    assert np.sqrt(np.mean(error**2)) < 0.05
