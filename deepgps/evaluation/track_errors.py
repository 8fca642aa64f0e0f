"""Errors of a tracked drive against the truth, for each of its paths."""

import numpy as np

from deepgps.evaluation.error_field import find_rms
from deepgps.evaluation.trajectory import measure_ate, measure_rpe
from deepgps.tracking.track import Track, TrackedPath
from sim.alignment import Alignment
from sim.geometry import wrap
from sim.recording.turns import NO_IMAGE

APART = 10
"""Images between the two poses of a relative error."""


def measure_track(track: Track, alignment: Alignment, true: np.ndarray) -> dict[str, dict[str, float]]:
    """Errors of each path at the observations; where it tells nothing, they are left out.

    Args:
        track: The tracked drive.
        alignment: From the method's frame to the world's, fitted on training samples.
        true: True poses of its images (M, 3): x, y [m], yaw [rad].
    """
    seen = track.observation != NO_IMAGE
    return {
        name: _measure(take_in_world(path, alignment)[seen], true[seen], path.accepted[seen])
        for name, path in track.paths.items()
    }


def take_in_world(path: TrackedPath, alignment: Alignment) -> np.ndarray:
    """Poses of a path in the world's frame (M, 3)."""
    return np.column_stack([alignment.apply(path.pose[:, :2]), alignment.turn(path.pose[:, 2])])


def measure_distances(path: TrackedPath, alignment: Alignment, true: np.ndarray) -> np.ndarray:
    """Errors of positions of a path (M,) [m], given the true poses of its images (M, 3)."""
    return np.hypot(*(take_in_world(path, alignment) - true)[:, :2].T)


def _measure(found: np.ndarray, true: np.ndarray, accepted: np.ndarray) -> dict[str, float]:
    known = np.isfinite(found[:, :2]).all(axis=1)
    found, true, accepted = found[known], true[known], accepted[known]
    if not len(found):
        return {"images": 0}
    error = np.hypot(*(found - true)[:, :2].T)
    figures = {
        "images": len(found),
        "rms_m": find_rms(error),
        "median_m": float(np.median(error)),
        "p95_m": float(np.percentile(error, 95.0)),
        "max_m": float(error.max()),
        "ate_m": measure_ate(found[:, :2], true[:, :2]),
        "accepted": float(accepted.mean()),
    }
    if accepted.any():
        figures |= {"rms_accepted_m": find_rms(error[accepted]), "max_accepted_m": float(error[accepted].max())}
    directed = np.isfinite(found[:, 2])
    if directed.any():
        figures["yaw_rms_deg"] = float(np.degrees(find_rms(wrap(found[:, 2] - true[:, 2])[directed])))
    place_m, turn_rad = measure_rpe(found, true, APART) if len(found) > APART else (np.nan, np.nan)
    if np.isfinite(place_m):
        figures["rpe_m"], figures["rpe_deg"] = place_m, float(np.degrees(turn_rad))
    return figures
