"""How far to trust one position: how unlike all training images an image is, and a radius that follows from that.

A table holds the features of training images at places that cover the map evenly. The novelty of an image is the mean
distance in features to the most alike of those entries that are near its predicted position, in metres: times the
distance on the map that goes with a distance in features there. So an image of an unknown place is novel, and so is one
that the network puts in the wrong place, where the entries show something else. The search takes as long in a large map
as in a small one. ``confidence_fit`` makes the table and calibrates threshold and radii, without the truth.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np
from scipy.spatial import KDTree

from deepgps.positioner.heading_fit import thin_out
from deepgps.positioner.kriging import find_nearest

CELL_M = 0.05  # The table has one image for each square of the map with sides of this length [m]
COMPONENTS = 64  # Features that are compared, the slowest; more tell no more
NEAREST_ENTRIES, SIMILAR_ENTRIES = 16, 4
"""Entries around a predicted position with which an image is compared, and those most alike, which count."""
LEVELS = (0.68, 0.95)  # Probabilities with which the radii hold the true position
GROWTH = 3  # Power of the novelty with which radii grow where images are novel; measured, and alike in all rooms
CHUNK = 4096


@dataclass(frozen=True)
class Trust:
    """What is known of the positions of B images."""

    # Distance of each image's features to the most alike training features near its position, converted to a distance
    # on the map (B,) [m]
    novelty: np.ndarray
    accepted: np.ndarray  # Whether the novelty is one that images of the drive have (B,) bool
    radius: np.ndarray  # Radii that hold the true position with the probabilities ``LEVELS`` (B, 2) [m]; NaN: unknown


ARRAYS = ("features", "scale", "place", "metres", "map_std")


@dataclass(frozen=True)
class Confidence:
    """Features of E training images that cover the map evenly, and what a novelty says about the error.

    A radius is ``sqrt((a + b novelty^GROWTH)^2 + (q s)^2)``, at most ``reach_m``: a, b by quantile regression, s the
    map's own standard deviation, q the quantile of the length of a standard normal vector in the plane.
    """

    features: np.ndarray  # The first components of their features, divided by ``scale`` (E, K) int8
    scale: np.ndarray  # Size of one step of each component (K,) float32
    place: np.ndarray  # Predicted positions (E, 2) float32 [m]
    # Distance on the map between entries around each over their distance in features (E,) float32 [m]
    metres: np.ndarray
    map_std: np.ndarray  # Standard deviation of the map there, along one axis (E,) float32 [m]; 0 where none is known
    threshold_m: float  # Largest novelty that is accepted [m]
    # Novelty that most images of the drive would have if their own segments had not been driven [m]; larger than
    # ``threshold_m`` where the drive was too short for their positions to be known
    usual_m: float
    refused: float  # Share of these images that would be refused
    slope: np.ndarray  # a [m] and b for each of ``LEVELS`` (2, 2); NaN: too few segments were held out to know
    reach_m: float  # Largest distance between two places of the map

    def find(self, features: np.ndarray, positions: np.ndarray) -> Trust:
        """How far to trust positions (B, 2) [m] of images with these features (B, at least K)."""
        novelty, entry = self.measure(features, positions)
        return Trust(novelty, novelty <= self.threshold_m, self._find_radius(novelty, self.map_std[entry]))

    def measure(self, features: np.ndarray, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Novelty (B,) [m] of images, and the entry (B,) nearest to each position; arguments as for ``find``."""
        rows = find_nearest(self._tree, positions, NEAREST_ENTRIES)[1]
        known = features[:, : len(self.scale)]
        chunks = [slice(start, start + CHUNK) for start in range(0, len(rows), CHUNK)]
        novelty = [self._measure(known[chunk], rows[chunk]) for chunk in chunks]
        return np.concatenate([np.empty(0), *novelty]), rows[:, 0]

    def _measure(self, features: np.ndarray, rows: np.ndarray) -> np.ndarray:
        away = self.features[rows] * self.scale - features[:, None]
        unlike = np.sort(np.sqrt(np.einsum("nek,nek->ne", away, away)), axis=1)[:, :SIMILAR_ENTRIES]
        return (unlike.mean(axis=1) * self.metres[rows].mean(axis=1)).astype(float)

    def _find_radius(self, novelty: np.ndarray, map_std: np.ndarray) -> np.ndarray:
        flat = self.slope[:, 0] + novelty[:, None] ** GROWTH * self.slope[:, 1]
        radius = np.hypot(flat, map_std[:, None] * find_normal_radius(np.array(LEVELS)))
        return np.minimum(np.maximum.accumulate(radius, axis=1), self.reach_m)

    def pack(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """The table as arrays and as what JSON holds, from which ``unpack`` makes it again."""
        known = np.isfinite(self.slope).all()
        numbers = {
            "threshold_m": self.threshold_m,
            "usual_m": self.usual_m,
            "refused": self.refused,
            "slope_m": self.slope.tolist() if known else None,
            "reach_m": self.reach_m,
        }
        return {name: getattr(self, name) for name in ARRAYS}, numbers

    @classmethod
    def unpack(cls, arrays: Mapping[str, np.ndarray], numbers: Mapping[str, Any]) -> Self:
        """The table that was packed; raises KeyError where a part is missing."""
        slope = np.full((2, 2), np.nan) if numbers["slope_m"] is None else np.array(numbers["slope_m"], float)
        return cls(
            **{name: np.asarray(arrays[name]) for name in ARRAYS},
            threshold_m=float(numbers["threshold_m"]),
            usual_m=float(numbers["usual_m"]),
            refused=float(numbers["refused"]),
            slope=slope,
            reach_m=float(numbers["reach_m"]),
        )

    @cached_property
    def _tree(self) -> KDTree:
        return KDTree(self.place)


def find_normal_radius(probability: float | np.ndarray) -> np.ndarray:
    """Radius within which a vector in the plane lies with a probability, in standard deviations along one axis."""
    return np.sqrt(-2.0 * np.log1p(-probability))


def make_table(features: np.ndarray, positions: np.ndarray, std: np.ndarray, rows: np.ndarray) -> Confidence:
    """The table of those observations ``rows`` (n,) of N that stand for their places; it accepts all.

    Features are (N, K), predicted positions (N, 2) [m], and the map's standard deviation at each along one axis (N,)
    [m].
    """
    entry = rows[thin_out(positions[rows], CELL_M)]
    known, place = features[entry, :COMPONENTS], positions[entry]
    scale = np.maximum(np.abs(known).max(axis=0), 1e-12).astype(np.float32) / np.float32(127.0)
    middle = np.linalg.norm(place - place.mean(axis=0), axis=1).max()
    return Confidence(
        features=np.rint(known / scale).astype(np.int8),
        scale=scale,
        place=place.astype(np.float32),
        metres=_convert(known, place),
        map_std=std[entry].astype(np.float32),
        threshold_m=np.inf,
        usual_m=np.inf,
        refused=0.0,
        slope=np.full((len(LEVELS), 2), np.nan),
        reach_m=float(2.0 * middle),
    )


def _convert(known: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Median distance on the map over the distance in features (E,) [m], between each entry and those around it."""
    apart, around = find_nearest(KDTree(place), place, NEAREST_ENTRIES)
    found = np.zeros(len(place), np.float32)
    for start in range(0, len(place), CHUNK):
        part = slice(start, start + CHUNK)
        unlike = np.linalg.norm(known[around[part]] - known[part, None], axis=2)
        other = (apart[part] > 0.0) & (unlike > 0.0)  # an entry is near itself
        ratio = np.divide(apart[part], unlike, out=np.full(unlike.shape, np.nan), where=other)
        seen = other.any(axis=1)
        found[part][seen] = np.nanmedian(ratio[seen], axis=1)
    return found
