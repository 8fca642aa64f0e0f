"""The causes for which images of a drive in use are refused or suspicious: one table of rules on what images show.

Black, white, covered or frozen images need no map: their limits come from training images.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from deepgps.data.segments import find_starts, travel
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


WINDOW, NEARLY_ALL = 150, 0.95
"""The robot is in another room if this share of so many consecutive images is new."""
AROUND, OFTEN, MOSTLY = 50, 0.25, 0.5
"""The light has changed where values differ in the first share of so many images before and after an image; where they
differ in the second share, it is also why others are refused."""
MORE = 2.0
"""Refused images show that the room has changed if there are so many times more around than the drive explains."""
FEWEST = 10
"""Accepted images around an image, at least, that show whether the room has changed."""


@dataclass(frozen=True)
class Seen(ImageFaults):
    """What N images show, each by itself.

    Attributes:
        accepted: The method accepts its position (N,) bool.
        unusual: It is refused because it is more novel than most images of the training drive (N,) bool; others are
            refused because that drive was too short to know their place well.
        known_place: It matches a training image better than images of different places match (N,) bool.
        beyond: It is farther from all training images on the map than nearly all of these are from other segments (N,)
            bool.
        relit: Its values differ from those of the match as a whole (N,) bool.
        correlation: Correlation with the best match among the training images (N,).
    """

    accepted: np.ndarray
    unusual: np.ndarray
    known_place: np.ndarray
    beyond: np.ndarray
    relit: np.ndarray
    correlation: np.ndarray


@dataclass(frozen=True)
class Evidence(Seen):
    """What is known of N images in the order driven; ``relit`` only where it is so of many images around.

    Attributes:
        mostly_relit: Most images around it are relit (N,) bool.
        changed: The accepted images around it match training images worse than these match each other (N,) bool.
        often_refused: More images around it are refused than a short training drive explains (N,) bool.
        leaning: The camera leans otherwise than in training, and the method does not correct it (N,) bool.
        long_new: It is in a long stretch of images nearly all of which are of no known place (N,) bool.
    """

    mostly_relit: np.ndarray
    changed: np.ndarray
    often_refused: np.ndarray
    leaning: np.ndarray
    long_new: np.ndarray


@dataclass(frozen=True)
class Cause:
    """One cause.

    Attributes:
        name: Name in ``metrics.json``; empty: no cause.
        title: The cause in words.
        holds: Which images (N,) have it, unless an earlier rule holds.
    """

    name: str
    title: str
    holds: Callable[[Evidence], np.ndarray]


def find_relit(seen: Evidence) -> np.ndarray:
    """Images under another light, and those refused among mostly such images."""
    return (seen.known_place & seen.relit) | (~seen.accepted & seen.mostly_relit)


def find_changed(seen: Evidence) -> np.ndarray:
    """Images of known places, where training images are near by or what is accepted shows that the room has changed;
    not those that are refused since the training drive was short.
    """
    near = ~seen.beyond & (seen.unusual | seen.often_refused)
    return seen.known_place & (near | seen.changed)


RULES = (
    Cause("black", "black image", lambda seen: seen.black),
    Cause("white", "white image", lambda seen: seen.white),
    Cause("covered", "lens covered", lambda seen: seen.covered),
    Cause("frozen", "frozen image", lambda seen: seen.frozen),
    Cause("light", "light or exposure changed", find_relit),
    Cause("", "", lambda seen: seen.accepted),
    Cause("camera", "camera leans or moved", lambda seen: seen.known_place & seen.leaning),
    Cause("other_room", "another room", lambda seen: seen.long_new),
    Cause("furniture", "furniture moved or someone in view", find_changed),
    Cause("new_place", "never or seldom been here", lambda seen: ~seen.accepted),
)
"""The first rule that holds names an image's cause. The light can change though an image is accepted."""
TITLES = {cause.name: cause.title for cause in RULES if cause.name}
FAULTY = ("black", "white", "covered", "frozen")
"""Causes of images that do not show where the camera is or how it leans."""


def label(seen: Evidence) -> np.ndarray:
    """Name of each image's cause (N,) str; empty: none."""
    return np.select([cause.holds(seen) for cause in RULES], [cause.name for cause in RULES], "")


def find_long(new: np.ndarray) -> np.ndarray:
    """Which images (N,) are in a stretch of ``WINDOW`` images, or in a shorter drive, nearly all of which are new."""
    size, long = min(WINDOW, len(new)), np.zeros(len(new), bool)
    for start in range(len(new) - size + 1):
        if size and new[start : start + size].mean() >= NEARLY_ALL:
            long[start : start + size] = True
    return long


def share_around(found: np.ndarray) -> np.ndarray:
    """Share of the images within ``AROUND`` of each image (N,) that have what is found (N,) bool."""
    total, rows = np.append(0, np.cumsum(found)), np.arange(len(found))
    first, last = np.maximum(rows - AROUND, 0), np.minimum(rows + AROUND + 1, len(found))
    return (total[last] - total[first]) / np.maximum(last - first, 1)


def median_around(values: np.ndarray, among: np.ndarray) -> np.ndarray:
    """Median value (N,) of images within ``AROUND`` of each that count (N,) bool; NaN with fewer than ``FEWEST``."""
    found = np.full(len(values), np.nan)
    for row in range(len(values)):
        some = slice(max(row - AROUND, 0), row + AROUND + 1)
        if among[some].sum() >= FEWEST:
            found[row] = np.median(values[some][among[some]])
    return found
