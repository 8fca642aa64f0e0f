from pathlib import Path

import numpy as np

from deepgps.config.learning import LearnSettings
from deepgps.methods.fit import fit_method
from sim.alignment import fit_alignment
from sim.recording.format import Recording, open_truth
from tests.helpers.toy import QUICK, make_toy

SETTINGS = LearnSettings.model_validate(QUICK)


def error_of(recording: Recording, folder: Path) -> float:
    positioner = fit_method("dead_reckoned_labels", recording, SETTINGS, 0, folder)
    truth = open_truth(recording.folder)
    alignment = fit_alignment(positioner(recording.observation), truth.pose[:, :2], "SE2")
    found = alignment.apply(positioner(recording.test_observation[:, 0]))
    return float(np.sqrt(np.mean(np.sum((found - truth.test_pose[:, 0, :2]) ** 2, axis=1))))


def test_exact_encoders_teach_as_well_as_the_truth(tmp_path: Path):
    assert error_of(make_toy(tmp_path / "toy"), tmp_path / "run" / "dead_reckoned_labels") < 0.06


def test_a_wrong_track_spoils_the_map(tmp_path: Path):
    recording = make_toy(tmp_path / "toy")
    constants = {**recording.manifest.odometry, "track_m": 0.15}
    wrong = recording.manifest.model_copy(update={"odometry": constants})
    drifting = Recording(
        recording.folder, wrong, recording.observation, recording.reading, recording.time, recording.test_observation
    )
    assert error_of(drifting, tmp_path / "run" / "dead_reckoned_labels") > 0.3


def test_observations_without_a_reading_have_no_label(tmp_path: Path):
    recording = make_toy(tmp_path / "toy")
    arrived = np.random.default_rng(0).random(len(recording.reading)) < 0.7
    some, time = recording.reading[arrived], recording.time[arrived]
    thinned = Recording(
        recording.folder, recording.manifest, recording.observation, some, time, recording.test_observation
    )
    assert error_of(thinned, tmp_path / "run" / "dead_reckoned_labels") < 0.2
