"""How large the errors of images are at present, by odometry: in other light they are many times those in training.

The distance between the positions of two images, half a metre apart, is compared with that by odometry; no hypothesis
of the pose takes part in it. The median of the squared differences, over those expected, is robust against outliers.
"""

from dataclasses import dataclass, replace

import numpy as np

from deepgps.tracking.fix import Fix
from deepgps.tracking.motion import STILL, Motion, compose

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
LEAST_M = 0.05
"""Way after which another image is kept, so that a robot that does not move does not fill the trail [m]."""


@dataclass(frozen=True)
class Seen:
    """An image on the way.

    Attributes:
        fix: What it says of the pose.
        motion: By odometry, from it to the next image that is kept, or until now.
        way_m: Way driven meanwhile [m].
    """

    fix: Fix
    motion: Motion
    way_m: float = 0.0


@dataclass(frozen=True)
class Trail:
    """The last images on a path by odometry.

    Attributes:
        images: Those with which the next may be compared, the last one at the end.
        squared: Squared differences of distances over those expected (m,).
    """

    images: tuple[Seen, ...]
    squared: np.ndarray


def begin_trail() -> Trail:
    """A trail without an image."""
    return Trail((), np.full(BEFORE, OF_MEDIAN))


def break_off(trail: Trail) -> Trail:
    """The trail of a robot that was carried: its images are of no use, but its errors are the same."""
    return replace(trail, images=())


def extend(trail: Trail, motion: Motion, scale: float) -> Trail:
    """The trail after a motion, whose way is ``scale`` times that by odometry."""
    if not trail.images:
        return trail
    *others, last = trail.images
    moved = compose(last.motion, replace(motion, step=motion.step * scale))
    return replace(trail, images=(*others, Seen(last.fix, moved, last.way_m + motion.length_m)))


def add_image(trail: Trail, fix: Fix) -> Trail:
    """The trail with an image, compared with the last one that is far enough away."""
    if trail.images and trail.images[-1].way_m < LEAST_M:
        return trail
    motion, way_m, squared, kept = STILL, 0.0, trail.squared, [Seen(fix, STILL)]
    for seen in reversed(trail.images):
        before, way_m = way_m, way_m + seen.way_m
        if way_m > FARTHEST_M:
            break
        motion = compose(seen.motion, motion)
        kept.insert(0, seen)
        if before < APART_M <= way_m:
            squared = np.append(squared, _compare(fix, seen.fix, motion))[-WINDOW:]
    return Trail(tuple(kept), squared)


def find_factor(trail: Trail) -> float:
    """Factor of the standard deviations of images."""
    return float(np.clip(np.sqrt(np.median(trail.squared) / OF_MEDIAN), 1.0, MOST))


def _compare(fix: Fix, earlier: Fix, motion: Motion) -> float:
    """Squared difference of the distances by image and by odometry, over that expected of the images.

    The variance of the odometry's distance is that along the line between the two places: an error of the heading
    moves one of them across it.
    """
    along = motion.step / max(motion.length_m, 1e-9)
    spread = float(along @ motion.covariance[:2, :2] @ along)
    apart = float(np.linalg.norm(fix.position - earlier.position)) - motion.length_m
    return max(apart**2 - spread, 0.0) / (fix.position_std**2 + earlier.position_std**2)
