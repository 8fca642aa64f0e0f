"""Errors of a map by compass before any training, beside those that its covariance expects, and its mirrored parts."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from deepgps.data.segments import find_runs
from deepgps.data.turns import compare_headings, find_in_place, take_images, turns_with_images
from deepgps.evaluation.error_field import find_rms
from deepgps.initial_map.stored_map import StoredMap, read_map
from sim.alignment import fit_alignment
from sim.geometry import wrap
from sim.recording.format import Recording, Truth
from sim.recording.turns import Turns, from_array
from sim.settings import CameraMountSettings

MAX_UNDECIDED_SHARE = 0.05  # A map is undecided if more than this share of the observations may lie elsewhere
ROUNDING_M = 1e-6


class PlacedMap(NamedTuple):
    """The known positions (n) of a map in the world's frame, beside the truth."""

    position: np.ndarray  # Positions (n, 2) [m]
    covariance: np.ndarray  # Their covariances (n, 2, 2) [m^2], estimated from ``samples`` samples
    truth: np.ndarray  # True positions of the camera (n, 2) [m]
    samples: int  # Number of samples


def place_map(stored: StoredMap, place: np.ndarray) -> PlacedMap:
    """Align a map with the true positions of the camera at its observations (N, 2) [m] by a rigid motion (SE2)."""
    known = stored.known
    alignment = fit_alignment(stored.places[known], place[known], "SE2")
    return PlacedMap(
        alignment.apply(stored.places[known]),
        alignment.rotation @ stored.covariance[known] @ alignment.rotation.T,
        place[known],
        int(stored.samples),
    )


def is_undecided(training: Mapping[str, Any]) -> bool:
    """Whether a map is undecided, by its entry in ``training.json``."""
    return training["undecided"] > MAX_UNDECIDED_SHARE


def judge_map(placed: PlacedMap) -> dict[str, float]:
    """Measure a map against the truth.

    ``nees``: Bar-Shalom et al., "Estimation with Applications to Tracking and Navigation", 2001, Sec. 5.4.
    """
    apart = placed.position - placed.truth
    error = np.linalg.norm(apart, axis=1)
    return {
        "rms_m": find_rms(error),  # Errors of the map's positions [m]
        "median_m": float(np.median(error)),  # Errors of the map's positions [m]
        "max_m": float(error.max()),  # Errors of the map's positions [m]
        # Normalised estimation error squared over its expectation of 2: 1 for a covariance that is right
        "nees": measure_nees(placed.covariance, placed.samples, apart),
    }


def measure_nees(covariance: np.ndarray, samples: int, error: np.ndarray) -> float:
    """Mean over errors (n, 2) [m] of e^T C^-1 e / 2, with covariances (n, 2, 2) [m^2] of ``samples`` samples each.

    The inverse of a covariance of s samples is too large by s / (s - 3) (Hartlap et al., A&A 464, 2007, for p = 2).
    """
    inverse = np.linalg.inv(covariance + ROUNDING_M**2 * np.eye(2))
    squared = np.einsum("na,nab,nb->n", error, inverse, error)
    return float(np.mean(squared)) / 2.0 * (samples - 3) / samples


def read_known_map(folder: Path) -> StoredMap | None:
    """The map in a method's folder, if it has one of at least two positions."""
    stored = read_map(folder)
    return stored if stored is not None and stored.known.sum() >= 2 else None


def find_true_camera(recording: Recording, truth: Truth) -> np.ndarray:
    """True positions of the camera at the observations (N, 2) [m], which the map is of; poses are those of the axle."""
    mount = CameraMountSettings.model_validate(recording.manifest.settings.get("camera_mount", {}))
    ahead = np.stack([np.cos(truth.pose[:, 2]), np.sin(truth.pose[:, 2])], axis=1)
    return truth.pose[:, :2] + mount.ahead_m * ahead + mount.left_m * ahead[:, ::-1] * [-1.0, 1.0]


