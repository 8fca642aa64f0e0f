"""Ordinary kriging: what would be seen at a position, from what was seen at the nearest places of the map.

All components of an observation share one covariance of position, Matern's with smoothness 3/2 and a nugget for noise
(Stein, "Interpolation of Spatial Data", 1999). So a prediction is a weighted mean of a few observations, with weights
that depend on positions alone.
"""

from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

NEIGHBOURS = 12  # Places from which an observation is predicted


class Kernel(NamedTuple):
    """Covariance of two observations d apart: ``(1 + sqrt(3) d / length) exp(-sqrt(3) d / length)``, at 0 + nugget."""

    length_m: float
    nugget: float


KERNELS = tuple(Kernel(*pair) for pair in product((0.05, 0.1, 0.2, 0.4, 0.8), (0.005, 0.02, 0.05, 0.15)))  # To try


@dataclass(frozen=True)
class Weights:
    """Weights by which n observations are predicted from those at k places each."""

    index: np.ndarray  # The places (n, k)
    weight: np.ndarray  # Weight of each (n, k) float32; they add up to 1
    gradient: np.ndarray  # Its derivative by x and y of the position (n, 2, k) float32 [1 / m]
    variance: np.ndarray  # Variance of the prediction's error over that of far places (n,), with the nugget

    def predict(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Predictions (n, K) of values (N, K) of the places, and their derivatives (n, 2, K) [1 / m]."""
        near = values[self.index].astype(np.float32, copy=False)
        both = np.concatenate([self.weight[:, None], self.gradient], axis=1) @ near
        return both[:, 0], both[:, 1:]


def krige(position: np.ndarray, places: np.ndarray, index: np.ndarray, kernel: Kernel) -> Weights:
    """Weights at positions (n, 2) of the places (N, 2) [m] with numbers ``index`` (n, k).

    They solve ``[C 1; 1' 0] [w; m] = [c; 1]``: C is the covariance of the places, c that with the position.
    """
    rate, (count, size) = np.sqrt(3.0) / kernel.length_m, index.shape
    away = places[index] - position[:, None]
    apart = rate * np.sqrt(((away[:, :, None] - away[:, None]) ** 2).sum(axis=3))
    matrix = np.ones((count, size + 1, size + 1))
    matrix[:, :size, :size] = (1.0 + apart) * np.exp(-apart) + kernel.nugget * np.eye(size)
    matrix[:, size, size] = 0.0
    distance = rate * np.sqrt((away**2).sum(axis=2))
    fall = np.exp(-distance)
    known = np.zeros((count, size + 1, 3))
    known[:, :size, 0], known[:, size, 0] = (1.0 + distance) * fall, 1.0
    known[:, :size, 1:] = rate**2 * fall[..., None] * away
    solved = np.linalg.solve(matrix, known)
    variance = 1.0 + kernel.nugget - (solved[..., 0] * known[..., 0]).sum(axis=1)
    found = np.swapaxes(solved[:, :size], 1, 2).astype(np.float32)
    return Weights(index, found[:, 0], found[:, 1:], variance)


def find_nearest(tree: KDTree, places: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Distance [m] and number of the nearest of a tree's places for each of (B, 2) [m], both (B, at most count)."""
    count = min(count, tree.n)
    distance, index = tree.query(places, count)
    return np.reshape(distance, (-1, count)), np.reshape(index, (-1, count))


def find_others(
    places: np.ndarray, first: np.ndarray, last: np.ndarray, rows: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The nearest places of other segments around ``rows`` (n,) of N places (n, NEIGHBOURS), and which have enough.

    A place is on segments ``first`` (N,) to ``last`` (N,).
    """
    tree, found, wide = KDTree(places), np.zeros((len(rows), NEIGHBOURS), int), 4 * NEIGHBOURS
    missing = np.arange(len(rows))
    if tree.n < NEIGHBOURS:
        return found, np.zeros(len(rows), bool)
    while True:
        wide = min(wide, tree.n)
        around = find_nearest(tree, places[rows[missing]], wide)[1]
        own = rows[missing, None]
        other = (first[around] > last[own]) | (last[around] < first[own])
        order = np.argsort(~other, axis=1, kind="stable")[:, :NEIGHBOURS]
        enough = other.sum(axis=1) >= NEIGHBOURS
        found[missing[enough]] = np.take_along_axis(around, order, axis=1)[enough]
        missing = missing[~enough]
        if not len(missing) or wide == tree.n:
            return found, ~np.isin(np.arange(len(rows)), missing)
        wide *= 4


def choose_kernel(places: np.ndarray, values: np.ndarray, rows: np.ndarray, others: np.ndarray) -> Kernel:
    """The kernel that makes the values (n, K) at ``rows`` (n,) of the places (N, 2) [m] the likeliest.

    They are predicted from ``others`` (n, k). The likelihood is that of a normal distribution whose scale is the
    median of the squared errors over their variances, and not their mean, which a few wrong places would decide.
    """

    def find_cost(kernel: Kernel) -> float:
        weights = krige(places[rows], places, others, kernel)
        error = ((values[rows] - weights.predict(values)[0]) ** 2).sum(axis=1) / weights.variance
        scale = np.median(error)
        return float((np.log(weights.variance * scale) + error / scale).mean())

    return min(KERNELS, key=find_cost)
