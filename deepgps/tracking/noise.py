"""How large the errors of images are at present, by odometry: in other light they are many times those in training.

The distance between the positions of two images, half a metre apart, is compared with that by odometry; no hypothesis
of the pose takes part in it. The median of the squared differences, over those expected, is robust against outliers.
"""

from dataclasses import dataclass, replace

import numpy as np

from deepgps.tracking.fix import Fix
from deepgps.tracking.motion import Motion, compose, make_motion

APART_M = 0.5
"""Way between two images that are compared [m]."""
FARTHEST_M = 1.0
"""Images farther apart are not compared, since odometry errs too [m]."""
WINDOW, BEFORE = 60, 10
"""Comparisons of which the median is taken, and how many count as expected before any image."""
OF_MEDIAN = 0.455
"""Median of a squared standard normal variable."""
MOST = 100.0
"""Errors are at most so many times those expected, and never less than these, which the median of heavy tails hides."""
KEPT = 64


@dataclass(frozen=True)
class Trail:
    """The last images on a path by odometry.

    Attributes:
        motion: From the first image that is kept until now.
        way_m: Way driven until now [m].
        images: Way, place and variance by odometry, and place and variance by image (n, 7).
        squared: Squared differences of distances over those expected (m,).
    """

    motion: Motion
    way_m: float
    images: np.ndarray
    squared: np.ndarray


def begin_trail() -> Trail:
    """A trail without an image."""
    return Trail(make_motion(0.0), 0.0, np.empty((0, 7)), np.full(BEFORE, OF_MEDIAN))


def break_off(trail: Trail) -> Trail:
    """The trail of a robot that was carried: its images are of no use, but its errors are the same."""
    return replace(begin_trail(), squared=trail.squared)


def extend(trail: Trail, motion: Motion, scale: float) -> Trail:
    """The trail after a motion, whose way is ``scale`` times that by odometry."""
    scaled = replace(motion, step=motion.step * scale)
    return replace(trail, motion=compose(trail.motion, scaled), way_m=trail.way_m + motion.length_m)


def add_image(trail: Trail, fix: Fix) -> Trail:
    """The trail with an image, compared with an earlier one."""
    spread = float(np.trace(trail.motion.covariance[:2, :2])) / 2.0
    row = np.array([trail.way_m, *trail.motion.step, spread, *fix.position, fix.position_std**2])
    squared = trail.squared
    earlier = np.flatnonzero(trail.way_m - trail.images[:, 0] >= APART_M)
    if len(earlier) and trail.way_m - trail.images[earlier[-1], 0] <= FARTHEST_M:
        squared = np.append(squared, _compare(row, trail.images[earlier[-1]]))[-WINDOW:]
    return replace(trail, images=np.concatenate([trail.images, row[None]])[-KEPT:], squared=squared)


def find_factor(trail: Trail) -> float:
    """Factor of the standard deviations of images."""
    return float(np.clip(np.sqrt(np.median(trail.squared) / OF_MEDIAN), 1.0, MOST))


def _compare(row: np.ndarray, other: np.ndarray) -> float:
    gap = row - other
    apart = np.hypot(gap[4], gap[5]) - np.hypot(gap[1], gap[2])
    return max(apart**2 - max(gap[3], 0.0), 0.0) / (row[6] + other[6])