AGREEMENT_RAD = 0.35  # A turn of the map agrees with the compass within this angle [rad]
MIN_SEGMENT_M = 0.3  # Shorter segments have no direction that counts [m]
PART_GAP_M = 0.15  # Segments that come so near to each other on the map belong to one part [m]
MIN_SEGMENTS = 3  # Segments that a part has at least


def find_turned_parts(positions: np.ndarray, recording: Recording) -> dict[str, Any]:
    """Compare the turns of a map (N, 2) [m], mirrored or not, with those that images show; for ``metrics.json``."""
    if (turns := turns_with_images(recording)) is None:
        return {}
    runs = [run for run in find_runs(recording) if len(run) >= 2]
    index = [recording.reading[run, 1] for run in runs]
    ends = np.array([positions[seen[-1]] - positions[seen[0]] for seen in index])
    length = np.linalg.norm(ends, axis=1)
    before, angle = _measure(recording, turns, runs)
    usable = (length[before] > MIN_SEGMENT_M) & (length[before + 1] > MIN_SEGMENT_M)
    before, angle = before[usable], angle[usable]
    heading = np.arctan2(ends[:, 1], ends[:, 0])
    turned = heading[before + 1] - heading[before]
    right = max((_agree(turned, sign * angle) for sign in (1.0, -1.0)), key=np.sum)
    votes, against = np.zeros(len(runs)), np.zeros(len(runs))
    for side in (0, 1):
        np.add.at(votes, before + side, 1)
        np.add.at(against, before + side, ~right)
    wrong = np.flatnonzero((votes > 0) & (against == votes))
    parts = [part for part in _group(wrong, index, positions) if len(part) >= MIN_SEGMENTS]
    share = length[np.concatenate([np.empty(0, int), *parts])].sum() / max(length.sum(), 1e-9)
    seen = [np.unique(np.concatenate([index[segment] for segment in part])) for part in parts]
    return {
        "turned": {
            # Share of the distance driven in parts of the map that are mirrored or turned by the compass
            "share": round(float(share), 4),
            "parts": sorted(map(len, seen), reverse=True),  # Observations of each such part
            "turns": len(before),  # Turns that were compared
        }
    }


def _measure(recording: Recording, turns: Turns, runs: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Segments (T,) after which the robot turned in place, and the angles that the images show (T,) [rad]."""
    begins = {int(run[0]): number for number, run in enumerate(runs)}
    turns = from_array(turns.array[find_in_place(turns)])
    begun = np.array([begins.get(after, 0) for after in turns.after.tolist()], int)
    last = np.array([recording.reading[run[-1], 1] for run in runs])
    joined = (begun > 0) & (last[begun - 1] == turns.before)
    before, after = take_images(recording, from_array(turns.array[joined]))
    number = np.arange(len(before))
    headings = compare_headings(np.concatenate([before, after]), number, len(before) + number)
    return begun[joined][headings.clear] - 1, headings.turn[headings.clear]


def _agree(turned: np.ndarray, angle: np.ndarray) -> np.ndarray:
    return np.abs(wrap(turned - angle)) < AGREEMENT_RAD


def _group(wrong: np.ndarray, index: list[np.ndarray], positions: np.ndarray) -> list[np.ndarray]:
    """Segments of each part: those that follow one another, or come near to each other on the map."""
    if not len(wrong):
        return []
    owner = np.repeat(np.arange(len(wrong)), [len(index[segment]) for segment in wrong])
    near = KDTree(positions[np.concatenate([index[segment] for segment in wrong])]).query_pairs(
        PART_GAP_M, output_type="ndarray"
    )
    follows = np.flatnonzero(np.diff(wrong) == 1)
    one, other = np.append(owner[near[:, 0]], follows), np.append(owner[near[:, 1]], follows + 1)
    graph = csr_array((np.ones(len(one)), (one, other)), shape=(len(wrong), len(wrong)))
    count, part = connected_components(graph, directed=False)
    return [wrong[part == number] for number in range(count)]
