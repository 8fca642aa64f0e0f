"""Trilateration: positions from distances to known landmarks, which explicit positioning applies to observations."""

from dataclasses import dataclass

import numpy as np

from deepgps.data.features import check_shape

ROUNDS = 20
POINTS_AT_ONCE = 1000
DAMPING = 1e-12


@dataclass(frozen=True)
class LandmarkPositioner:
    """Positions by trilateration from landmarks.

    Attributes:
        landmark: Positions of the landmarks (M, 2) float64 [m].
        reach_m: A distance of this or more only means that a landmark is not seen [m]; infinite: all are seen.
    """

    landmark: np.ndarray
    reach_m: float

    def __call__(self, observations: np.ndarray) -> np.ndarray:
        """Positions (B, 2) float64 [m], in the landmarks' frame, of distances (B, M) [m]."""
        check_shape(observations, (len(self.landmark),))
        starts = range(0, len(observations), POINTS_AT_ONCE)
        found = [
            trilaterate(self.landmark, observations[start : start + POINTS_AT_ONCE], self.reach_m) for start in starts
        ]
        return np.concatenate([np.zeros((0, 2)), *found])


def find_seen(distance: np.ndarray, reach_m: float) -> np.ndarray:
    """Which of the distances (..., M) [m] were measured: those below the reach, rounded to the distances' type."""
    return distance < distance.dtype.type(reach_m)


def trilaterate(landmark: np.ndarray, distance: np.ndarray, reach_m: float) -> np.ndarray:
    """Points whose distances to known landmarks fit those measured, by least squares.

    The first guess solves ``2 (m_k - m) . p = |m_k|^2 - x_k^2 - mean_k(|m_k|^2 - x_k^2)``, linear in p (m: the mean of
    the landmarks seen); Gauss-Newton then minimises ``sum_k (|m_k - p| - x_k)^2``, the upper line of the paper's Eq. 6.

    Args:
        landmark: Landmarks (M, 2) [m].
        distance: Measured distances (B, M) [m].
        reach_m: Landmarks at this distance and beyond are not seen.

    Returns:
        Points (B, 2) [m]; two landmarks or fewer do not determine a point, and give one that fits them.
    """
    weight = find_seen(distance, reach_m).astype(float)
    measured = np.asarray(distance, float)
    share = (weight / weight.sum(axis=1, keepdims=True).clip(1.0))[..., None]
    middle = (share * landmark).sum(axis=1, keepdims=True)
    lever = landmark - middle
    square = (landmark**2).sum(axis=1) - measured**2
    known = square - (share[..., 0] * square).sum(axis=1, keepdims=True)
    middle, farthest = middle[:, 0], (weight * measured).max(axis=1)
    point = _hold(_solve(2.0 * lever, known, weight), middle, farthest)
    for _ in range(ROUNDS):
        apart = point[:, None] - landmark
        length = np.linalg.norm(apart, axis=2)
        direction = apart / length.clip(1e-12)[..., None]
        point = _hold(point + _solve(direction, measured - length, weight), middle, farthest)
    return point


def _hold(point: np.ndarray, middle: np.ndarray, farthest: np.ndarray) -> np.ndarray:
    """Limit points (B, 2) to the distance ``farthest`` (B,) from ``middle`` (B, 2), the mean of the landmarks seen.

    True points are never farther from that mean than the largest measured distance; with landmarks that are all wrong,
    Gauss-Newton would diverge.
    """
    away = point - middle
    length = np.linalg.norm(away, axis=1)
    return middle + away * (np.minimum(length, farthest) / length.clip(1e-12))[:, None]


def _solve(rows: np.ndarray, value: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Unknowns (B, 2) of weighted linear equations, rows (B, M, 2), values and weights (B, M)."""
    weighted = rows * weight[..., None]
    normal = np.einsum("bmi,bmj->bij", weighted, rows)
    normal += (DAMPING * (1.0 + np.trace(normal, axis1=1, axis2=2)))[:, None, None] * np.eye(2)
    return np.linalg.solve(normal, np.einsum("bmi,bm->bi", weighted, value)[..., None])[..., 0]
