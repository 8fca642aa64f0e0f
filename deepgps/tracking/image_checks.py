"""What single images show without a map: whether they are black, white, covered or frozen, by those of training."""

from dataclasses import dataclass

import numpy as np

from deepgps.data.segments import find_starts, travel
from sim.recording.format import Recording

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
    """Which polar images (N, rings, sectors, 3) uint8 are black, white, covered or frozen, (N,) bool by these names.

    An image can be frozen only where the wheels moved since the one before (N,) bool.
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


def pool(values: np.ndarray, count: int, axis: int) -> np.ndarray:
    """Means of ``count`` parts of an axis, as equal as can be; of an axis that is shorter, its values."""
    size = values.shape[axis]
    first = np.arange(min(count, size)) * size // min(count, size)
    number = np.diff(np.append(first, size)).astype(np.float32)
    return np.add.reduceat(values, first, axis=axis) / np.expand_dims(number, tuple(range(1, values.ndim - axis)))


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
