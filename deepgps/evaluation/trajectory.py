"""Errors of a trajectory as they are usually given: absolute (ATE) and relative (RPE), here in the plane.

Sturm et al., "A benchmark for the evaluation of RGB-D SLAM systems", IROS 2012; the same as ``evo_ape --align`` and
``evo_rpe --all_pairs``, which a test compares.
"""

import numpy as np

from deepgps.tracking.motion import rotate
from sim.alignment import fit_alignment
from sim.geometry import wrap


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
