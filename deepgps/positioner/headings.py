"""Yaw of one polar image: a table of ring phases at places that cover the map evenly, with the heading of each.

A turn shifts a polar image in a circle, so the peak of the circular cross-correlation with an image of known heading
is the angle between the two (the visual compass, see ``sim/sensors/visual_compass.py``). The table keeps a few Fourier
coefficients of each image, as bytes: it is about 1.5 KB for each 10 cm x 10 cm of the map, however long the drive.
``heading_fit`` makes it from a method's own map.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np
from scipy import fft
from scipy.spatial import KDTree

from deepgps.positioner.kriging import find_nearest
from sim.geometry import wrap
from sim.sensors.compass_fit import CUTOFF, HIGH_PASS_CYCLES
from sim.sensors.visual_compass import MATCH_FLOOR, MIN_CONTRAST, find_highest

RINGS, FREQUENCIES = 8, 32  # Rings that the table keeps, each the mean of some of the image's, and cycles per turn
ANGLE_SAMPLES = 512  # Samples of the correlation in a turn
NEAREST_ENTRIES, SIMILAR_ENTRIES = 6, 4
"""Entries that an image is compared with: nearest to its position, and most alike, in case the position is wrong."""
MAX_PARALLAX_M = 0.2  # Distance beyond which the parallax between two places no longer grows as fitted [m]
MODE_WIDTH_RAD, MODE_SEPARATION_RAD = np.radians(5.0), np.radians(15.0)
"""Angles of one hypothesis are within the first of its mode; another hypothesis is at least the second away [rad]."""
SCALE_RAD, MIN_SPREAD_RAD = np.radians(1.0), np.radians(0.05)
"""Scale of the Cauchy weights with which angles are averaged, and their least spread [rad]."""
MIN_WEIGHT = 0.05  # A second hypothesis with a smaller weight is left out
CHUNK = 64


@dataclass(frozen=True)
class Yaws:
    """Hypotheses of the yaw of B images in the method's frame, the likelier first; NaN where there is none."""

    yaw: np.ndarray  # Yaw (B, 2) [rad]
    std: np.ndarray  # Its standard deviation (B, 2) [rad]
    # Share of the entries that agree on each (B, 2): a pair adds up to 1 where no entry disagrees with both
    weight: np.ndarray


ARRAYS = ("spectrum", "place", "heading", "parallax", "position_std")


