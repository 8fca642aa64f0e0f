"""The range finder: level fans of rays from the robot's axis at several heights, floor to mast top.

It measures what a short-range multi-layer lidar would: the distance to the first thing that collides. Its model is the
room without the robot, so that no ray hits the robot itself; things without collision, such as curtains, stop no ray.
"""

import math

import mujoco
import numpy as np

from sim.robot.model import RADIUS_M
from sim.rooms.spec import compile_solid

REACH_M = 3.5
"""Longest distance measured [m] (LDS-01: 3.5 m); a ray that meets nothing nearer reads this."""
LOWEST_M = 0.015
"""Height of the lowest fan [m]: it sees the foot of a lamp, but not a rug."""
HIGHEST_GAP_M = 0.25
"""Largest distance between two fans [m]."""
SIDE_M = 0.008
"""What is further to the side of the body than this does not count as ahead [m]."""

_FRONT = np.arctan(np.linspace(-1, 1, 13) * (RADIUS_M + SIDE_M) / 0.30)
_SIDE = np.linspace(_FRONT[-1], np.radians(85.0), 9)[1:]
ANGLE = np.concatenate([-_SIDE[::-1], _FRONT, _SIDE])
"""Angles of a fan's rays from straight ahead [rad]: 19 mm apart at 0.3 m in the middle; the others cover the sides."""
_COS, _SIN = np.cos(ANGLE), np.sin(ANGLE)
_AHEAD = np.stack([_COS, _SIN, np.zeros_like(ANGLE)], axis=1)
# Beyond this distance a ray has left the strip that the body sweeps.
_LEAVES_M = (RADIUS_M + SIDE_M) / np.maximum(np.abs(_SIN), 1e-9)


class RangeFinder:
    """Casts the rays in a room."""

    def __init__(self, room: mujoco.MjSpec, height_m: float) -> None:
        """Prepare for a room (without the robot) and a robot of the given height [m]."""
        self._model, self._data = compile_solid(room)
        self.heights_m = fan_heights(height_m)
        self._distance = np.empty((len(self.heights_m), len(ANGLE)))
        self._geom = np.empty(len(ANGLE), np.int32)
        self._ray = np.empty((len(ANGLE), 3))

    def measure(self, x: float, y: float, yaw: float, reach_m: float) -> np.ndarray:
        """Return distances (K,) [m] from the robot's axis at a pose, fan after fan; at most ``reach_m``."""
        cos, sin = math.cos(yaw), math.sin(yaw)
        np.matmul(_AHEAD, ((cos, sin, 0.0), (-sin, cos, 0.0), (0.0, 0.0, 1.0)), out=self._ray)
        rays, model, data, geom = self._ray.reshape(-1), self._model, self._data, self._geom
        for distance, height in zip(self._distance, self.heights_m, strict=True):
            point = np.array((x, y, height))
            mujoco.mj_multiRay(model, data, point, rays, None, 1, -1, geom, distance, None, len(geom), reach_m)
        # MuJoCo returns -1 where a ray meets nothing, and may return distances beyond the reach.
        missed = (self._distance < 0) | (self._distance > reach_m)
        return np.where(missed, reach_m, self._distance).reshape(-1)


def fan_heights(height_m: float) -> np.ndarray:
    """Return the heights of the fans [m]: the lowest, then evenly from 0.10 m to just below the top of the robot."""
    top = height_m - 0.015
    count = int(np.ceil((top - 0.10) / HIGHEST_GAP_M)) + 1
    return np.concatenate([[LOWEST_M], np.linspace(0.10, top, count)])


def clear_length(distance: np.ndarray) -> float:
    """Return how far the round body can go straight ahead [m] before it touches what the rays (K,) [m] met.

    A ray of length r at angle a met something r cos a ahead and r sin a to the side; the body's rim gets there after
    r cos a - sqrt(R^2 - (r sin a)^2).
    """
    distance = distance.reshape(-1, len(ANGLE))
    fan, ray = np.nonzero(distance < _LEAVES_M)
    length = distance[fan, ray]
    rim = np.sqrt(np.maximum(RADIUS_M**2 - (length * _SIN[ray]) ** 2, 0.0))
    return float((length * _COS[ray] - rim).min())
