"""Whole poses of observations: position and yaw, each with a standard deviation."""

from dataclasses import dataclass, replace

import numpy as np

from deepgps.positioner.positioner import FeaturePositioner, Positioner
from deepgps.positioner.registration import RegistrationPositioner
from sim.alignment import Alignment


@dataclass(frozen=True)
class Poses:
    """Where B observations were taken, and which way the robot looked.

    Only methods on polar images tell more than a position. The yaw is NaN where an image shows no direction, and the
    other yaw is NaN where the image leaves no second hypothesis.
    """

    position: np.ndarray  # Positions x, y (B, 2) [m]
    # Standard deviation along each axis (B,) [m]: how far the training images near by are from the straight lines
    # driven. It knows nothing of places that look alike. None: unknown
    position_std: np.ndarray | None = None
    yaw: np.ndarray | None = None  # Counter-clockwise from x (B,) [rad]; None: the method gives no yaw
    yaw_std: np.ndarray | None = None  # Its standard deviation if the hypothesis is right (B,) [rad]; None like ``yaw``
    # Share of the stored images near by and of those most alike that agree on the yaw (B,); low where a place is new
    # or looks like another. None like ``yaw``
    yaw_weight: np.ndarray | None = None
    other_yaw: np.ndarray | None = None  # Second hypothesis of the yaw (B,) [rad]; None like ``yaw``
    other_weight: np.ndarray | None = None  # Its share (B,), 0 where there is none; None like ``yaw``
    # How unlike the training images near by each image is, as a distance on the map (B,) [m]; None: the method does
    # not say
    novelty: np.ndarray | None = None
    # Radius of the circle that holds the true position with a probability of 68 % (B,) [m]; None: unknown
    radius_68: np.ndarray | None = None
    radius_95: np.ndarray | None = None  # The same for 95 % (B,) [m]; None: unknown
    # Whether the novelty is one that images of the drive have (B,) bool; positions of the others should not be used.
    # None: the method accepts all
    accepted: np.ndarray | None = None
    # By registration alone: why each is refused (B,), a number in ``REASONS``; the covariance (B, 2, 2) [m^2] that the
    # image gives; positions that explain it as well or nearly, the best first (B, M, 2) [m], NaN where there is none;
    # and the probability of each (B, M)
    reason: np.ndarray | None = None
    covariance: np.ndarray | None = None
    mode: np.ndarray | None = None
    mode_weight: np.ndarray | None = None

    def align(self, alignment: Alignment) -> "Poses":
        """The same poses in the frame that an alignment leads to."""
        yaw, other = (None if one is None else alignment.turn(one) for one in (self.yaw, self.other_yaw))
        aligned = replace(self, position=alignment.apply(self.position), yaw=yaw, other_yaw=other)
        if self.mode is None or self.covariance is None:
            return aligned
        turned = alignment.rotation @ self.covariance @ alignment.rotation.T
        return replace(aligned, mode=alignment.apply(self.mode), covariance=turned)

    def take(self, index: int | np.ndarray) -> "Poses":
        """One of the poses, without the axis B, or some."""
        return replace(self, **{name: part[index] for name, part in vars(self).items() if part is not None})


def find_poses(positioner: Positioner, observations: np.ndarray) -> Poses:
    """Poses of observations (B, ...) in the method's own frame."""
    if isinstance(positioner, RegistrationPositioner):
        return _register(positioner, observations)
    if not isinstance(positioner, FeaturePositioner):
        return Poses(positioner(observations))
    if (table := positioner.confidence) is None:
        return _add_yaw(positioner, observations, positioner.locate_camera(observations))
    camera, features = positioner.locate_with_features(observations)
    trust = table.find(features, camera)
    known = np.isfinite(trust.radius).all()
    return replace(
        _add_yaw(positioner, observations, camera),
        novelty=trust.novelty,
        accepted=trust.accepted,
        radius_68=trust.radius[:, 0] if known else None,
        radius_95=trust.radius[:, 1] if known else None,
    )


def _register(positioner: RegistrationPositioner, observations: np.ndarray) -> Poses:
    found = positioner.register(observations)
    radius, trace = positioner.find_radii(found), np.trace(found.covariance, axis1=1, axis2=2)
    yaws = {}
    if positioner.pixels is not None:
        one, none = np.ones(len(found.yaw)), np.full(len(found.yaw), np.nan)
        yaws = {
            "yaw": found.yaw,
            "yaw_std": found.yaw_std,
            "yaw_weight": one,
            "other_yaw": none,
            "other_weight": 0.0 * one,
        }
    return Poses(
        positioner.leave_camera(found.position, found.yaw),
        np.sqrt(trace / 2.0),
        novelty=np.sqrt(trace),
        radius_68=radius[:, 0],
        radius_95=radius[:, 1],
        accepted=found.reason == 0,
        reason=found.reason,
        covariance=found.covariance,
        mode=found.mode,
        mode_weight=found.weight,
        **yaws,
    )


def _add_yaw(positioner: FeaturePositioner, observations: np.ndarray, camera: np.ndarray) -> Poses:
    if (headings := positioner.headings) is None:
        return Poses(camera)
    found = positioner.find_yaws(observations, camera)
    return Poses(
        positioner.leave_camera(camera, found.yaw[:, 0]),
        headings.find_position_std(camera),
        found.yaw[:, 0],
        found.std[:, 0],
        found.weight[:, 0],
        found.yaw[:, 1],
        found.weight[:, 1],
    )
