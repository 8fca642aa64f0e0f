"""Errors of a map by compass before any training, beside those that its own covariance expects."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import KDTree

from deepgps.evaluation.error_field import ErrorField, find_rms
from deepgps.evaluation.measures import measure_flipped_patch
from deepgps.initial_map.stored_map import StoredMap, read_map
from sim.alignment import fit_alignment
from sim.recording.format import Recording, Truth
from sim.settings import CameraMountSettings

UNDECIDED = 0.05
"""A map is undecided if more than this share of the observations may lie elsewhere."""
NEAREST = 8
"""Training observations between which the expected error is interpolated."""
ROUNDING_M = 1e-6


class PlacedMap(NamedTuple):
    """The known positions (n) of a map in the world's frame, beside the truth.

    Attributes:
        position: Positions (n, 2) [m].
        covariance: Their covariances (n, 2, 2) [m^2], estimated from ``samples`` samples.
        expected: Their expected errors (n,) [m].
        truth: True positions of the camera (n, 2) [m].
        samples: Number of samples.
    """

    position: np.ndarray
    covariance: np.ndarray
    expected: np.ndarray
    truth: np.ndarray
    samples: int


def place_map(stored: StoredMap, place: np.ndarray) -> PlacedMap:
    """Align a map with the true positions of the camera at its observations (N, 2) [m] by a rigid motion (SE2)."""
    known = stored.known
    alignment = fit_alignment(stored.places[known], place[known], "SE2")
    return PlacedMap(
        alignment.apply(stored.places[known]),
        alignment.rotation @ stored.covariance[known] @ alignment.rotation.T,
        stored.expected[known],
        place[known],
        int(stored.samples),
    )


def is_undecided(training: Mapping[str, Any]) -> bool:
    """Whether a map is undecided, by its entry in ``training.json``."""
    return training["undecided"] > UNDECIDED


def judge_map(placed: PlacedMap) -> dict[str, float]:
    """Measure a map against the truth.

    Returns:
        ``rms_m``, ``median_m``, ``max_m``; ``flipped_m2``, the area of the largest connected patch that the map turns
        over; and ``nees``, the normalised estimation error squared over its expectation of 2: 1 for a covariance that
        is right (Bar-Shalom et al., "Estimation with Applications to Tracking and Navigation", 2001, Sec. 5.4).
    """
    apart = placed.position - placed.truth
    error = np.linalg.norm(apart, axis=1)
    return {
        "rms_m": find_rms(error),
        "median_m": float(np.median(error)),
        "max_m": float(error.max()),
        "flipped_m2": measure_flipped_patch(placed.truth, placed.position),
        "nees": measure_nees(placed.covariance, placed.samples, apart),
    }


def measure_nees(covariance: np.ndarray, samples: int, error: np.ndarray) -> float:
    """Mean over errors (n, 2) [m] of e^T C^-1 e / 2, with covariances (n, 2, 2) [m^2] of ``samples`` samples each.

    The inverse of a covariance of s samples is too large by s / (s - 3) (Hartlap et al., A&A 464, 2007, for p = 2).
    """
    inverse = np.linalg.inv(covariance + ROUNDING_M**2 * np.eye(2))
    squared = np.einsum("na,nab,nb->n", error, inverse, error)
    return float(np.mean(squared)) / 2.0 * (samples - 3) / samples


def add_expected(field: ErrorField, placed: PlacedMap) -> ErrorField:
    """The error field with the error that the map expects at each test position, as RMS.

    Args:
        field: The error field of the method that began with the map.
        placed: The map.
    """
    away, nearest = KDTree(placed.position).query(field.truth, min(NEAREST, len(placed.position)))
    weight = 1.0 / np.maximum(away, ROUNDING_M) ** 2
    variance = (weight * placed.expected[nearest] ** 2).sum(axis=1) / weight.sum(axis=1)
    return replace(field, expected=np.sqrt(variance))


def read_known_map(folder: Path) -> StoredMap | None:
    """The map in a method's folder, if it has one of at least two positions."""
    stored = read_map(folder)
    return stored if stored is not None and stored.known.sum() >= 2 else None


def find_true_camera(recording: Recording, truth: Truth) -> np.ndarray:
    """True positions of the camera at the observations (N, 2) [m], which the map is of; poses are those of the axle."""
    mount = CameraMountSettings.model_validate(recording.manifest.settings.get("camera_mount", {}))
    ahead = np.stack([np.cos(truth.pose[:, 2]), np.sin(truth.pose[:, 2])], axis=1)
    return truth.pose[:, :2] + mount.ahead_m * ahead + mount.left_m * ahead[:, ::-1] * [-1.0, 1.0]
