"""What the ROS 2 node next to this file does, without ROS: poses of images, and the odometry's frame in the map."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

RADIUS_68 = 1.5096
"""Radius of 68 % over the standard deviation along one axis, of a normal distribution in the plane."""


@dataclass(frozen=True)
class Fix:
    """What one image says.

    Attributes:
        map_to_base: The robot's pose in the map: x, y [m], yaw [rad] (3,).
        covariance: Of x, y, z, roll, pitch, yaw (6, 6), zero where the robot cannot move, as AMCL has it.
        map_to_odom: The frame of the odometry in the map: x, y [m], yaw [rad] (3,).
    """

    map_to_base: np.ndarray
    covariance: np.ndarray
    map_to_odom: np.ndarray


class Localizer:
    """Keeps where the odometry's frame is in the map (REP-105): the odometry drifts, and this frame makes up for it.

    Args:
        locate: Pose of an image as a dictionary, as ``Locator.locate`` of an exported folder gives it.
        meta: The exported folder's ``meta.json``.
    """

    def __init__(self, locate: Callable[[np.ndarray], Mapping[str, np.ndarray]], meta: Mapping[str, object]) -> None:
        if meta["mirrored"] or "yaw" not in meta["outputs"]:
            raise ValueError("this model's map is mirrored or gives no yaw: export deepgps_compass, or --frame world")
        self.locate = locate
        self.map_to_odom: np.ndarray | None = None

    def see(self, image: np.ndarray, odom_to_base: np.ndarray) -> Fix | None:
        """What an image (height, width, 3) RGB uint8 says; None: it is refused, and the frame stays where it is.

        Args:
            image: The image.
            odom_to_base: The robot's pose by odometry when it was taken: x, y [m], yaw [rad] (3,).
        """
        found = self.locate(image)
        pose = np.append(found["position"], found["yaw"]).astype(float)
        if not np.isfinite(pose).all() or not found.get("accepted", True):
            return None
        self.map_to_odom = compose(pose, invert(odom_to_base))
        return Fix(pose, find_covariance(found), self.map_to_odom)


def find_covariance(found: Mapping[str, np.ndarray]) -> np.ndarray:
    """Covariance (6, 6) of a pose by its radius of 68 %, or else by the deviation that the map alone shows."""
    along = found["radius_68"] / RADIUS_68
    return np.diag([along, along, 0.0, 0.0, 0.0, found["yaw_std"]]).astype(float) ** 2


def compose(first: np.ndarray, then: np.ndarray) -> np.ndarray:
    """The pose (3,) that has the pose ``then`` (3,) in the frame of the pose ``first`` (3,)."""
    cos, sin = np.cos(first[2]), np.sin(first[2])
    x, y = first[0] + cos * then[0] - sin * then[1], first[1] + sin * then[0] + cos * then[1]
    return np.array([x, y, (first[2] + then[2] + np.pi) % (2 * np.pi) - np.pi])


def invert(pose: np.ndarray) -> np.ndarray:
    """The pose (3,) of the frame in which a pose (3,) is given, in the frame of that pose."""
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    return np.array([-cos * pose[0] - sin * pose[1], sin * pose[0] - cos * pose[1], -pose[2]])
