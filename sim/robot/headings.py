"""Where the next segment goes: into a gap, to one side in a search, or to the floor visited longest ago.

When the robot last drove over each place it knows by dead reckoning from its wheel angles. That drifts where wheels
slip; then some places are visited more often than others, and nothing else depends on it.
"""

import math
from typing import Literal, NamedTuple, Protocol

import numpy as np

from sim.robot.model import Body, wheel_motion
from sim.robot.motion import RANGE_TOLERANCE_M, Robot, look, turn
from sim.robot.range_finder import REACH_M
from sim.settings import DriveSettings

CELL_M = 0.1  # Side of a cell of the grid of visits [m]
GRID_CELLS = 512  # Cells along each side of the grid, which repeats: places 51 m apart share a cell
VISITED_RADIUS_M = 0.15
"""Places this near to where the robot's middle passed count as visited [m]: about its radius and half a cell."""
UNVISITED_AGE_M = 10_000.0  # How long ago a place that was never visited counts as visited [m]: longer than most drives
START_COST_M = 0.5  # What stopping, turning and starting costs, as a distance [m]


class Visits:
    """A grid of the distance that a robot had driven when it last visited each cell, from wheel angles (2,) [rad]
    on."""

    def __init__(self, body: Body, wheel_angle: np.ndarray) -> None:
        self._body, self._angle = body, wheel_angle
        self._place, self._driven_m = np.zeros(2), 0.0
        self._last_m = np.full((GRID_CELLS, GRID_CELLS), -UNVISITED_AGE_M)
        self.unseen = np.full(3, np.nan)  # visits do not tell how much floor there is

    def choose(self, robot: Robot, settings: DriveSettings, rng: np.random.Generator, mode: "DriveMode") -> "Course":
        """Where the next segment goes: as the mode says, or over the floor that was visited longest ago."""
        if mode.kind == "search":
            return Course(mode.side * SEARCH_TURN_RAD, -mode.side, SEARCH_EXTRA_TURN_RAD)
        return Course(mode.side * np.pi / 2 if mode.kind == "enter" else _choose_heading(robot, settings, rng, self))

    def watch(self, robot: Robot, travelled_m: float) -> None:
        """What is seen on the way tells nothing of visits."""

    def move(self, wheel_angle: np.ndarray) -> None:
        """Follow the robot to the wheel angles (2,) [rad], which it reached by a turn, a straight line or an arc."""
        arc_m, turned = wheel_motion(wheel_angle - self._angle, self._body)
        chord_m = arc_m * np.sinc(turned / (2 * np.pi))
        middle = self._heading + turned / 2
        self._place = self._place + chord_m * np.array((math.cos(middle), math.sin(middle)))
        self._driven_m += abs(arc_m)
        self._angle = wheel_angle

    def pass_over(self, wheel_angle: np.ndarray, images: np.ndarray | None = None, touched: bool = False) -> None:
        """Follow the robot along a straight segment to the wheel angles (2,) [rad], and note what it passed over."""
        start, start_m = self._place, self._driven_m
        self.move(wheel_angle)
        count = 1 + math.ceil((self._driven_m - start_m) / (CELL_M / 2))
        reach = math.ceil(VISITED_RADIUS_M / CELL_M)
        offset = np.mgrid[-reach : reach + 1, -reach : reach + 1].reshape(2, -1).T
        along = np.linspace(0.0, 1.0, count)[:, None]
        place = start + along * (self._place - start)
        cell = np.floor(place / CELL_M).astype(int)[:, None] + offset
        near = np.linalg.norm((cell + 0.5) * CELL_M - place[:, None], axis=-1) <= VISITED_RADIUS_M
        row, column = cell[near].T % GRID_CELLS
        self._last_m[row, column] = self._driven_m

    def staleness(self, turned_rad: float, clear_m: float, advanced_m: float = 0.0) -> float:
        """How stale the floor along a straight drive is: the squared distance driven since it was last visited, summed
        over points 0.1 m apart, per length of the drive with START_COST_M [m].

        Args:
            turned_rad: Heading of the drive, to the left of the robot's own [rad].
            clear_m: Length of the drive [m].
            advanced_m: How far the robot has gone straight ahead of where it last moved to [m].
        """
        heading, ahead = self._heading, np.arange(CELL_M, max(clear_m, CELL_M) + 1e-9, CELL_M)
        start = self._place + advanced_m * np.array((math.cos(heading), math.sin(heading)))
        place = start + ahead[:, None] * (math.cos(heading + turned_rad), math.sin(heading + turned_rad))
        row, column = np.floor(place / CELL_M).astype(int).T % GRID_CELLS
        return float(((self._driven_m - self._last_m[row, column]) ** 2).sum()) / (clear_m + START_COST_M)

    def forget(self) -> None:
        """Forget all visits: the robot was carried to where it does not know."""
        self._last_m[:] = -UNVISITED_AGE_M

    def state(self) -> dict[str, np.ndarray]:
        """Arrays from which ``set_state`` restores everything."""
        cell = np.flatnonzero(self._last_m > -UNVISITED_AGE_M)
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


