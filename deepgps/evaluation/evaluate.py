"""Evaluation: every method on the test grid, or on test samples of the drive, against the simulator's truth.

If a recording has labels of its own, every method is measured against these too, which is the only way without a
simulator (paper, Sec. IV-C).
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from deepgps.config.methods import METHODS, folder_of
from deepgps.config.scenario import Scenario
from deepgps.data.checks import check_observations
from deepgps.data.segments import dead_reckon
from deepgps.evaluation.deployment import adapt, check_predicted, find_causes, measure_deployment, open_deployment
from deepgps.evaluation.error_field import ErrorField, find_rms, write_fields
from deepgps.evaluation.map_errors import (
    find_true_camera,
    find_turned_parts,
    is_undecided,
    judge_map,
    place_map,
    read_known_map,
)
from deepgps.evaluation.measures import (
    make_field,
    measure_coverage,
    measure_flipped,
    summarise,
    summarise_acceptance,
    summarise_yaw,
)
from deepgps.evaluation.segment_errors import describe_drive, judge_encoders
from deepgps.evaluation.stored_alignment import write_alignment
from deepgps.learning.trainer import find_device
from deepgps.positioner.pose import Poses, find_poses
from deepgps.positioner.positioner import CPU, Positioner
from deepgps.positioner.stored_positioner import load_positioner, read_training
from deepgps.terminal.progress import Report, ignore
from sim.alignment import Alignment, fit_alignment, fit_robust_alignment
from sim.errors import InputError
from sim.recording.format import (
    Labels,
    Recording,
    Truth,
    grid_file,
    open_labels,
    open_recording,
    open_truth,
)

MISPLACED_M = 0.5  # Distance from the truth beyond which a training image counts as misplaced [m]


class Predictions(NamedTuple):
    """What a trained method predicts of a recording, in the method's own frame."""

    training: np.ndarray  # Positions of the training images (N, 2) [m]
    poses: Poses  # Poses of the test images (C * H)
    trained: Positioner  # The positioner as it was trained
    positioner: Positioner  # The positioner of the camera in deployment, which took the test images
    lean: dict[str, float]  # How that camera leans, for ``metrics.json``


def evaluate(run: Path, scenario: Scenario, progress: Report = ignore) -> dict[str, Any]:
    """Measure all methods of a run; write its ``error_field.npz`` and the alignment of each method.

    Returns the measured part of ``metrics.json``: counts, coverage, trajectory, distances, methods.
    """
    recording = open_recording(run / "recording")
    truth = open_truth(run / "recording")
    check_observations(recording.test_observation, name := grid_file(recording.manifest.sensor))
    if 0 in recording.test_observation.shape[:2]:
        raise InputError(f"{recording.folder}: {name} holds no observation, so nothing can be measured")
    labels, side_m = _find_labels(run / "recording"), truth.free_space.shorter_side_m
    deployment = open_deployment(recording)
    fields, use_fields, label_fields, methods = {}, {}, {}, {}
    device = find_device(scenario.learn.train.device)
    for number, method in enumerate(scenario.methods):
        progress("evaluate", number, len(scenario.methods))
        maps = predict(folder_of(run, method), recording, deployment, device)
        fields[method], alignment = measure_field(maps, method, truth)
        write_alignment(folder_of(run, method), alignment, METHODS[method].alignment)
        methods[method] = {
            **_summarise(fields[method], side_m),
            **summarise_yaw(fields[method]),
            # RMS distance of predictions from their mean over a position's headings
            "heading_spread_m": measure_heading_spread(fields[method].predicted),
            "scale": alignment.scale,  # Factor from the method's map to the true one; measured, never applied
            # Share of the training images placed more than 0.5 m from the truth
            "misplaced": measure_misplaced(alignment.apply(maps.training), truth),
            **measure_grid(fields[method], scenario),
            "alignment": METHODS[method].alignment,  # E2 or SE2
            **find_turned_parts(maps.training, recording),
            **read_training(folder_of(run, method)),
        }
        if "map" in methods[method]:
            # Whether more than 5 % of the map is undecided
            methods[method]["undecided"] = is_undecided(methods[method]["map"])
        if (stored := read_known_map(folder_of(run, method))) is not None:
            methods[method]["map"] |= judge_map(place_map(stored, find_true_camera(recording, truth)))
        if deployment is not None:
            use_fields[method] = measure_deployment(maps.positioner, alignment, deployment, folder_of(run, method))
            causes = find_causes(maps.trained, recording, deployment)
            # The same errors on the images of the deployment drive, each a position of its own
            methods[method]["in_use"] = {**_summarise(use_fields[method], side_m), **maps.lean, **causes}
        if labels is not None:
            label_fields[method], to_labels = measure_field(maps, method, labels)
            # The same errors against labels, where there are labels
            methods[method]["against_labels"] = {**_summarise(label_fields[method], side_m), "scale": to_labels.scale}
    for name, measured in (("error_field", fields), ("use_field", use_fields), ("label_field", label_fields)):
        if measured:
            write_fields(run / f"{name}.npz", measured)
    progress("evaluate", len(scenario.methods), len(scenario.methods))
    some = fields[scenario.methods[0]]
    return {
        # Samples without a label, and errors of the labels
        **({} if labels is None else {"labels": measure_labels(labels, truth)}),
        "shorter_side_m": side_m,  # Shorter side of the room
        **describe_drive(recording, methods),
        # Whether tests are held out of the drive, and at how many headings
        "test": {"held_out": bool(scenario.grid.held_out), "headings": some.predicted.shape[1]},
        # Test positions, and how many of them the drive has seen
        "coverage": measure_coverage(some.truth, truth.pose[:, :2]),
        # Drift of the dead-reckoned path: RMS, median and largest error after an SE2 alignment
        "trajectory": measure_trajectory(recording, truth),
        "distances": judge_encoders(recording, truth),  # Errors of the encoders' distances along complete segments
        # Images of the deployment drive, where there is one
        **({} if deployment is None else {"in_use": {"samples": len(deployment.observation)}}),
        "methods": methods,  # Figures of each method, by its name
    }


