"""Gaps to the side of the robot: places where what it passes recedes, so that it could turn in."""

import numpy as np

from sim.robot.motion import SEEN_M, Robot, look
from sim.robot.range_finder import REACH_M

RISE_M = 0.8
"""Another part of the room begins where the clear distance to the side grows by this between two looks [m]."""
NEAR_RISE_M = 0.1
"""A place to turn in begins where the clear distance to the side grows by this [m]."""
EVERY_M = 0.015
"""Distance travelled between two looks [m]: small enough for an entrance with a few centimetres to spare."""


class Gaps:
    """Looks for gaps on one side or both along one straight segment.

    Args:
        sides: Where to look: 1 left, -1 right.
        enough_m: Any place counts where this much becomes clear [m]; None: only where another part of the room begins.
        radius_m: Radius of the robot [m].
    """

    def __init__(self, sides: tuple[int, ...], enough_m: float | None, radius_m: float) -> None:
        self.sides, self.enough_m = sides, enough_m
        self.reach_m = REACH_M if enough_m is None else enough_m + radius_m + SEEN_M
        self.before_m, self.next_m = dict.fromkeys(sides, np.inf), 0.0

    def find(self, robot: Robot, travelled_m: float) -> list[int]:
        """Return the sides on which a gap has begun since the last look, after ``travelled_m`` [m] of the segment."""
        if travelled_m < self.next_m:
            return []
        self.next_m = travelled_m + EVERY_M
        return [side for side in self.sides if self._begins(side, look(robot, self.reach_m, side * np.pi / 2))]

    def _begins(self, side: int, clear_m: float) -> bool:
        before_m, self.before_m[side] = self.before_m[side], clear_m
        if self.enough_m is None:
            return clear_m - before_m > RISE_M
        return clear_m - before_m > NEAR_RISE_M and clear_m >= self.enough_m
