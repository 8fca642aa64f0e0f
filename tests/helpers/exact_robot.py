"""A robot without physics in a room: it goes exactly as its wheels turn."""

import numpy as np

from sim.robot.model import CONTROL_PERIOD_S, wheel_motion
from sim.robot.range_finder import REACH_M
from sim.robot.world import RoomWorld


class ExactRobot:
    """A robot at a pose (3,) x, y [m], yaw [rad]; nothing stops it, and it touches nothing."""

    def __init__(self, world: RoomWorld, pose=(0.0, 0.0, 0.0)) -> None:
        self.world, self.pose, self.body = world, np.array(pose, float), world.body
        self._angle, self._time = np.zeros(2), 0.0

    def step(self, wheel_speed: np.ndarray) -> None:
        change = np.asarray(wheel_speed) * CONTROL_PERIOD_S
        length_m, turned = wheel_motion(change, self.body)
        middle = self.pose[2] + turned / 2
        chord_m = length_m * np.sinc(turned / (2 * np.pi))
        self.pose = self.pose + (chord_m * np.cos(middle), chord_m * np.sin(middle), turned)
        self._angle, self._time = self._angle + change, self._time + CONTROL_PERIOD_S

    def wheel_angle(self) -> np.ndarray:
        return self._angle

    def ranges(self, reach_m: float = REACH_M, turned_rad: float = 0.0) -> np.ndarray:
        x, y, yaw = self.pose.tolist()
        return self.world._finder.measure(x, y, yaw + turned_rad, reach_m)

    def bumped(self) -> bool:
        return False

    def time(self) -> float:
        return self._time

    def snapshot(self) -> np.ndarray:
        return self.world.rest_states(self.pose[None])[0]

    def carry(self, rng: np.random.Generator) -> None:
        self.pose = np.array((*self.world.free_space.start, rng.uniform(-np.pi, np.pi)))
