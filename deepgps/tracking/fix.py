"""Fixes: what single images say of the robot's pose, as the filter takes it.

The filter updates several hypotheses by one image. Errors follow a Student-t distribution: the variance of an image is
enlarged until it fits what the update leaves of its difference (Roth, Ozkan and Gustafsson, "A Student's t filter for
heavy tailed process and measurement noise", ICASSP 2013).
"""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from deepgps.positioner.registration import REASONS
from deepgps.tracking.motion import NO_MOTION, Motion, compose
from sim.geometry import wrap

if TYPE_CHECKING:
    from deepgps.positioner.pose import Poses

MIN_POSITION_STD_M = 0.002  # Least standard deviation of a position along each axis [m]
USUAL_POSITION_STD_M = 0.02  # Standard deviation of the positions of methods that give none [m]
MIN_WEIGHT = 0.01  # Probability of a pose from which it is used
RADIUS_68_PER_STD = 1.5096
"""Radius of 68 % over the standard deviation along one axis, of a normal distribution in the plane."""


@dataclass(frozen=True)
class Fix:
    """What one image says of the robot's pose in the method's frame."""

    position: np.ndarray  # Position (2,) [m]
    position_std: float  # Its standard deviation along each axis [m]; infinite: unknown, and the image is not used
    yaw: float = np.nan  # Yaw [rad]; NaN: the image tells none
    yaw_std: float = np.nan  # Its standard deviation [rad]; NaN like ``yaw``
    weight: float = 1.0  # Probability that this is right, and not one of the others or none
    accepted: bool = True  # Whether it is like those of the drive that was learned from; others count little
    others: tuple["Fix", ...] = ()  # Other poses from which it may have been taken

    @property
    def usable(self) -> bool:
        """Whether the image says anything of the position."""
        return bool(np.isfinite(self.position).all() and np.isfinite(self.position_std))


def take_fix(pose: "Poses") -> Fix:
    """The fix of a single pose, as ``Poses.take`` gives it.

    The expected error of its position is that of its radius, where the method gives one. Without a radius, a refused
    image is not used. Where an image is refused since places look alike, these are its poses, and the drive decides.
    """
    yaw, yaw_std = (np.nan if one is None else float(one) for one in (pose.yaw, pose.yaw_std))
    accepted = pose.accepted is None or bool(pose.accepted)
    first = Fix(np.asarray(pose.position, float), _find_std(pose, accepted), yaw, yaw_std, accepted=accepted)
    if pose.reason is None or pose.mode is None or REASONS[int(pose.reason)] != "ambiguous":
        return first
    assert pose.mode_weight is not None and pose.mode_yaw is not None
    shift = first.position - pose.mode[0]  # from the camera to the axle, nearly
    modes = [
        replace(first, position=place + shift, yaw=float(turned), weight=float(weight), accepted=True)
        for place, turned, weight in zip(pose.mode, pose.mode_yaw, pose.mode_weight, strict=True)
        if weight > MIN_WEIGHT
    ]
    return replace(modes[0], others=tuple(modes[1:]))


def take_fixes(poses: "Poses") -> list[Fix]:
    """The fixes of B poses."""
    return [take_fix(poses.take(row)) for row in range(len(poses.position))]


def _find_std(pose: "Poses", accepted: bool) -> float:
    if pose.radius_68 is not None:
        return max(float(pose.radius_68) / RADIUS_68_PER_STD, MIN_POSITION_STD_M)
    return USUAL_POSITION_STD_M if accepted else np.inf


DEGREES_OF_FREEDOM = 4.0  # Degrees of freedom of the errors of images
ROUNDS = 4  # Rounds in which the variance of an image is enlarged
OUTLIER_PROBABILITY = 0.1  # Probability that an image says nothing of the pose
NO_YAW_PROBABILITY = 0.05  # Probability that the yaw of an image is wrong
LOST_AREA_M2 = 25.0  # Area over which a lost robot is spread: only its order of magnitude matters [m^2]


class Updated(NamedTuple):
    """Hypotheses after an image (K, 4), their covariances (K, 4, 4), and the log-likelihood of the image under each,
    against that under a pose that is unknown (K,)."""

    mean: np.ndarray
    covariance: np.ndarray
    likelihood: np.ndarray


def update(mean: np.ndarray, covariance: np.ndarray, fix: Fix) -> Updated:
    """Update hypotheses (K, 4) with covariances (K, 4, 4) by an image, each with the pose that fits it best."""
    poses = (fix, *fix.others)
    tried = [_update(mean, covariance, one) for one in poses]
    if np.isfinite(fix.yaw):
        without = (replace(one, yaw=np.nan, weight=NO_YAW_PROBABILITY * one.weight) for one in poses)
        tried += [_update(mean, covariance, one) for one in without]
    likelihood = np.stack([one.likelihood for one in tried])
    best, rows = likelihood.argmax(axis=0), np.arange(len(mean))
    right = likelihood.max(axis=0) + np.log(1.0 - OUTLIER_PROBABILITY)
    return Updated(
        np.stack([one.mean for one in tried])[best, rows],
        np.stack([one.covariance for one in tried])[best, rows],
        np.logaddexp(right, np.log(OUTLIER_PROBABILITY)),
    )