@dataclass(frozen=True)
class HeadingTable:
    """Ring phases of E training images that cover the map evenly."""

    spectrum: np.ndarray  # Fourier coefficients (E, rings * channels, frequencies, 2) int8, of any scale
    place: np.ndarray  # Predicted positions (E, 2) [m]
    heading: np.ndarray  # Headings in the map (E,) [rad]
    parallax: np.ndarray  # Change of the correlation's angle with the place of the other image (E, 2) [rad / m]
    # RMS distance of predictions near by from the straight line on which they were driven, along one axis (E,) [m]:
    # what a method knows of its errors without truth, and less than they are
    position_std: np.ndarray
    chirality: int  # 1; -1 where the map is mirrored, so that a turn to the left is one to the right in the map
    std_factor: float  # Standard deviation of a yaw over the spread of the angles that it is the mean of

    def find(self, images: np.ndarray, positions: np.ndarray) -> Yaws:
        """Yaw of polar images (B, rings, sectors, channels) taken at predicted positions (B, 2) [m]."""
        chunks = [slice(start, start + CHUNK) for start in range(0, len(images), CHUNK)]
        found = [self._find(take_phases(images[chunk]), positions[chunk]) for chunk in chunks]
        return (
            Yaws(*(np.concatenate([np.empty((0, 2)), *column]) for column in zip(*found, strict=True)))
            if found
            else (Yaws(*np.empty((3, 0, 2))))
        )

    def find_position_std(self, positions: np.ndarray) -> np.ndarray:
        """Standard deviation of predicted positions (B, 2) along one axis (B,) [m]; see ``position_std``."""
        return np.sqrt((self.position_std[self._find_nearest(positions)] ** 2).mean(axis=1))

    def pack(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """The table as arrays and as what JSON holds, from which ``unpack`` makes it again."""
        numbers = {"chirality": self.chirality, "std_factor": self.std_factor}
        return {name: getattr(self, name) for name in ARRAYS}, numbers

    @classmethod
    def unpack(cls, arrays: Mapping[str, np.ndarray], numbers: Mapping[str, Any]) -> Self:
        """The table that was packed; raises KeyError where a part is missing."""
        parts = {name: np.asarray(arrays[name]) for name in ARRAYS}
        return cls(**parts, chirality=int(numbers["chirality"]), std_factor=float(numbers["std_factor"]))

    @cached_property
    def _tree(self) -> KDTree:
        return KDTree(self.place)

    @cached_property
    def _phases(self) -> np.ndarray:
        return _normalise(self.spectrum[..., 0] + 1j * self.spectrum[..., 1].astype(np.float32))

    @cached_property
    def _looks(self) -> tuple[np.ndarray, np.ndarray]:
        return learn_looks(self._phases)

    def _find_nearest(self, positions: np.ndarray) -> np.ndarray:
        return find_nearest(self._tree, positions, NEAREST_ENTRIES)[1]

    def _find_alike(self, phases: np.ndarray) -> np.ndarray:
        known, mean = self._looks
        return find_largest(take_looks(phases, mean) @ known.T, SIMILAR_ENTRIES)

    def _find(self, phases: np.ndarray, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Yaw, standard deviation and weight (B, 2) of images with these phases (B, L, K)."""
        rows = np.concatenate([self._find_nearest(positions), self._find_alike(phases)], axis=1)
        angle, height = correlate(self._phases[rows], phases)
        unexplained = np.maximum(1.0 - height**2, 0.0) + MATCH_FLOOR
        power = (np.abs(phases) ** 2).sum(axis=1)
        values = 2.0 * power.sum(axis=1) ** 2 / np.maximum((power**2).sum(axis=1), 1e-30)
        share = np.where(height > 0.0, (unexplained / unexplained[..., :1]) ** (-values[:, None, None] / 2.0), 0.0)
        trust = (share / np.maximum(share.sum(axis=2, keepdims=True), 1e-30)) / (unexplained[..., :1] + 0.01) ** 2
        away = positions[:, None] - self.place[rows]
        distance = np.linalg.norm(away, axis=2, keepdims=True)
        away = away * np.where(
            distance < 3.0 * MAX_PARALLAX_M, np.minimum(1.0, MAX_PARALLAX_M / np.maximum(distance, 1e-9)), 0
        )
        shift = self.heading[rows] + (self.parallax[rows] * away).sum(axis=2)
        yaw = shift[..., None] + self.chirality * angle
        blank = ~np.abs(phases).any(axis=(1, 2))
        trust[blank] = 0.0
        return self._choose(yaw.reshape(len(yaw), -1), trust.reshape(len(yaw), -1))

    def _choose(self, yaw: np.ndarray, trust: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The two likeliest hypotheses (B, 2) among angles (B, M) with these weights."""
        first, spread, weight = _find_mode(yaw, trust)
        other = np.where(np.abs(wrap(yaw - first[:, None])) > MODE_SEPARATION_RAD, trust, 0.0)
        second, other_spread, other_weight = _find_mode(yaw, other)
        both = np.stack([weight, other_weight], axis=1) / np.maximum(trust.sum(axis=1), 1e-30)[:, None]
        both[both < MIN_WEIGHT] = 0.0
        found, std = np.stack([first, second], axis=1), self.std_factor * np.stack([spread, other_spread], axis=1)
        return np.where(both > 0.0, wrap(found), np.nan), np.where(both > 0.0, std, np.nan), both


def take_phases(images: np.ndarray) -> np.ndarray:
    """Fourier coefficients (B, L, K) complex64 of polar images (B, rings, sectors, channels), squares adding up to 1.

    Rings count by their circumference, and frequencies are filtered as by the compass. Zeros for a blank image.
    """
    sectors = images.shape[2]
    pooled, passed = pool_rings(images), filter_frequencies(sectors)
    found = np.asarray(fft.rfft(np.moveaxis(pooled, 3, 1)))[..., 1 : len(passed) + 1]
    found = found * (passed * np.sqrt(np.arange(pooled.shape[1]) + 0.5)[:, None]).astype(np.float32)
    size = np.square(pooled).sum(axis=(1, 2, 3)) * sectors  # not exactly the energy, but of its order
    blank = np.square(np.abs(found)).sum(axis=(1, 2, 3)) <= MIN_CONTRAST * size
    found[blank] = 0.0
    return _normalise(found.reshape(len(images), -1, len(passed)))


def pool_rings(images: np.ndarray) -> np.ndarray:
    """The rings that the table keeps (B, L, sectors, channels) float32 of images (B, rings, sectors, channels)."""
    return pool(images.astype(np.float32), RINGS, axis=1)


def pool(values: np.ndarray, count: int, axis: int) -> np.ndarray:
    """Means of ``count`` parts of an axis, as equal as can be; of an axis that is shorter, its values."""
    size = values.shape[axis]
    first = choose_parts(size, count)
    number = np.diff(np.append(first, size)).astype(np.float32)
    pooled = np.add.reduceat(values, first, axis=axis)
    pooled /= number.reshape([-1 if along == axis else 1 for along in range(values.ndim)])
    return pooled


def choose_parts(size: int, count: int) -> np.ndarray:
    """First of the values of each of ``count`` parts, as equal as can be, or of as many as there are values."""
    return np.arange(min(count, size)) * size // min(count, size)


def filter_frequencies(sectors: int) -> np.ndarray:
    """Factor of each frequency that the table keeps, from one cycle per turn on."""
    frequency = np.arange(1, min(FREQUENCIES, sectors // 2 - 1) + 1)
    return np.exp(-((frequency / (CUTOFF * sectors)) ** 2)) * frequency / (frequency + HIGH_PASS_CYCLES)


def correlate(known: np.ndarray, phases: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The two highest peaks of the correlation of images (B, L, K) with known ones (B, M, L, K), given as coefficients.

    Returns:
        Angle by which the image's camera is turned to the left of the known one's (B, M, 2) [rad], and the correlation
        there (B, M, 2), -1 where there is no second peak.
    """
    cross = np.einsum("nlk,nmlk->nmk", phases.conj(), known)
    curve = np.asarray(fft.irfft(np.pad(cross, ((0, 0), (0, 0), (1, 0))), ANGLE_SAMPLES)) * np.float32(
        ANGLE_SAMPLES / 2
    )
    angle, height = find_highest(curve, 2)
    return angle, np.maximum(height, -1.0)


def _find_mode(angle: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Robust mean of the angles near the mode of angles (B, M), their spread, and their weight, each (B,)."""
    near = np.abs(wrap(angle[:, :, None] - angle[:, None])) < MODE_WIDTH_RAD
    total = np.einsum("nij,nj->ni", near, weight) * (weight > 0.0)
    best, rows = total.argmax(axis=1), np.arange(len(angle))
    mode, near = angle[rows, best], near[rows, best]
    member = np.where(near, weight, 0.0) + 1e-30
    for _ in range(5):
        missed = wrap(angle - mode[:, None])
        robust = member / (1.0 + (missed / SCALE_RAD) ** 2)
        mode = mode + (robust * missed).sum(axis=1) / robust.sum(axis=1)
    spread = np.sqrt((robust * wrap(angle - mode[:, None]) ** 2).sum(axis=1) / robust.sum(axis=1) + MIN_SPREAD_RAD**2)
    return mode, spread, total[rows, best]


def _normalise(phases: np.ndarray) -> np.ndarray:
    size = np.sqrt(np.square(np.abs(phases)).sum(axis=(1, 2), keepdims=True))
    return (phases / np.maximum(size, 1e-12)).astype(np.complex64)


def learn_looks(phases: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What of images with phases (E, L, K) no turn changes (E, L K), and its mean (L K,)."""
    mean = np.sqrt(np.abs(phases)).reshape(len(phases), -1).mean(axis=0)
    return take_looks(phases, mean), mean


def take_looks(phases: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """What of images with phases (B, L, K) no turn changes, without its mean (L K,), of norm 1 (B, L K)."""
    rows = np.sqrt(np.abs(phases)).reshape(len(phases), -1) - mean
    return rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-12)


def find_largest(alike: np.ndarray, most: int) -> np.ndarray:
    """Columns of the largest values of each row (B, E), ``most`` of them or all, in no order."""
    count = min(most, alike.shape[1])
    return np.argpartition(-alike, count - 1, axis=1)[:, :count]
