"""What training images tell of others: limits of single images, and comparison with those that match them best.

Black, white, covered or frozen images need no map: their limits come from training images. The
correlation is a visual compass's (``deepgps/positioner/headings.py``), which a gain of the light does not change.
Two images of one place correlate well; how well images of different places do, the training images tell.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy import fft
from scipy.spatial import KDTree

from deepgps.data.segments import find_starts, travel
from deepgps.positioner.heading_fit import thin_out
from deepgps.positioner.headings import (
    correlate,
    find_largest,
    find_nearest,
    learn_looks,
    pool,
    pool_rings,
    take_looks,
    take_phases,
)
from sim.recording.format import Recording
from sim.sensors.camera.mount import Upright

CELL_M = 0.05  # Of the training images, one is known in each square of the map with sides of this length [m]
NEAREST_IMAGES, SIMILAR_IMAGES = 4, 4
"""Known images that an image is compared with: those nearest to its predicted position, and those most alike."""
CYCLES, AZIMUTHS = 16, 32
"""Cycles around the circle that are kept of the images' values, and values around it that are compared."""
STEPS = 12  # Steps of brightness, each with as many values, in which the light is compared
CHECKED_IMAGES = 400  # Training images from which limits come, at most
DIFFERENT_PLACE_M = 1.0  # Images farther apart on the map than this, or than half of it, are of different places [m]
NEIGHBOURS = 32  # Images among which one of another segment is looked for
CHUNK = 64


class Comparison(NamedTuple):
    """How B images compare with the known ones."""

    correlation: np.ndarray  # Correlation with the best match (B,)
    # How far values are from those of the match (B,), in steps of 8 bits: the median over ``STEPS`` of the difference
    # of medians. Furniture that covers less than half of the image does not change it
    relit: np.ndarray
    gain: np.ndarray  # Values over those of the match (B,), in the mean over these steps
    away_m: np.ndarray  # Distance of the predicted position from the nearest known image's (B,) [m]


@dataclass(frozen=True)
class KnownImages:
    """Training images that cover the map evenly."""

    place: np.ndarray  # Predicted positions (E, 2) [m]
    phases: np.ndarray  # Their ring phases (E, L, K), as ``take_phases`` gives them
    values: np.ndarray  # Fourier coefficients of their values (E, rings, channels, ``CYCLES`` + 1)
    other_place: float = 0.0  # Correlation that one in a hundred images exceeds with images of other places
    usual_match: float = 0.0  # Correlation that only one training image in a hundred is below
    usual_light: float = np.inf  # ``relit`` that one training image in a hundred exceeds
    # Distance from the nearest image of another segment that one training image in fifty exceeds [m]
    gap_m: float = np.inf

    def compare(
        self,
        images: np.ndarray,
        positions: np.ndarray,
        upright: Upright | None = None,
        apart_m: float = 0.0,
        own: np.ndarray | None = None,
    ) -> Comparison:
        """Compare images (B, rings, sectors, channels) predicted to be at positions (B, 2) [m].

        Args:
            images: The images.
            positions: Predicted positions of the camera.
            upright: What sets them upright; None: they are.
            apart_m: Known images nearer to the position than this are left out [m].
            own: The known image that each of them is itself (B,), which is left out; -1 or None: none.
        """
        own, found = np.full(len(images), -1) if own is None else own, [np.empty((3, 0))]
        for start in range(0, len(images), CHUNK):
            chunk = slice(start, start + CHUNK)
            found.append(self._compare(_set_upright(images[chunk], upright), positions[chunk], apart_m, own[chunk]))
        correlation, relit, gain = np.concatenate(found, axis=1)
        return Comparison(correlation, relit, gain, np.asarray(self._tree.query(positions)[0]))

    def _compare(self, images: np.ndarray, positions: np.ndarray, apart_m: float, own: np.ndarray) -> np.ndarray:
        phases = take_phases(images)
        rows = self._choose(phases, positions, apart_m)
        angle, height = correlate(self.phases[rows], phases)
        best = np.where(rows == own[:, None], -np.inf, height[..., 0]).argmax(axis=1)[:, None]
        row, angle, height = (
            np.take_along_axis(one, best, axis=1)[:, 0] for one in (rows, angle[..., 0], height[..., 0])
        )
        return np.stack([height, *compare_light(take_values(images), turn(self.values[row], angle))])

    def _choose(self, phases: np.ndarray, positions: np.ndarray, apart_m: float) -> np.ndarray:
        """The known images (B, M) with which images with these phases (B, L, K) are compared."""
        known, mean = self._looks
        alike = take_looks(phases, mean) @ known.T
        if not apart_m:
            near = find_nearest(self._tree, positions, NEAREST_IMAGES)[1]
            return np.concatenate([near, find_largest(alike, SIMILAR_IMAGES)], axis=1)
        away = np.linalg.norm(positions[:, None] - self.place, axis=2)
        return find_largest(np.where(away > apart_m, alike, -np.inf), SIMILAR_IMAGES)

    @cached_property
    def _tree(self) -> KDTree:
        return KDTree(self.place)

    @cached_property
    def _looks(self) -> tuple[np.ndarray, np.ndarray]:
        """What of each image no turn changes (E, L K), and its mean (L K,)."""
        return learn_looks(self.phases)