RISE_M = 0.8  # Another part of the room begins where the clear distance to the side grows by this between two looks [m]
TURN_PLACE_RISE_M = 0.1  # A place to turn in begins where the clear distance to the side grows by this [m]
LOOK_SPACING_M = 0.015
"""Distance travelled between two looks [m]: small enough for an entrance with a few centimetres to spare."""


class Gaps:
    """Looks for gaps on one side (1 left, -1 right) or both along one straight segment.

    Any place counts where ``enough_m`` becomes clear [m]; None: only where another part of the room begins.
    """

    def __init__(self, sides: tuple[int, ...], enough_m: float | None, radius_m: float) -> None:
        self.sides, self.enough_m = sides, enough_m
        self.reach_m = REACH_M if enough_m is None else enough_m + radius_m + RANGE_TOLERANCE_M
        self.before_m, self.next_m = dict.fromkeys(sides, np.inf), 0.0

    def find(self, robot: Robot, travelled_m: float) -> list[int]:
        """Return the sides on which a gap has begun since the last look, after ``travelled_m`` [m] of the segment."""
        if travelled_m < self.next_m:
            return []
        self.next_m = travelled_m + LOOK_SPACING_M
        return [side for side in self.sides if self._begins(side, look(robot, self.reach_m, side * np.pi / 2))]

    def _begins(self, side: int, clear_m: float) -> bool:
        before_m, self.before_m[side] = self.before_m[side], clear_m
        if self.enough_m is None:
            return clear_m - before_m > RISE_M
        return clear_m - before_m > TURN_PLACE_RISE_M and clear_m >= self.enough_m


Mode = Literal["chance", "enter", "search"]

CLEARANCE_SHARES = (1.0, 0.5, 0.25, 0.125)
"""In a narrow place the robot accepts these fractions of MIN_CLEARANCE_M and of the stopping distance, in order."""
STOP_DISTANCE_M = 0.04  # The robot stops when a range ray shows less room than this in front of its body [m]
TURN_RATE_SHARES = (1.0, 0.5, 0.25, 0.12, 0.06)
"""Fractions of the turn rate at which the robot looks for a clear heading, tried in order."""
EXTRA_TURN_RAD = 0.3
"""After the first clear heading the robot turns on by up to this [rad], so as not to graze what blocked it."""
MIN_CLEARANCE_M = 0.16  # A heading is accepted when at least this distance is clear ahead [m]
CANDIDATE_HEADINGS = 12  # Random headings among which the robot chooses
SEARCH_TURN_RAD = 0.6 * np.pi  # To search, the robot turns by this to one side, then back until the path is clear [rad]
SEARCH_EXTRA_TURN_RAD = 0.05
"""In a search the robot turns on past the first clear heading by only this at most [rad], so that it grazes walls."""


class DriveMode(NamedTuple):
    """Where the next segment goes, and what it must know about the last one."""

    continues: bool = False
    """Whether the robot is where the last segment ended."""
    kind: Mode = "chance"
    side: int = 0
    """Side of the gap to enter, or side to search: 1 left, -1 right."""


