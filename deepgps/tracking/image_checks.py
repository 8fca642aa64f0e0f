"""Checks of images that need no map: black, white, covered or frozen ones. Limits come from training images."""

from dataclasses import dataclass

import numpy as np

from deepgps.data.dead_reckoning import travel
from deepgps.data.runs import find_starts
from deepgps.positioner.headings import pool
from sim.recording.format import Recording

DARKEST, BRIGHTEST = 0.1, 0.9
"""Quantiles of an image's values that tell whether it is white or black."""
WHITE = 255.0
BEYOND = 0.1
"""An image is black or white beyond this share of what the most extreme training image leaves."""
BLOCKS = 8, 32
"""Blocks of an image, along the radius and around the circle."""
FLAT, STEP = 0.02, 1.0
"""Blocks are alike within this share of the image's brightness, and this many steps of its values besides."""
MORE_FLAT, LESS_DETAIL = 0.2, 0.25
"""A lens is covered if the share of flat directions is larger by this, or the detail below this share of the least."""
CHECKED = 500
"""Training images, or pairs of them, from which limits come, at most."""
CHUNK = 256


@dataclass(frozen=True)
class ImageLimits:
    """What training images have at the most, and consecutive ones at the least.

    Attributes:
        bright: Least of the images' ``BRIGHTEST`` quantiles.
        dark: Largest of their ``DARKEST`` quantiles.
        detail: Least detail: mean second difference of blocks around the circle over their mean.
        flat: Largest share of directions in which all blocks are like those beside them.
        change: Change that only one in a hundred pairs of consecutive images is below; see ``measure_change``.
    """

    bright: float
    dark: float
    detail: float
    flat: float
    change: float


@dataclass(frozen=True)
class ImageFaults:
    """What single images show.

    Attributes:
        black: It is black (N,) bool.
        white: It is white (N,) bool.
        covered: It shows less than any training image, or nothing in many directions (N,) bool.
        frozen: It is the same as the one before, though the wheels moved (N,) bool.
    """

    black: np.ndarray
    white: np.ndarray
    covered: np.ndarray
    frozen: np.ndarray


def find_limits(recording: Recording) -> ImageLimits:
    """Limits from the training images of a recording."""
    images = recording.observation
    some = np.unique(np.linspace(0, len(images) - 1, min(CHECKED, len(images))).astype(int))
    bright, dark, detail, flat = measure_images(images[some])
    moved = np.flatnonzero(find_driven(recording))
    pairs = moved[:: -(-len(moved) // CHECKED) or 1]
    change = measure_change(images, pairs)
    least = float(np.quantile(change, 0.01)) if len(change) else 0.0
    return ImageLimits(float(bright.min()), float(dark.max()), float(detail.min()), float(flat.max()), least)


def check_images(images: np.ndarray, moved: np.ndarray, limits: ImageLimits) -> ImageFaults:
    """Check images (N, rings, sectors, 3) uint8; ``moved`` (N,): the wheels moved since the image before."""
    chunks = [images[start : start + CHUNK] for start in range(0, len(images), CHUNK)]
    bright, dark, detail, flat = np.concatenate([np.empty((4, 0)), *map(measure_images, chunks)], axis=1)
    black = bright < BEYOND * limits.bright
    white = WHITE - dark < BEYOND * (WHITE - limits.dark)
    covered = (detail < LESS_DETAIL * limits.detail) | (flat > limits.flat + MORE_FLAT)
    frozen, pairs = np.zeros(len(images), bool), np.flatnonzero(moved)
    frozen[pairs] = measure_change(images, pairs) < limits.change / 2.0
    return ImageFaults(black, white, covered, frozen)


def measure_images(images: np.ndarray) -> np.ndarray:
    """Bright and dark quantile, detail and share of flat directions (4, B) of images (B, rings, sectors, 3)."""
    grey = images.mean(axis=3, dtype=np.float32)
    dark, bright = np.quantile(grey.reshape(len(grey), -1), [DARKEST, BRIGHTEST], axis=1)
    blocks = take_blocks(grey)
    mean = blocks.mean(axis=(1, 2))
    around, outward = np.roll(blocks, -1, axis=2) - blocks, np.diff(blocks, axis=1)
    detail = np.abs(np.roll(around, -1, axis=2) - around).mean(axis=(1, 2)) / np.maximum(mean, STEP)
    alike = (FLAT * mean + STEP)[:, None, None]
    flat = ((np.abs(around[:, :-1]) < alike) & (np.abs(outward) < alike)).all(axis=1).mean(axis=1)
    return np.stack([bright, dark, detail, flat])


def take_blocks(grey: np.ndarray) -> np.ndarray:
    """Means of the blocks (B, 8, 32) of grey images (B, rings, sectors); fewer blocks of an image with fewer pixels."""
    return pool(pool(grey, BLOCKS[0], axis=1), BLOCKS[1], axis=2)


def measure_change(images: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """Mean difference of the pixels of images ``pairs`` (P,) from the image before each, over their mean (P,)."""
    both = ((images[row].astype(np.float32), images[row - 1]) for row in pairs.tolist())
    return np.array([np.abs(one - before).mean() / max(one.mean(), STEP) for one, before in both])


def find_driven(recording: Recording) -> np.ndarray:
    """Whether the wheels moved on a segment between each observation and the one before it (N,) bool.

    They moved if they travelled at least half the median distance between two images; images beside turns are left out.
    """
    segment, number = recording.reading[:, 0], recording.reading[:, 1]
    way = travel(recording.reading[:, 2:], recording.manifest.odometry).mean(axis=1)
    gap, next_one = np.abs(np.diff(way, prepend=way[:1])), np.diff(number, prepend=number[:1]) == 1
    inside = next_one & (np.arange(len(segment)) > find_starts(segment))
    moved = np.zeros(len(recording.observation), bool)
    if inside.any():
        moved[number[inside & (gap > np.median(gap[inside]) / 2.0)]] = True
    return moved
