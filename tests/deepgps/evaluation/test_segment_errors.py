from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deepgps.evaluation.segment_errors import describe_drive, judge_encoders
from sim.recording.format import open_recording, open_truth
from sim.sensors.encoder import read_encoders
from sim.settings import EncoderSettings
from tests.helpers.toy import ODOMETRY, make_toy


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_toy(tmp_path_factory.mktemp("segments") / "toy").folder


def measure(folder: Path, encoder: EncoderSettings) -> dict[str, float]:
    recording, truth = open_recording(folder), open_truth(folder)
    ticks, arrived = read_encoders(truth.wheel_angle, 0.033, encoder, np.random.default_rng(0))
    odometry = {**ODOMETRY, "ticks_per_rev": encoder.ticks_per_rev, "step_noise": encoder.step_noise}
    settings = {"encoder": encoder.model_dump(mode="json")}
    manifest = recording.manifest.model_copy(update={"odometry": odometry, "settings": settings})
    reading = np.column_stack([recording.reading[:, :2], ticks])[arrived]
    return judge_encoders(replace(recording, reading=reading, manifest=manifest), truth)


def test_no_fault_gives_no_error(folder: Path):
    found = measure(folder, EncoderSettings(ticks_per_rev=65536))
    assert found["segment_rms_m"] < 1e-4 and found["segment_expected_m"] < 1e-4
    assert found["segments_wrong"] == found["segments_down_weighted"] == 0


def test_noise_is_measured_as_expected(folder: Path):
    found = measure(folder, EncoderSettings(ticks_per_rev=65536, step_noise=0.2))
    assert found["segment_rms_m"] == pytest.approx(found["segment_expected_m"], rel=0.35)
    assert found["segment_rms_m"] > 0.02 and found["segments_wrong"] <= 2


def test_a_stuck_encoder_is_counted_and_found(folder: Path):
    found = measure(folder, EncoderSettings(ticks_per_rev=65536, stuck_fraction=0.25))
    assert found["segments_wrong"] >= 5
    assert found["wrong_doubted"] == found["segments_wrong"] <= found["segments_down_weighted"]


def test_a_robot_with_a_map_says_what_it_has_seen_and_how_well_it_knows_its_place(folder: Path):
    recording = open_recording(folder)
    assert "explore" not in describe_drive(recording)
    settings: dict[str, Any] = {"drive": {"until": {"unseen": 0.005}}}
    about = recording.manifest.model_copy(update={"unseen": [0.004, 0.001, 0.009], "settings": settings})
    methods = {"registration_labels": {"left_out_m": 0.002}, "registration": {"left_out_m": 0.011}}
    found = describe_drive(replace(recording, manifest=about), methods)
    said = found["explore"]
    assert (said["unseen"], said["unseen_low"], said["unseen_high"]) == (0.004, 0.001, 0.009)
    assert (said["images"], said["driven_m"]) == (found["samples"], found["distance_driven_m"])
    assert (said["radius_m"], said["ended_by"]) == (0.011, "unseen")
    for samples, ended_by in ((len(recording.observation), "samples"), (10_000, "radius_m")):
        settings["drive"] = {"samples": samples, "until": {"unseen": 0.005, "radius_m": 0.02}}
        assert describe_drive(replace(recording, manifest=about), methods)["explore"]["ended_by"] == ended_by
