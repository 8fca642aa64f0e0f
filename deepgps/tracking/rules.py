"""The causes for which images of a drive in use are refused or suspicious: one table of rules on what images show."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from deepgps.tracking.image_checks import ImageFaults

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
