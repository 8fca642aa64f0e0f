"""Visits: when the robot last drove over each place, by dead reckoning from its wheel angles.

The drive prefers headings over floor that was visited long ago. Dead reckoning drifts where wheels slip; then some
places are visited more often than others, and nothing else depends on it.
"""

import math

import numpy as np

from sim.robot.model import Body, wheel_motion

CELL_M = 0.1
SIDE = 512
"""Cells along each side of the grid, which repeats: places 51 m apart share a cell."""
NEAR_M = 0.15
"""Places this near to where the robot's middle passed count as visited [m]: about its radius and half a cell."""
NEVER_M = 10_000.0
"""How long ago a place that was never visited counts as visited [m]: longer than most drives."""
START_M = 0.5
"""What stopping, turning and starting costs, as a distance [m]."""


class Visits:
    """A grid of the distance that the robot had driven when it last visited each cell.

    Args:
        body: Dimensions of the robot.
        wheel_angle: Wheel angles (2,) where it begins [rad].
    """

    def __init__(self, body: Body, wheel_angle: np.ndarray) -> None:
        self._body, self._angle = body, wheel_angle
        self._place, self._driven_m = np.zeros(2), 0.0
        self._last_m = np.full((SIDE, SIDE), -NEVER_M)

    def move(self, wheel_angle: np.ndarray) -> None:
        """Follow the robot to the wheel angles (2,) [rad], which it reached by a turn, a straight line or an arc."""
        arc_m, turned = wheel_motion(wheel_angle - self._angle, self._body)
        chord_m = arc_m * np.sinc(turned / (2 * np.pi))
        middle = self._heading + turned / 2
        self._place = self._place + chord_m * np.array((math.cos(middle), math.sin(middle)))
        self._driven_m += abs(arc_m)
        self._angle = wheel_angle

    def pass_over(self, wheel_angle: np.ndarray) -> None:
        """Follow the robot along a straight segment to the wheel angles (2,) [rad], and note what it passed over."""
        start, start_m = self._place, self._driven_m
        self.move(wheel_angle)
        count = 1 + math.ceil((self._driven_m - start_m) / (CELL_M / 2))
        reach = math.ceil(NEAR_M / CELL_M)
        offset = np.mgrid[-reach : reach + 1, -reach : reach + 1].reshape(2, -1).T
        along = np.linspace(0.0, 1.0, count)[:, None]
        place = start + along * (self._place - start)
        cell = np.floor(place / CELL_M).astype(int)[:, None] + offset
        near = np.linalg.norm((cell + 0.5) * CELL_M - place[:, None], axis=-1) <= NEAR_M
        row, column = cell[near].T % SIDE
        self._last_m[row, column] = self._driven_m

    def staleness(self, turned_rad: float, clear_m: float, advanced_m: float = 0.0) -> float:
        """How stale the floor along a straight drive is: the squared distance driven since it was last visited, summed
        over points 0.1 m apart, per length of the drive with START_M [m].

        Args:
            turned_rad: Heading of the drive, to the left of the robot's own [rad].
            clear_m: Length of the drive [m].
            advanced_m: How far the robot has gone straight ahead of where it last moved to [m].
        """
        heading, ahead = self._heading, np.arange(CELL_M, max(clear_m, CELL_M) + 1e-9, CELL_M)
        start = self._place + advanced_m * np.array((math.cos(heading), math.sin(heading)))
        place = start + ahead[:, None] * (math.cos(heading + turned_rad), math.sin(heading + turned_rad))
        row, column = np.floor(place / CELL_M).astype(int).T % SIDE
        return float(((self._driven_m - self._last_m[row, column]) ** 2).sum()) / (clear_m + START_M)

    def forget(self) -> None:
        """Forget all visits: the robot was carried to where it does not know."""
        self._last_m[:] = -NEVER_M

    def state(self) -> dict[str, np.ndarray]:
        """Arrays from which ``set_state`` restores everything."""
        cell = np.flatnonzero(self._last_m > -NEVER_M)
        return {
            "visit_angle": self._angle,
            "visit_pose": np.array((*self._place, self._driven_m)),
            "visit_cell": cell,
            "visit_last_m": self._last_m.ravel()[cell],
        }

    def set_state(self, state: dict[str, np.ndarray]) -> None:
        """Restore the arrays of ``state``; others are not read."""
        self._angle = state["visit_angle"]
        *place, self._driven_m = state["visit_pose"].tolist()
        self._place = np.array(place)
        self.forget()
        self._last_m.ravel()[state["visit_cell"]] = state["visit_last_m"]

    @property
    def _heading(self) -> float:
        return wheel_motion(self._angle, self._body)[1]
