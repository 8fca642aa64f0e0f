"""Fixes: what single images say of the robot's pose, as the filter takes it."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from deepgps.positioner.pose import Poses

UNDERSTATED, FLOOR_M = 2.0, 0.002
"""Errors of positions over ``Poses.position_std``, which knows only how straight segments are; and their least standard
deviation [m]. Measured on drives in use of two rooms: 1.7 and 2.1."""
USUAL_M = 0.02
"""Standard deviation of the positions of methods that give none [m]."""
OF_RADIUS_68 = 1.5096
"""Radius of 68 % over the standard deviation along one axis, of a normal distribution in the plane."""


@dataclass(frozen=True)
class Fix:
    """What one image says of the robot's pose in the method's frame.

    Attributes:
        position: Position (2,) [m].
        position_std: Its standard deviation along each axis [m]; infinite: unknown, and the image is not used.
        yaw: Hypotheses of the yaw (H,) [rad]; none: the image tells no yaw.
        yaw_std: Their standard deviations (H,) [rad].
        yaw_weight: Their probabilities (H,); what is missing to 1 is that none is right.
        accepted: Whether it is like those of the drive that was learned from; others count little.
    """

    position: np.ndarray
    position_std: float
    yaw: np.ndarray
    yaw_std: np.ndarray
    yaw_weight: np.ndarray
    accepted: bool = True

    @property
    def usable(self) -> bool:
        """Whether the image says anything of the position."""
        return bool(np.isfinite(self.position).all() and np.isfinite(self.position_std))


def take_fix(pose: "Poses") -> Fix:
    """The fix of a single pose, as ``Poses.take`` gives it.

    The expected error of its position is that of its radius, where the method gives one. Without a radius, a refused
    image is not used.
    """
    yaw, yaw_std, weight = _take_yaws(pose)
    accepted = pose.accepted is None or bool(pose.accepted)
    return Fix(np.asarray(pose.position, float), _find_std(pose, accepted), yaw, yaw_std, weight, accepted)


def take_fixes(poses: "Poses") -> list[Fix]:
    """The fixes of B poses."""
    return [take_fix(poses.take(row)) for row in range(len(poses.position))]


def _find_std(pose: "Poses", accepted: bool) -> float:
    if pose.radius_68 is not None:
        return max(float(pose.radius_68) / OF_RADIUS_68, FLOOR_M)
    if not accepted:
        return np.inf
    return USUAL_M if pose.position_std is None else max(UNDERSTATED * float(pose.position_std), FLOOR_M)


def _take_yaws(pose: "Poses") -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    if pose.yaw is None or pose.other_yaw is None or pose.yaw_std is None:
        return np.empty(0), np.empty(0), np.empty(0)
    yaw = np.array([pose.yaw, pose.other_yaw], float)
    weight = np.array([pose.yaw_weight, pose.other_weight], float)
    known = np.isfinite(yaw) & (weight > 0.0)
    return yaw[known], np.full(known.sum(), float(pose.yaw_std)), weight[known]