def _update(mean: np.ndarray, covariance: np.ndarray, fix: Fix) -> Updated:
    """Update by one pose of an image: by its position, and by its yaw if it is known."""
    missed, variance = fix.position - mean[:, :2], np.full(2, fix.position_std**2)
    spread_of_lost = LOST_AREA_M2 + 2.0 * np.pi * fix.position_std**2
    if np.isfinite(fix.yaw):
        missed = np.column_stack([missed, wrap(fix.yaw - mean[:, 2])])
        variance, spread_of_lost = np.append(variance, fix.yaw_std**2), 2.0 * np.pi * spread_of_lost
    size = len(variance)
    expected = covariance[:, :size, :size] + np.diag(variance)
    squared = np.einsum("ki,ki->k", missed, np.linalg.solve(expected, missed[..., None])[..., 0])
    density = -0.5 * np.linalg.slogdet(2.0 * np.pi * expected)[1]
    likelihood = density - 0.5 * (DEGREES_OF_FREEDOM + size) * np.log1p(squared / DEGREES_OF_FREEDOM)
    return Updated(*_fit(mean, covariance, missed, variance), np.log(fix.weight * spread_of_lost) + likelihood)


def _fit(
    mean: np.ndarray, covariance: np.ndarray, missed: np.ndarray, variance: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    size, left, uncertain = len(variance), missed, np.zeros(missed.shape)
    for _ in range(ROUNDS):
        squared = ((left**2 + uncertain) / variance).sum(axis=1)
        larger = np.maximum((DEGREES_OF_FREEDOM + squared) / (DEGREES_OF_FREEDOM + size), 1.0)[:, None, None]
        gain = covariance[:, :, :size] @ np.linalg.inv(covariance[:, :size, :size] + larger * np.diag(variance))
        step = (gain @ missed[..., None])[..., 0]
        after = covariance - gain @ covariance[:, :size, :]
        left, uncertain = missed - step[:, :size], np.diagonal(after, axis1=1, axis2=2)[:, :size]
    return mean + step, (after + after.mT) / 2.0


COMPARISON_DISTANCE_M = 0.5  # Way between two images that are compared [m]
MAX_COMPARISON_M = 1.0  # Images farther apart are not compared, since odometry errs too [m]
WINDOW, PRIOR_COMPARISONS = 60, 10  # Comparisons whose median is taken, and those counted as expected before any image
SQUARED_NORMAL_MEDIAN = 0.455  # Median of a squared standard normal variable
MAX_ERROR_FACTOR = 100.0
"""Errors are at most so many times those expected, and never less than these, which the median of heavy tails hides."""
TRAIL_SPACING_M = 0.05  # Distance between the images kept, so that a robot at rest does not fill the trail [m]


@dataclass(frozen=True)
class Seen:
    """An image on the way."""

    fix: Fix  # What it says of the pose
    motion: Motion  # By odometry, from it to the next image that is kept, or until now
    distance_m: float = 0.0  # Driven meanwhile [m]


@dataclass(frozen=True)
class Trail:
    """The last images on a path by odometry."""

    images: tuple[Seen, ...]  # Those with which the next may be compared, the last one at the end
    squared: np.ndarray  # Squared differences of distances over those expected (m,)


def begin_trail() -> Trail:
    """A trail without an image."""
    return Trail((), np.full(PRIOR_COMPARISONS, SQUARED_NORMAL_MEDIAN))


def break_off(trail: Trail) -> Trail:
    """The trail of a robot that was carried: its images are of no use, but its errors are the same."""
    return replace(trail, images=())


def extend(trail: Trail, motion: Motion, scale: float) -> Trail:
    """The trail after a motion, whose distance is ``scale`` times that by odometry."""
    if not trail.images:
        return trail
    *others, last = trail.images
    moved = compose(last.motion, replace(motion, step=motion.step * scale))
    return replace(trail, images=(*others, Seen(last.fix, moved, last.distance_m + motion.length_m)))


def add_image(trail: Trail, fix: Fix) -> Trail:
    """The trail with an image, compared with the last one that is far enough away."""
    if trail.images and trail.images[-1].distance_m < TRAIL_SPACING_M:
        return trail
    motion, distance_m, squared, kept = NO_MOTION, 0.0, trail.squared, [Seen(fix, NO_MOTION)]
    for seen in reversed(trail.images):
        before, distance_m = distance_m, distance_m + seen.distance_m
        if distance_m > MAX_COMPARISON_M:
            break
        motion = compose(seen.motion, motion)
        kept.insert(0, seen)
        if before < COMPARISON_DISTANCE_M <= distance_m:
            squared = np.append(squared, _compare(fix, seen.fix, motion))[-WINDOW:]
    return Trail(tuple(kept), squared)


def find_factor(trail: Trail) -> float:
    """Factor of the standard deviations of images."""
    return float(np.clip(np.sqrt(np.median(trail.squared) / SQUARED_NORMAL_MEDIAN), 1.0, MAX_ERROR_FACTOR))


def _compare(fix: Fix, earlier: Fix, motion: Motion) -> float:
    """Squared difference of the distances by image and by odometry, over that expected of the images.

    The variance of the odometry's distance is that along the line between the two places: an error of the heading
    moves one of them across it.
    """
    along = motion.step / max(motion.length_m, 1e-9)
    spread = float(along @ motion.covariance[:2, :2] @ along)
    apart = float(np.linalg.norm(fix.position - earlier.position)) - motion.length_m
    return max(apart**2 - spread, 0.0) / (fix.position_std**2 + earlier.position_std**2)