def predict(
    folder: Path, recording: Recording, deployment: Recording | None = None, device: torch.device = CPU
) -> Predictions:
    """What the method trained in a folder predicts; a deployment drive shows the lean of the tests' camera."""
    positioner = load_positioner(folder, device)
    deployed, lean = adapt(positioner, deployment)
    cells, headings = recording.test_observation.shape[:2]
    images = recording.test_observation.reshape(cells * headings, *recording.test_observation.shape[2:])
    training, poses = positioner.locate_training(recording.observation), find_poses(deployed, images)
    check_predicted(folder, np.concatenate([training, poses.position]))
    return Predictions(training, poses, positioner, deployed, lean)


def _find_labels(folder: Path) -> Labels | None:
    """A recording's labels; None unless both training and test samples have some."""
    labels = open_labels(folder)
    if labels is None or not np.isfinite(labels.pose).all(axis=1).any():
        return None
    return labels if np.isfinite(labels.test_pose).all(axis=(1, 2)).any() else None


def measure_field(maps: Predictions, method: str, truth: Truth | Labels) -> tuple[ErrorField, Alignment]:
    """Error field of a method's predictions, and the alignment that was fitted to the training samples.

    When measured against labels, training and test samples without a label are left out.
    """
    known = np.isfinite(truth.pose).all(axis=1)
    alignment = fit_robust_alignment(maps.training[known], truth.pose[known, :2], METHODS[method].alignment)
    return make_field(maps.poses, truth.test_pose, alignment, with_yaw=isinstance(truth, Truth)), alignment


def measure_misplaced(places: np.ndarray, truth: Truth) -> float:
    """Share of the training images whose aligned positions (N, 2) [m] are more than ``MISPLACED_M`` from the truth."""
    return float((np.linalg.norm(places - truth.pose[:, :2], axis=1) > MISPLACED_M).mean())


def _summarise(field: ErrorField, shorter_side_m: float) -> dict[str, Any]:
    """Errors of all places, RMS over the room's shorter side, and figures of what is accepted."""
    errors = summarise(field.worst)
    # RMS over the room's shorter side
    return {**errors, "relative_rms": errors["rms_m"] / shorter_side_m, **summarise_acceptance(field)}


def measure_grid(field: ErrorField, scenario: Scenario) -> dict[str, float]:
    """Measure how much of the map is flipped, which only a test grid can show."""
    if scenario.grid.held_out:
        return {}
    # Share of the map with the rarer orientation: 0 for a correct map, at most a half
    return {"flipped": measure_flipped(field.truth, field.predicted.mean(axis=1), scenario.grid.spacing_m)}


def measure_labels(labels: Labels, truth: Truth) -> dict[str, float]:
    """Count the samples without a label, and measure the labels' own errors [m], aligned on the training labels."""
    known, test_known = (np.isfinite(pose[..., 0]) for pose in (labels.pose, labels.test_pose))
    alignment = fit_alignment(labels.pose[known, :2], truth.pose[known, :2], "SE2")
    error, test_error = (
        np.linalg.norm(alignment.apply(label[some, :2]) - true[some, :2], axis=-1)
        for label, true, some in (
            (labels.pose, truth.pose, known),
            (labels.test_pose, truth.test_pose, test_known),
        )
    )
    return {
        "unlabelled": int((~known).sum()),
        "test_unlabelled": int((~test_known).sum()),
        "rms_m": find_rms(error),
        "median_m": float(np.median(error)),
        "max_m": float(error.max()),
        "test_rms_m": find_rms(test_error),
        "scale": alignment.scale,
    }


def measure_heading_spread(predicted: np.ndarray) -> float:
    """RMS distance [m] of predictions (C, H, 2) [m] from their mean over a position's headings; 0 for one heading."""
    away = predicted - predicted.mean(axis=1, keepdims=True)
    return float(np.sqrt(np.mean((away**2).sum(axis=-1))))


def measure_trajectory(recording: Recording, truth: Truth) -> dict[str, float]:
    """Drift of the dead-reckoned path: RMS, median and largest error [m] after an SE2 alignment of the entire path."""
    path = dead_reckon(recording)[:, :2]
    driven = truth.pose[recording.reading[:, 1], :2]
    error = np.linalg.norm(fit_alignment(path, driven, "SE2").apply(path) - driven, axis=1)
    return {"rms_m": find_rms(error), "median_m": float(np.median(error)), "max_m": float(error.max())}