class Course(NamedTuple):
    """Where the next segment goes."""

    turn_rad: float = 0.0  # Angle to turn, to the left [rad]
    sense: float = 0.0  # Direction to turn on in if that is not clear; 0: the same
    further_rad: float = EXTRA_TURN_RAD  # How far to turn past what blocks, at most [rad]
    length_m: float = math.inf  # How far to go, at most [m]
    stop_m: float = STOP_DISTANCE_M  # Distance to leave ahead of the body [m]


class Planner(Protocol):
    """Says where the next segment goes, and follows the robot by its wheel angles (2,) [rad] and what it sees."""

    unseen: np.ndarray  # Share of the floor that no image is near: likely, at least, and at most (3,); NaN: unknown

    def choose(self, robot: Robot, settings: DriveSettings, rng: np.random.Generator, mode: DriveMode) -> Course: ...
    def watch(self, robot: Robot, travelled_m: float) -> None: ...
    def move(self, wheel_angle: np.ndarray) -> None: ...
    def pass_over(self, wheel_angle: np.ndarray, images: np.ndarray, touched: bool) -> None: ...
    def forget(self) -> None: ...
    def state(self) -> dict[str, np.ndarray]: ...
    def set_state(self, state: dict[str, np.ndarray]) -> None: ...


def turn_to_clear(
    robot: Robot, settings: DriveSettings, rng: np.random.Generator, mode: DriveMode, planner: Planner
) -> Course | None:
    """Turn to where the planner says, then on until enough is clear ahead.

    Returns the course, with less to leave ahead of the body if a full turn found nothing clear; None if no heading is
    clear even then.
    """
    course = planner.choose(robot, settings, rng, mode)
    turn(robot, course.turn_rad)
    stop_m = _turn_on(robot, rng, course)
    planner.move(robot.wheel_angle())
    return None if stop_m is None else course._replace(stop_m=stop_m)


def _turn_on(robot: Robot, rng: np.random.Generator, course: Course) -> float | None:
    """Turn on to where enough is clear, and a little past it; returns the distance to leave ahead [m], if any."""
    for share in CLEARANCE_SHARES:
        enough_m, stop_m = MIN_CLEARANCE_M * share, STOP_DISTANCE_M * share
        # The range of clear headings may be smaller than the overshoot of a fast turn: each try turns more slowly and
        # less far past it.
        for caution in TURN_RATE_SHARES:
            if look(robot, REACH_M) - stop_m >= enough_m:
                return stop_m
            further = (course.sense or np.sign(course.turn_rad)) * rng.uniform(0.0, course.further_rad) * caution
            if not turn(robot, further, until_clear_m=enough_m + stop_m, caution=caution):
                break
    return None


def is_staler_aside(robot: Robot, visits: Visits, side: int, travelled_m: float, stop_m: float) -> bool:
    """Whether the floor to one side was visited longer ago than the floor ahead.

    Args:
        robot: The robot, on a straight segment.
        visits: What it had visited before the segment.
        side: 1 left, -1 right.
        travelled_m: Distance travelled in the segment [m].
        stop_m: Distance to leave ahead of the body [m].
    """
    aside = side * np.pi / 2
    ahead_m, aside_m = look(robot, REACH_M) - stop_m, look(robot, REACH_M, aside) - stop_m
    if aside_m < MIN_CLEARANCE_M:
        return False
    return visits.staleness(aside, aside_m, travelled_m) > visits.staleness(0.0, ahead_m, travelled_m)


def _choose_heading(robot: Robot, settings: DriveSettings, rng: np.random.Generator, visits: Visits) -> float:
    """Of some random headings, the one over the floor that was visited longest ago [rad], to the left of ahead."""
    if settings.headings == "random":
        return rng.uniform(-np.pi, np.pi)
    drawn = rng.uniform(-np.pi, np.pi, CANDIDATE_HEADINGS)
    clear_m = [look(robot, REACH_M, angle) - STOP_DISTANCE_M for angle in drawn]
    stale = [
        visits.staleness(angle, ahead_m) if ahead_m >= MIN_CLEARANCE_M else 0.0
        for angle, ahead_m in zip(drawn, clear_m, strict=True)
    ]
    return float(drawn[np.argmax(stale)])
