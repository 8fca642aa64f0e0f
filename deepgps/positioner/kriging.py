"""Ordinary kriging: what would be seen at a position, from what was seen at the nearest places of the map.

All components of an observation share one covariance of position, Matern's with smoothness 3/2 and a nugget for noise
(Stein, "Interpolation of Spatial Data", 1999). So a prediction is a weighted mean of a few observations, with weights
that depend on positions alone.
"""

from dataclasses import dataclass
from itertools import product
from typing import NamedTuple, Self

import numpy as np
from scipy.spatial import KDTree

NEIGHBOURS, NEIGHBOURS_OF_VECTORS = 12, 24  # Places from which an image or another observation is predicted


class Kernel(NamedTuple):
    """Covariance of two observations d apart: ``(1 + sqrt(3) d / length) exp(-sqrt(3) d / length)``, at 0 + nugget."""

    length_m: float
    nugget: float


KERNELS = tuple(
    Kernel(*pair)
    for pair in (*product((0.05, 0.1, 0.2, 0.4, 0.8), (0.005, 0.02, 0.05, 0.15)), *product((0.4, 0.8, 1.6), (1e-6,)))
)  # To try; those of the least nugget for observations without noise


@dataclass(frozen=True)
class Weights:
    """Weights by which n observations are predicted from those at k places each."""

    index: np.ndarray  # The places (n, k)
    both: np.ndarray  # Weight of each, which add up to 1, and its derivatives by x and y (n, 3, k) [1, 1 / m]
    variance: np.ndarray  # Variance of the prediction's error over that of far places (n,), with the nugget

    def predict(self, values: np.ndarray) -> np.ndarray:
        """Predictions of values (N, K) of the places, and their derivatives (n, 3, K) float32 [1, 1 / m]."""
        return self.both.astype(np.float32) @ values.take(self.index, axis=0).astype(np.float32, copy=False)


@dataclass(frozen=True)
class Surroundings:
    """The k places around each of n positions, which may then move a little."""

    index: np.ndarray  # Their numbers (n, k)
    places: np.ndarray  # (2, n, k) [m]
    inverse: np.ndarray  # Inverse of ``[C 1; 1' 0]`` with the covariance C of the places (n, k + 1, k + 1)
    kernel: Kernel

    @classmethod
    def find(cls, places: np.ndarray, index: np.ndarray, kernel: Kernel) -> Self:
        """Those of the places (N, 2) [m] with numbers ``index`` (n, k)."""
        (count, size), around = index.shape, places.T.take(index, axis=1)
        x, y = around[..., None] - around[:, :, None]
        apart = np.sqrt(3.0) / kernel.length_m * np.sqrt(x * x + y * y)
        matrix = np.ones((count, size + 1, size + 1))
        matrix[:, :size, :size] = (1.0 + apart) * np.exp(-apart) + kernel.nugget * np.eye(size)
        matrix[:, size, size] = 0.0
        return cls(index, around, np.linalg.inv(matrix), kernel)

    def krige(self, position: np.ndarray) -> Weights:
        """Weights at positions (n, 2) [m].

        They solve ``[C 1; 1' 0] [w; m] = [c; 1]``: c is the covariance of the places with the position.
        """
        rate, size = np.sqrt(3.0) / self.kernel.length_m, self.index.shape[1]
        away = rate * (self.places - position.T[:, :, None])
        apart = np.hypot(*away)
        fall = np.exp(-apart)
        known = np.zeros((len(position), 3, size + 1))
        known[:, 0, :size], known[:, 0, size] = (1.0 + apart) * fall, 1.0
        known[:, 1:, :size] = np.swapaxes(rate * fall * away, 0, 1)
        solved = known @ self.inverse
        variance = 1.0 + self.kernel.nugget - np.einsum("nk,nk->n", solved[:, 0], known[:, 0])
        return Weights(self.index, solved[:, :, :size], variance)


def krige(position: np.ndarray, places: np.ndarray, index: np.ndarray, kernel: Kernel) -> Weights:
    """Weights at positions (n, 2) of the places (N, 2) [m] with numbers ``index`` (n, k)."""
    return Surroundings.find(places, index, kernel).krige(position)


def compare(values: np.ndarray, own: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Products (n, k, k) of the differences between values (N, K) with numbers ``index`` (n, k) and own ones (n, K).

    Weights add up to 1, so that these give all products of errors and derivatives.
    """
    away = values.take(index, axis=0) - own[:, None]
    return (away @ np.swapaxes(away, 1, 2)).astype(float)


def choose_neighbours(has_pixels: bool) -> int:
    """The number of places from which an observation is predicted: vectors without noise profit from more."""
    return NEIGHBOURS if has_pixels else NEIGHBOURS_OF_VECTORS


def find_nearest(tree: KDTree, places: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Distance [m] and number of the nearest of a tree's places for each of (B, 2) [m], both (B, at most count)."""
    count = min(count, tree.n)
    distance, index = tree.query(places, count)
    return np.reshape(distance, (-1, count)), np.reshape(index, (-1, count))


def limit(move: np.ndarray, length: float) -> np.ndarray:
    """Moves (n, 2) [m], none of which is longer than this."""
    return move / np.maximum(1.0, np.hypot(move[:, :1], move[:, 1:]) / length)


def find_others(
    places: np.ndarray, first: np.ndarray, last: np.ndarray, rows: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """The nearest places of other segments around ``rows`` (n,) of N places (n, count), and which have enough.

    A place is on segments ``first`` (N,) to ``last`` (N,).
    """
    tree, found, wide = KDTree(places), np.zeros((len(rows), count), int), 4 * count
    missing = np.arange(len(rows))
    if tree.n < count:
        return found, np.zeros(len(rows), bool)
    while True:
        wide = min(wide, tree.n)
        around = find_nearest(tree, places[rows[missing]], wide)[1]
        own = rows[missing, None]
        other = (first[around] > last[own]) | (last[around] < first[own])
        order = np.argsort(~other, axis=1, kind="stable")[:, :count]
        enough = other.sum(axis=1) >= count
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
    products = compare(values, values[rows], others)

    def find_cost(kernel: Kernel) -> float:
        weights = krige(places[rows], places, others, kernel)
        weight = weights.both[:, 0]
        error = np.einsum("nk,nkl,nl->n", weight, products, weight) / weights.variance
        scale = max(float(np.median(error)), 1e-12)  # most observations may be alike
        return float((np.log(weights.variance * scale) + error / scale).mean())

    return min(KERNELS, key=find_cost)
