"""The lidar in a room: rays all around in the robot's own level plane, by ``mujoco.mj_multiRay``; no OpenGL.

The lidar's model is the room without the robot, so it cannot see the robot itself. Rays hit geoms that can collide.
"""

from collections.abc import Callable

import mujoco
import numpy as np

from sim.rooms.build import build_room
from sim.rooms.spec import compile_solid
from sim.sensors.catalog import Opened
from sim.sensors.lidar_scan import LIDAR_REACH_M, arrange, ray_angles
from sim.settings import LidarSettings, SimSettings

LIDAR_HEIGHT_M = 0.18  # Height of the rays above the floor [m] (TurtleBot3 Burger)


class Lidar:
    """A lidar in a room without the robot."""

    def __init__(self, room: mujoco.MjSpec, lidar: LidarSettings) -> None:
        self._model, self._data = compile_solid(room)
        self._lidar = lidar
        angle = ray_angles(lidar)
        self._ahead = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)])
        self._distance, self._geom = np.empty(len(angle)), np.empty(len(angle), np.int32)

    def scan(self, state: np.ndarray) -> np.ndarray:
        """Scan (headings, rays) float32 [m], cut off at the reach, of a state (nq,), whose free joint comes first."""
        turn = np.empty(9)
        mujoco.mju_quat2Mat(turn, np.asarray(state[3:7], float))
        axes = turn.reshape(3, 3)
        point = np.asarray(state[:3], float) + LIDAR_HEIGHT_M * axes[:, 2]
        rays = np.ascontiguousarray((axes @ self._ahead).T).reshape(-1)
        distance, geom, reach_m = self._distance, self._geom, LIDAR_REACH_M
        mujoco.mj_multiRay(self._model, self._data, point, rays, None, 1, -1, geom, distance, None, len(geom), reach_m)
        # MuJoCo returns -1 if a ray hits nothing, and may return distances beyond the reach.
        missed = (distance < 0) | (distance > reach_m)
        return arrange(np.where(missed, reach_m, distance), self._lidar)


def open_lidar(settings: SimSettings, scene: Callable[[], mujoco.MjModel]) -> Opened:
    """Open the lidar in the settings' room; it does not need the scene with the robot."""
    lidar = Lidar(build_room(settings.room), settings.lidar)
    return Opened(lambda state, lean: lidar.scan(state))
