"""Errors of a tracked drive against the truth, for each of its paths, as they are usually given.

Absolute (ATE) and relative (RPE) errors, here in the plane: Sturm et al., "A benchmark for the evaluation of RGB-D SLAM
systems", IROS 2012; the same as ``evo_ape --align`` and ``evo_rpe --all_pairs``, which a test compares.
"""

import numpy as np

from deepgps.evaluation.error_field import find_rms
from deepgps.tracking.motion import rotate
from deepgps.tracking.track import Track, TrackedPath
from sim.alignment import Alignment, fit_alignment
from sim.geometry import wrap
from sim.recording.turns import NO_IMAGE


def measure_ate(found: np.ndarray, true: np.ndarray) -> float:
    """Absolute trajectory error [m]: RMS distance of positions (n, 2) [m] after their own rigid alignment."""
    aligned = fit_alignment(found, true, "SE2").apply(found)
    return float(np.sqrt(np.square(aligned - true).sum(axis=1).mean()))


def measure_rpe(found: np.ndarray, true: np.ndarray, apart: int) -> tuple[float, float]:
    """Relative pose error: RMS of the errors of all motions between poses (n, 3) that are so many images apart.

    A motion of which a yaw is NaN does not count; NaN if none is left.

    Args:
        found: Poses x, y [m], yaw [rad] (n, 3).
        true: The true ones.
        apart: Number of images from the first to the second pose of each motion; less than n.

    Returns:
        Of the way [m] and of the turn [rad].
    """
    (way, turn), (true_way, true_turn) = (_find_motions(pose, apart) for pose in (found, true))
    known = np.isfinite(turn)
    if not known.any():
        return np.nan, np.nan
    place = np.sqrt(np.square(way - true_way)[known].sum(axis=1).mean())
    return float(place), float(np.sqrt(np.square(wrap(turn - true_turn)[known]).mean()))


def _find_motions(pose: np.ndarray, apart: int) -> tuple[np.ndarray, np.ndarray]:
    """Ways (n - apart, 2) [m] in the frame of the first pose of each, and turns [rad]."""
    away = pose[apart:] - pose[:-apart]
    return (rotate(-pose[:-apart, 2]) @ away[:, :2, None])[..., 0], away[:, 2]


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