def learn_images(recording: Recording, upright: Upright | None, positions: np.ndarray) -> KnownImages:
    """Take the known images and their limits from a training recording.

    Args:
        recording: The recording that the method has learned from.
        upright: What sets its images upright; None: they are.
        positions: Positions of the camera that the method predicts for its images (N, 2) [m].
    """
    entry = thin_out(positions, CELL_M)
    rows = np.array_split(entry, -(-len(entry) // CHUNK))
    parts = (_set_upright(recording.observation[part], upright) for part in rows)
    phases, values = map(np.concatenate, zip(*((take_phases(part), take_values(part)) for part in parts), strict=True))
    known = KnownImages(positions[entry], phases, values)
    number = np.full(len(positions), -1)
    number[entry] = np.arange(len(entry))
    some = np.arange(0, len(positions), -(-len(positions) // CHECKED_IMAGES))
    images, place, own = recording.observation[some], positions[some], number[some]
    apart_m = min(DIFFERENT_PLACE_M, np.linalg.norm(positions - positions.mean(axis=0), axis=1).max() / 2.0)
    here, elsewhere = (known.compare(images, place, upright, away_m, own) for away_m in (0.0, apart_m))
    return replace(
        known,
        other_place=float(np.quantile(elsewhere.correlation, 0.99)),
        usual_match=float(np.quantile(here.correlation, 0.01)),
        usual_light=float(np.quantile(here.relit, 0.99)),
        gap_m=float(np.quantile(find_gaps(recording, positions), 0.98)),
    )


def find_gaps(recording: Recording, positions: np.ndarray) -> np.ndarray:
    """Distance of observations at positions (N, 2) [m] from the nearest one of another segment (n,) [m].

    It is at most that of the ``NEIGHBOURS`` nearest.
    """
    number, first = np.unique(recording.reading[:, 1], return_index=True)  # at a turn, two segments share an image
    place, segment = positions[number], recording.reading[first, 0]
    away, rows = find_nearest(KDTree(place), place, NEIGHBOURS)
    return np.where(segment[rows] != segment[:, None], away, away[:, -1:]).min(axis=1)


def take_values(images: np.ndarray) -> np.ndarray:
    """Fourier coefficients (B, rings, channels, ``CYCLES`` + 1) around the circle of images' values, rings pooled."""
    around = np.moveaxis(pool_rings(images), 3, 2)
    return np.asarray(fft.rfft(around))[..., : CYCLES + 1] / np.float32(images.shape[2])


def turn(values: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Coefficients (B, rings, channels, K) of images turned to the left by angles (B,) [rad]."""
    cycles = np.arange(values.shape[-1])
    return values * np.exp(1j * angle[:, None] * cycles)[:, None, None].astype(np.complex64)


def compare_light(seen: np.ndarray, known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """``relit`` and ``gain`` of images by their coefficients and those of the images that match (B, ...)."""
    one, two = (np.asarray(fft.irfft(part, AZIMUTHS)) * AZIMUTHS for part in (seen, known))
    one, two = one.reshape(len(one), -1), two.reshape(len(two), -1)
    steps = np.array_split(np.argsort(two, axis=1), STEPS, axis=1)
    medians = [
        np.stack([np.median(np.take_along_axis(part, step, axis=1), axis=1) for step in steps]) for part in (one, two)
    ]
    gain = medians[0].mean(axis=0) / np.maximum(medians[1].mean(axis=0), 1.0)
    return np.median(np.abs(medians[0] - medians[1]), axis=0), gain


def _set_upright(images: np.ndarray, upright: Upright | None) -> np.ndarray:
    return images if upright is None else upright(images)


DARK_QUANTILE, BRIGHT_QUANTILE = 0.1, 0.9  # Quantiles of an image's values that tell whether it is white or black
WHITE_VALUE = 255.0
EXTREME_SHARE = 0.1  # An image is black or white beyond this share of what the most extreme training image leaves
BLOCKS = 8, 32  # Blocks of an image, along the radius and around the circle
FLAT_SHARE, FLAT_STEPS = 0.02, 1.0
"""Blocks are alike within this share of the image's brightness, and this many steps of its values besides."""
FLAT_MARGIN, MIN_DETAIL = 0.2, 0.25
"""A lens is covered if the share of flat directions is larger by this, or the detail below this share of the least."""
MAX_LIMIT_IMAGES = 500  # Training images, or pairs of them, from which these limits come, at most
BATCH = 256


@dataclass(frozen=True)
class ImageLimits:
    """What training images have at the most, and consecutive ones at the least."""

    bright: float  # Least of the images' ``BRIGHT_QUANTILE`` quantiles
    dark: float  # Largest of their ``DARK_QUANTILE`` quantiles
    detail: float  # Least detail: mean second difference of blocks around the circle over their mean
    flat: float  # Largest share of directions in which all blocks are like those beside them
    change: float  # Change that only one in a hundred pairs of consecutive images is below; see ``measure_change``


def find_limits(recording: Recording) -> ImageLimits:
    """Limits from the training images of a recording."""
    images = recording.observation
    some = np.unique(np.linspace(0, len(images) - 1, min(MAX_LIMIT_IMAGES, len(images))).astype(int))
    bright, dark, detail, flat = measure_images(images[some])
    moved = np.flatnonzero(find_driven(recording))
    pairs = moved[:: -(-len(moved) // MAX_LIMIT_IMAGES) or 1]
    change = measure_change(images, pairs)
    least = float(np.quantile(change, 0.01)) if len(change) else 0.0
    return ImageLimits(float(bright.min()), float(dark.max()), float(detail.min()), float(flat.max()), least)


def check_images(images: np.ndarray, moved: np.ndarray, limits: ImageLimits) -> dict[str, np.ndarray]:
    """Which images are black, white, covered or frozen.

    Args:
        images: Polar images (N, rings, sectors, 3) uint8.
        moved: Whether the wheels moved since the image before (N,) bool; only then can it be frozen.
        limits: Limits from training images.

    Returns:
        Arrays (N,) bool by these names.
    """
    chunks = [images[start : start + BATCH] for start in range(0, len(images), BATCH)]
    bright, dark, detail, flat = np.concatenate([np.empty((4, 0)), *map(measure_images, chunks)], axis=1)
    frozen, pairs = np.zeros(len(images), bool), np.flatnonzero(moved)
    frozen[pairs] = measure_change(images, pairs) < limits.change / 2.0
    return {
        "black": bright < EXTREME_SHARE * limits.bright,
        "white": WHITE_VALUE - dark < EXTREME_SHARE * (WHITE_VALUE - limits.dark),
        "covered": (detail < MIN_DETAIL * limits.detail) | (flat > limits.flat + FLAT_MARGIN),
        "frozen": frozen,
    }


def measure_images(images: np.ndarray) -> np.ndarray:
    """Bright and dark quantile, detail and share of flat directions (4, B) of images (B, rings, sectors, 3)."""
    grey = images.mean(axis=3, dtype=np.float32)
    dark, bright = np.quantile(grey.reshape(len(grey), -1), [DARK_QUANTILE, BRIGHT_QUANTILE], axis=1)
    blocks = take_blocks(grey)
    mean = blocks.mean(axis=(1, 2))
    around, outward = np.roll(blocks, -1, axis=2) - blocks, np.diff(blocks, axis=1)
    detail = np.abs(np.roll(around, -1, axis=2) - around).mean(axis=(1, 2)) / np.maximum(mean, FLAT_STEPS)
    alike = (FLAT_SHARE * mean + FLAT_STEPS)[:, None, None]
    flat = ((np.abs(around[:, :-1]) < alike) & (np.abs(outward) < alike)).all(axis=1).mean(axis=1)
    return np.stack([bright, dark, detail, flat])


def take_blocks(grey: np.ndarray) -> np.ndarray:
    """Means of the blocks (B, 8, 32) of grey images (B, rings, sectors); fewer blocks of an image with fewer pixels."""
    return pool(pool(grey, BLOCKS[0], axis=1), BLOCKS[1], axis=2)


def measure_change(images: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """Mean difference of the pixels of images ``pairs`` (P,) from the image before each, over their mean (P,)."""
    both = ((images[row].astype(np.float32), images[row - 1]) for row in pairs.tolist())
    return np.array([np.abs(one - before).mean() / max(one.mean(), FLAT_STEPS) for one, before in both])


def find_driven(recording: Recording) -> np.ndarray:
    """Whether the wheels moved on a segment between each observation and the one before it (N,) bool.

    They moved if they travelled at least half the median distance between two images; images beside turns are left out.
    """
    segment, number = recording.reading[:, 0], recording.reading[:, 1]
    distance = travel(recording.reading[:, 2:], recording.manifest.odometry).mean(axis=1)
    gap, next_one = np.abs(np.diff(distance, prepend=distance[:1])), np.diff(number, prepend=number[:1]) == 1
    inside = next_one & (np.arange(len(segment)) > find_starts(segment))
    moved = np.zeros(len(recording.observation), bool)
    if inside.any():
        moved[number[inside & (gap > np.median(gap[inside]) / 2.0)]] = True
    return moved
