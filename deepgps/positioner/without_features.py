"""Positioners that compare no features: the nearest stored scan, trilateration, and a plugin's arrays.

The nearest stored scan is what the paper's PCA + KNN learns (its appendix). Trilateration, positions from distances to
known landmarks, is what explicit positioning applies to observations.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

import numpy as np
import torch
from threadpoolctl import threadpool_limits

from deepgps.config.methods import find_method
from deepgps.data.features import check_shape
from deepgps.positioner.positioner import Packed, Positioner
from sim.errors import WorkError
from sim.plugins import name_code

NAMES = ("mean", "axes", "known", "places")


@dataclass(frozen=True)
class ScanPositioner(Positioner):
    """Positions by the nearest stored scan, in principal components."""

    kind = "scans"

    mean: np.ndarray  # Mean scan (rays,) [m]
    axes: np.ndarray  # Principal axes (components, rays)
    known: np.ndarray  # Stored scans (N headings, components) float32, with those of one position adjacent
    places: np.ndarray  # Their positions (N, 2) float64 [m]
    turns: int  # Number of scans stored for each position

    def __call__(self, observations: np.ndarray) -> np.ndarray:
        from sklearn.metrics import pairwise_distances_argmin

        check_shape(observations[:, 0], self.mean.shape)
        if not len(observations):
            return np.zeros((0, 2))
        with threadpool_limits(1):  # which of two equal neighbours is found depends on how the work is divided
            nearest = pairwise_distances_argmin(self.project(np.asarray(observations[:, 0])), self.known)
        return self.places[nearest // self.turns]

    def project(self, scans: np.ndarray) -> np.ndarray:
        """Principal components (n, components) float32 of scans (n, rays) [m]."""
        return (scans - self.mean) @ self.axes.T

    def pack(self) -> Packed:
        return Packed({name: torch.from_numpy(getattr(self, name)) for name in NAMES}, {"headings": self.turns})

    @classmethod
    def unpack(cls, packed: Packed) -> Self:
        mean, axes, known, places = (packed.tensors[name].numpy() for name in NAMES)
        return cls(mean, axes, known, places, packed.numbers["headings"])


@dataclass(frozen=True)
class ArrayPositioner(Positioner):
    """Positions by a plugin's method from the arrays that it has learned."""

    kind = "arrays"

    method: str  # Name of the method, whose plugin must be loaded
    arrays: Mapping[str, np.ndarray]  # What it has learned, by name

    def __call__(self, observations: np.ndarray) -> np.ndarray:
        method = find_method(self.method)
        assert method.predict is not None
        found, shape = np.asarray(method.predict(self.arrays, np.asarray(observations)), float), (len(observations), 2)
        if found.shape != shape:
            raise WorkError(f"{name_code(method.predict)} must return positions {shape}, not {found.shape}")
        return found

    def pack(self) -> Packed:
        arrays = {name: torch.from_numpy(np.ascontiguousarray(array)) for name, array in self.arrays.items()}
        return Packed(arrays, {"method": self.method})

    @classmethod
    def unpack(cls, packed: Packed) -> Self:
        return cls(packed.numbers["method"], {name: tensor.numpy() for name, tensor in packed.tensors.items()})


ROUNDS = 20
POINT_BATCH = 1000
DAMPING = 1e-12


@dataclass(frozen=True)
class LandmarkPositioner(Positioner):
    """Positions by trilateration from landmarks."""

    kind = "landmarks"

    landmark: np.ndarray  # Positions of the landmarks (M, 2) float64 [m]
    reach_m: float  # A distance of this or more only means that a landmark is not seen [m]; infinite: all are seen

    def __call__(self, observations: np.ndarray) -> np.ndarray:
        check_shape(observations, (len(self.landmark),))
        starts = range(0, len(observations), POINT_BATCH)
        found = [
            trilaterate(self.landmark, observations[start : start + POINT_BATCH], self.reach_m) for start in starts
        ]
        return np.concatenate([np.zeros((0, 2)), *found])

    def pack(self) -> Packed:
        reach_m = None if np.isinf(self.reach_m) else self.reach_m
        return Packed({"landmark": torch.from_numpy(self.landmark)}, {"reach_m": reach_m})

    @classmethod
    def unpack(cls, packed: Packed) -> Self:
        reach_m = packed.numbers["reach_m"]
        return cls(packed.tensors["landmark"].numpy(), np.inf if reach_m is None else float(reach_m))


def find_seen(distance: np.ndarray, reach_m: float) -> np.ndarray:
    """Which of the distances (..., M) [m] were measured: those below the reach, rounded to the distances' type."""
    return distance < distance.dtype.type(reach_m)


def trilaterate(landmark: np.ndarray, distance: np.ndarray, reach_m: float) -> np.ndarray:
    """Points (B, 2) [m] whose distances to landmarks (M, 2) [m] fit those measured (B, M) [m], by least squares.

    The first guess solves ``2 (m_k - m) . p = |m_k|^2 - x_k^2 - mean_k(|m_k|^2 - x_k^2)``, linear in p (m: the mean of
    the landmarks seen); Gauss-Newton then minimises ``sum_k (|m_k - p| - x_k)^2``, the upper line of the paper's Eq. 6.
    Landmarks at the distance ``reach_m`` and beyond are not seen; two or fewer do not determine a point, and give one
    that fits them.
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
    weighted = rows * weight[..., None]
    normal = np.einsum("bmi,bmj->bij", weighted, rows)
    normal += (DAMPING * (1.0 + np.trace(normal, axis1=1, axis2=2)))[:, None, None] * np.eye(2)
    return np.linalg.solve(normal, np.einsum("bmi,bm->bi", weighted, value)[..., None])[..., 0]
