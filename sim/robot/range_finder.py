"""The range finder: level fans of rays from the robot's axis at several heights, floor to mast top.

It measures what a short-range multi-layer lidar would: the distance to the first thing that collides. Its model is the
room without the robot, so that no ray hits the robot itself; things without collision, such as curtains, stop no ray.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import mujoco
import numpy as np

from sim.robot.model import RADIUS_M
from sim.rooms.spec import compile_solid

REACH_M = 3.5  # Longest distance measured [m] (LDS-01: 3.5 m); a ray that meets nothing nearer reads this
LOWEST_FAN_M = 0.015  # Height of the lowest fan [m]: it sees the foot of a lamp, but not a rug
MAX_FAN_GAP_M = 0.25  # Largest distance between two fans [m]
SIDE_TOLERANCE_M = 0.008  # What is further to the side of the body than this does not count as ahead [m]


class Fan(NamedTuple):
    """The rays of a level fan of a robot of some radius."""

    # From straight ahead (n,) [rad]: for the testbed's own robot 19 mm apart at 0.3 m in the middle; the others cover
    # the sides
    angle: np.ndarray
    cos: np.ndarray  # Their cosines (n,)
    sin: np.ndarray  # Their sines (n,)
    leaves_m: np.ndarray  # Beyond this distance a ray has left the strip that the body sweeps (n,) [m]


@lru_cache
def lay_fan(radius_m: float) -> Fan:
    """The rays of a robot of this radius [m]."""
    front = np.arctan(np.linspace(-1, 1, 13) * (radius_m + SIDE_TOLERANCE_M) / 0.30)
    side = np.linspace(front[-1], np.radians(85.0), 9)[1:]
    angle = np.concatenate([-side[::-1], front, side])
    cos, sin = np.cos(angle), np.sin(angle)
    return Fan(angle, cos, sin, (radius_m + SIDE_TOLERANCE_M) / np.maximum(np.abs(sin), 1e-9))


class RangeFinder:
    """Casts the rays in a room."""

    def __init__(self, room: mujoco.MjSpec, height_m: float, radius_m: float = RADIUS_M) -> None:
        """Prepare for a room (without the robot) and a robot of the given height and radius [m]."""
        self._model, self._data = compile_solid(room)
        self.heights_m = fan_heights(height_m)
        fan = lay_fan(radius_m)
        self._ahead = np.stack([fan.cos, fan.sin, np.zeros_like(fan.cos)], axis=1)
        self._distance = np.empty((len(self.heights_m), len(fan.angle)))
        self._geom = np.empty(len(fan.angle), np.int32)
        self._ray = np.empty((len(fan.angle), 3))

    def measure(self, x: float, y: float, yaw: float, reach_m: float) -> np.ndarray:
        """Return distances (K,) [m] from the robot's axis at a pose, fan after fan; at most ``reach_m``."""
        cos, sin = math.cos(yaw), math.sin(yaw)
        np.matmul(self._ahead, ((cos, sin, 0.0), (-sin, cos, 0.0), (0.0, 0.0, 1.0)), out=self._ray)
        rays, model, data, geom = self._ray.reshape(-1), self._model, self._data, self._geom
        for distance, height in zip(self._distance, self.heights_m, strict=True):
            point = np.array((x, y, height))
            mujoco.mj_multiRay(model, data, point, rays, None, 1, -1, geom, distance, None, len(geom), reach_m)
        # MuJoCo returns -1 where a ray meets nothing, and may return distances beyond the reach.
        missed = (self._distance < 0) | (self._distance > reach_m)
        return np.where(missed, reach_m, self._distance).reshape(-1)


def fan_heights(height_m: float) -> np.ndarray:
    """Return the heights of the fans [m]: the lowest, then evenly from 0.10 m to just below the top of the robot.

    A robot too low for a fan at 0.10 m has two: the lowest, and one just below its top.
    """
    top = max(height_m - 0.015, LOWEST_FAN_M)
    second = min(0.10, top)
    count = int(np.ceil((top - second) / MAX_FAN_GAP_M)) + 1
    return np.concatenate([[LOWEST_FAN_M], np.linspace(second, top, count)])


def clear_length(distance: np.ndarray, radius_m: float = RADIUS_M) -> float:
    """Return how far the round body can go straight ahead [m] before it touches what the rays (K,) [m] met.

    A ray of length r at angle a met something r cos a ahead and r sin a to the side; the body's rim gets there after
    r cos a - sqrt(R^2 - (r sin a)^2).
    """
    fan = lay_fan(radius_m)
    distance = distance.reshape(-1, len(fan.angle))
    layer, ray = np.nonzero(distance < fan.leaves_m)
    length = distance[layer, ray]
    rim = np.sqrt(np.maximum(radius_m**2 - (length * fan.sin[ray]) ** 2, 0.0))
    return float((length * fan.cos[ray] - rim).min())
