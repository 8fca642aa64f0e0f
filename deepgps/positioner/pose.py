"""Whole poses of observations: position and yaw, each with a standard deviation."""

from dataclasses import dataclass, replace

import numpy as np

from deepgps.positioner.positioner import FeaturePositioner, Positioner
from sim.alignment import Alignment


@dataclass(frozen=True)
class Poses:
    """Where B observations were taken, and which way the robot looked.

    Only methods that compare features tell more than a position, and only those on polar images a yaw. It is NaN where
    an image shows no direction.
    """

    position: np.ndarray  # Positions x, y (B, 2) [m]
    yaw: np.ndarray | None = None  # Counter-clockwise from x (B,) [rad]; None: the method gives no yaw
    yaw_std: np.ndarray | None = None  # Its standard deviation (B,) [rad]; None like ``yaw``
    # The error to be expected: the root of the covariance's trace (B,) [m]; None: the method does not say
    novelty: np.ndarray | None = None
    # Radius of the circle that holds the true position with a probability of 68 % (B,) [m]; None: unknown
    radius_68: np.ndarray | None = None
    radius_95: np.ndarray | None = None  # The same for 95 % (B,) [m]; None: unknown
    # Whether positions should be used (B,) bool. None: the method accepts all
    accepted: np.ndarray | None = None
    reason: np.ndarray | None = None  # Why each is refused (B,), a number in ``REASONS``; None: the method does not say
    covariance: np.ndarray | None = None  # Of the position, by the image alone (B, 2, 2) [m^2]; None: unknown
    # Positions of the camera that explain the image as well or nearly, the best first (B, M, 2) [m], NaN where there is
    # none; the yaw there (B, M) [rad]; and the probability of each (B, M). None: unknown
    mode: np.ndarray | None = None
    mode_yaw: np.ndarray | None = None
    mode_weight: np.ndarray | None = None

    def align(self, alignment: Alignment) -> "Poses":
        """The same poses in the frame that an alignment leads to."""
        yaw = None if self.yaw is None else alignment.turn(self.yaw)
        aligned = replace(self, position=alignment.apply(self.position), yaw=yaw)
        if self.mode is None or self.mode_yaw is None or self.covariance is None:
            return aligned
        turned, yaw = alignment.rotation @ self.covariance @ alignment.rotation.T, alignment.turn(self.mode_yaw)
        return replace(aligned, mode=alignment.apply(self.mode), mode_yaw=yaw, covariance=turned)

    def take(self, index: int | np.ndarray) -> "Poses":
        """One of the poses, without the axis B, or some."""
        return replace(self, **{name: part[index] for name, part in vars(self).items() if part is not None})


def find_poses(positioner: Positioner, observations: np.ndarray) -> Poses:
    """Poses of observations (B, ...) in the method's own frame."""
    if not isinstance(positioner, FeaturePositioner) or (found := positioner.register(observations)) is None:
        return Poses(positioner(observations))
    assert positioner.appearance is not None
    radius = positioner.appearance.registration.find_radii(found)
    poses = Poses(
        positioner.leave_camera(found.position, found.yaw),
        novelty=np.sqrt(np.trace(found.covariance, axis1=1, axis2=2)),
        radius_68=radius[:, 0],
        radius_95=radius[:, 1],
        accepted=found.reason == 0,
        reason=found.reason,
        covariance=found.covariance,
        mode=found.mode,
        mode_yaw=found.mode_yaw,
        mode_weight=found.weight,
    )
    return poses if positioner.mirrored is None else replace(poses, yaw=found.yaw, yaw_std=found.yaw_std)
