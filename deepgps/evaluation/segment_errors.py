"""Errors of a recording's driven distances, compared with those expected of its encoders: for evaluation only."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from deepgps.data.encoder_noise import expect_errors, find_wrong, predict_rms
from deepgps.data.segments import dead_reckon, find_runs, find_starts, read_segments, travel
from deepgps.evaluation.error_field import find_rms
from sim.alignment import fit_alignment
from sim.recording.format import Recording, Truth, measure_driven
from sim.recording.manifest import Manifest
from sim.settings import EncoderSettings

EMPTY = MappingProxyType[str, Any]({})
HEADING_DISTANCE_M = 3.0  # Way of the true path by which a dead-reckoned one is rotated [m]


def judge_encoders(recording: Recording, truth: Truth) -> dict[str, Any]:
    """Measure the errors of distances from start to end of segments."""
    segments = expect_errors(recording, read_segments(recording))
    encoder = EncoderSettings.model_validate(recording.manifest.settings.get("encoder", {}))
    _, error = measure_segments(recording, truth.pose)
    assert segments.doubted is not None
    wrong, doubted = find_wrong(segments, error), segments.doubted.numpy()
    return {
        "segment_rms_m": find_rms(error),  # RMS of the encoder's distance minus the true one [m]
        "segment_expected_m": predict_rms(segments, encoder),  # The RMS that theory predicts for these encoders [m]
        "segments_wrong": int(wrong.sum()),  # Segments with larger errors than noise explains
        "segments_down_weighted": int(doubted.sum()),  # Those on which the two wheels disagree
        "wrong_doubted": int((wrong & doubted).sum()),  # Those that are both
    }


def describe_drive(recording: Recording, methods: Mapping[str, Any] = EMPTY) -> dict[str, Any]:
    """Observations, straight segments and distance driven [m]; what the manifest does not say, by the readings.

    Of methods, what their trainings recorded of the drive is taken.
    """
    about, segment = recording.manifest, recording.reading[:, 0]
    segments, driven_m = about.segments, about.distance_driven_m
    if driven_m is None:
        driven_m = measure_driven(segment, travel(recording.reading[:, 2:], about.odometry).mean(axis=1))
    return {
        "samples": len(recording.observation),  # Observations
        "segments": len(np.unique(segment)) if segments is None else segments,  # Straight segments
        "distance_driven_m": driven_m,  # Distance along all segments [m]
        **describe_unseen(
            about, len(recording.observation), driven_m, methods.get("registration", {}).get("left_out_m")
        ),
    }


def describe_unseen(about: Manifest, images: int, driven_m: float, radius_m: float | None) -> dict[str, Any]:
    """What the robot itself knows of how much it has seen, if it has a map of its own, after so many images."""
    more = about.model_extra or {}
    if "unseen" not in more:
        return {}
    (unseen, low, high), drive = more["unseen"], about.settings.get("drive", {})
    until = drive.get("until", {})
    done = until.get("unseen") is not None and unseen <= until["unseen"]
    done = done and not ("radius_m" in until and images >= drive["samples"])
    return {
        "explore": {
            "unseen": unseen,  # Share of the floor without an image within 0.25 m, likely
            "unseen_low": low,  # The same, at least
            "unseen_high": high,  # The same, at most
            # Radius within which registration on other segments places 68 % of the images; None: none was registered
            "radius_m": radius_m,
            "driven_m": driven_m,  # Distance along all segments [m]
            "images": images,  # Observations
            # Which of the drive's settings ended it: until.unseen, until.radius_m or samples
            "ended_by": ("radius_m" if "radius_m" in until else "unseen") if done else "samples",
        }
    }


def measure_segments(recording: Recording, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """True length of each segment, and the encoders' distance minus that length, both (S,) [m].

    Segments with one reading are left out; true poses are of the observations (N, 3).
    """
    encoder, true = measure_distances(recording, pose)
    last = np.array([run[-1] for run in find_runs(recording) if len(run) > 1], int)
    return true[last], (encoder - true)[last]


def reckon_path(recording: Recording, pose: np.ndarray) -> np.ndarray:
    """The dead-reckoned path (R, 2) [m] from the true start, rotated to fit the first three metres of the true path.

    True poses are of the observations (N, 3).
    """
    path, true = dead_reckon(recording)[:, :2], pose[recording.reading[:, 1], :2]
    driven = np.cumsum(np.linalg.norm(np.diff(true, axis=0), axis=1))
    first = 2 + int((driven < HEADING_DISTANCE_M).sum())
    turn = fit_alignment(path[:first], true[:first], "SE2").rotation
    return (path - path[0]) @ turn.T + true[0]


def measure_distances(recording: Recording, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance (R,) [m] since the segment began at each reading, by encoder and true, from true poses (N, 3)."""
    segment, observation, ticks = recording.reading[:, 0], recording.reading[:, 1], recording.reading[:, 2:]
    distance = travel(ticks, recording.manifest.odometry).mean(axis=1)
    start, place = find_starts(segment), pose[observation, :2]
    encoder = np.abs(distance - distance[start])  # a robot may back along a segment
    return encoder, np.linalg.norm(place - place[start], axis=1)
