"""The drive: turn in place, drive straight until something stops the robot, and repeat.

It uses only wheel angles, ranges and the bumper: the same code could drive the real robot.

Of a few random headings the robot takes the one over the floor that it visited longest ago, by dead reckoning. Even so
it seldom finds a region whose entrance is hardly wider than itself. So it turns into some of the gaps that it passes,
and now and then it searches for a while: after every segment it turns back to one side as far as it can, and it stops
at every gap on that side.

Each call of `next_segment` starts and ends with the robot at rest and keeps only a `DriveMode` and the `Visits`, so
that a drive can be interrupted and continued after any segment.
"""

from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from sim.errors import WorkError
from sim.geometry import planar_pose
from sim.robot.headings import MIN_CLEARANCE_M, Course, DriveMode, Gaps, Planner, Visits, is_staler_aside, turn_to_clear
from sim.robot.model import CONTROL_PERIOD_S, wheel_speeds
from sim.robot.motion import (
    ACCELERATION_MPS2,
    GOAL_TOLERANCE_M,
    RANGE_TOLERANCE_M,
    Robot,
    back_off,
    halt,
    look,
    ramp,
    travelled,
)
from sim.settings import DriveSettings

Ended = Literal["length", "gap", "range", "contact", "stall"]
TOUCH_ENDINGS = ("contact", "stall")  # After these endings the robot is no longer where it took its last sample

STRAIGHTENING_GAIN_PER_S = 4.0
"""Gain that keeps the wheel angles equal: difference of the speeds over difference of the angles [1/s]."""
MEAN_SEARCH_SEGMENTS = 20  # Average number of segments in a search
UNCERTAIN_DISTANCE_M = 0.12
"""A contact or stall makes the samples over this last distance travelled doubtful: they are dropped [m]."""
STALL_S = 0.2  # Wheels that turn at less than half the commanded speed for this long are blocked [s]
SLIP_M = 0.10  # The wheels slip if they roll this far while what is ahead comes no nearer [m]
TRIES, CARRY_TRIES = 500, 100  # Most attempts to drive straight, and those after which the robot is carried
MAX_ESCAPES = 20
"""When the robot is wedged between two legs, its wheels slip and a full turn barely turns it. It rolls back and tries
again at most this many times before it is relocated to the start, as if a person carried it."""


class Sample(NamedTuple):
    """What is recorded at one place: distance travelled in the segment [m], wheel angles, time, full positions."""

    travelled_m: float
    wheel_angle: np.ndarray
    time: float
    state: np.ndarray


@dataclass(frozen=True)
class Segment:
    """One straight drive."""

    # Full positions of the simulation at each sample (m, nq), kept for the camera and the ground truth
    state: np.ndarray
    wheel_angle: np.ndarray  # Wheel-joint angles at each sample (m, 2): left, right [rad]
    time: np.ndarray  # Time of each sample (m,) [s]
    continues: bool  # Whether the first sample is where the last segment ended, before the turn: the same observation
    ended: Ended  # What ended the segment
    dropped: int  # Number of samples dropped as doubtful, since the last segment
    mode: DriveMode  # How to continue
    relocated: int = 0  # How often the robot was relocated before this segment

    @property
    def pose(self) -> np.ndarray:
        """True planar pose at each sample (m, 3)."""
        return planar_pose(self.state)


def next_segment(
    robot: Robot, settings: DriveSettings, rng: np.random.Generator, mode: DriveMode, planner: Planner
) -> Segment:
    """Turn the robot, at rest, to a clear heading and drive one straight segment of at least two samples.

    The mode is the last segment's or a new one; ``rng`` draws headings, when to enter or search, and the heading
    of a relocated robot. The planner says where to, and follows the robot. Raises WorkError if the robot is stuck.
    """
    wedged = relocated = dropped = 0
    for tries in range(TRIES):
        if tries == CARRY_TRIES and not relocated:  # what holds it, its ranges do not see
            robot.carry(rng)
            planner.forget()
            mode, relocated = mode._replace(continues=False), 1
        while (course := turn_to_clear(robot, settings, rng, mode, planner)) is None:
            mode = mode._replace(continues=False)
            wedged += 1
            if wedged <= MAX_ESCAPES:
                _back_off(robot, planner)
            elif not relocated:
                robot.carry(rng)
                planner.forget()
                wedged, relocated = 0, 1
            else:
                raise WorkError(f"the robot is stuck at {robot.time():.1f} s: nothing is clear all around")
        segment = _go_straight(robot, settings, rng, course, mode, planner)
        planner.pass_over(robot.wheel_angle(), segment.wheel_angle, touched := segment.ended in TOUCH_ENDINGS)
        if touched:
            _back_off(robot, planner)
        dropped += segment.dropped
        if len(segment.time) >= 2:
            return replace(segment, dropped=dropped, relocated=relocated)
        mode = segment.mode._replace(continues=False)
    raise WorkError(f"the robot is stuck at {robot.time():.1f} s: {TRIES} attempts to drive straight failed")


def _back_off(robot: Robot, planner: Planner) -> None:
    back_off(robot)
    planner.move(robot.wheel_angle())


def _go_straight(
    robot: Robot, settings: DriveSettings, rng: np.random.Generator, course: Course, mode: DriveMode, planner: Planner
) -> Segment:
    """Drive straight until the length, a gap, the ranges, the bumper or a stall stops the robot, ``course.stop_m`` [m]
    before what is ahead of the body, and take the samples."""
    visits = planner if settings.headings == "explore" and isinstance(planner, Visits) else None
    if not isinstance(planner, Visits):
        settings = settings.model_copy(update={"enter": 0.0, "search": 0.0})
    path, length_m, gap = _Path(robot, settings), min(_draw_length(settings, rng), course.length_m), 0
    stop_m = course.stop_m
    gaps, heed = _choose_gaps(settings, mode, stop_m, robot.body.radius_m)
    # Short rays are enough to stop in time, and cheaper.
    blind_m = settings.speed_mps**2 / (2 * ACCELERATION_MPS2) + SLIP_M + 0.1
    reach_m = blind_m + stop_m + robot.body.radius_m + RANGE_TOLERANCE_M
    while True:
        clear_m = look(robot, reach_m) - stop_m
        path.see(clear_m, blind_m)
        planner.watch(robot, path.travelled_m)
        for side in gaps.find(robot, path.travelled_m) if not gap else ():
            if rng.uniform() < heed or (visits and is_staler_aside(robot, visits, side, path.travelled_m, stop_m)):
                gap, length_m = side, min(length_m, path.travelled_m + path.speed**2 / (2 * ACCELERATION_MPS2))
        rest_m = min(length_m - path.travelled_m, clear_m)
        if ended := _why_stop(robot.bumped(), path, clear_m, rest_m):
            break
        path.drive_on(rest_m)
    halt(robot)
    samples = path.finish(ended)
    return Segment(
        state=np.array([sample.state for sample in samples]),
        wheel_angle=np.array([sample.wheel_angle for sample in samples]),
        time=np.array([sample.time for sample in samples]),
        continues=mode.continues,
        ended="gap" if ended == "length" and gap else ended,
        dropped=len(path.samples) - len(samples) if ended in TOUCH_ENDINGS else 0,
        mode=_go_on(settings, rng, mode, ended, gap),
    )


class _Path:
    """What was driven in one segment, by the wheels, and the samples taken at even distances: its length [m], the
    commanded speed [m/s], and how long the wheels have turned at less than half that speed until now [s]."""

    def __init__(self, robot: Robot, settings: DriveSettings) -> None:
        self._robot, self._settings, self._start = robot, settings, robot.wheel_angle()
        self.travelled_m = self.speed = self.held_s = self._slip_from_m = 0.0
        self._seen_m, self.samples = np.inf, [_sample(robot, 0.0)]

    @property
    def slipped_m(self) -> float:
        """Distance rolled since what is ahead came nearer [m]."""
        return self.travelled_m - self._slip_from_m

    def see(self, clear_m: float, blind_m: float) -> None:
        """Note what is clear ahead [m]; beyond ``blind_m`` rays do not show whether it comes nearer."""
        if abs(clear_m - self._seen_m) > RANGE_TOLERANCE_M or clear_m > blind_m:
            self._seen_m, self._slip_from_m = clear_m, self.travelled_m

    def drive_on(self, rest_m: float) -> None:
        """Drive for one period, with ``rest_m`` left to the goal [m], and take a sample if one is due."""
        robot, settings, period = self._robot, self._settings, CONTROL_PERIOD_S
        self.speed = ramp(self.speed, settings.speed_mps, ACCELERATION_MPS2, rest_m, period)
        left, right = robot.wheel_angle() - self._start
        even = STRAIGHTENING_GAIN_PER_S * (left - right) / 2
        robot.step(wheel_speeds(self.speed, 0.0, robot.body) + (-even, even))
        before_m, self.travelled_m = self.travelled_m, travelled(robot, self._start)
        slow = self.travelled_m - before_m < self.speed * period / 2
        self.held_s = self.held_s + period if slow else 0.0
        if settings.strategy == "dense" and self.travelled_m >= len(self.samples) * settings.spacing_m:
            self.samples.append(_sample(robot, self.travelled_m))

    def finish(self, ended: Ended) -> list[Sample]:
        """The samples that count: after a touch those well before it, else also one where the robot has stopped.

        Empty if the robot hardly moved.
        """
        if ended in TOUCH_ENDINGS:
            return [one for one in self.samples if one.travelled_m <= self.travelled_m - UNCERTAIN_DISTANCE_M]
        if self.travelled_m < GOAL_TOLERANCE_M:
            return []
        last = _sample(self._robot, travelled(self._robot, self._start))
        # The end is the next segment's start, so a regular sample just before it is dropped.
        near = len(self.samples) > 1 and last.travelled_m - self.samples[-1].travelled_m < self._settings.spacing_m / 2
        return [*(self.samples[:-1] if near else self.samples), last]


def _choose_gaps(settings: DriveSettings, mode: DriveMode, stop_m: float, radius_m: float) -> tuple[Gaps, float]:
    if mode.kind == "search":
        return Gaps((mode.side,), MIN_CLEARANCE_M + stop_m, radius_m), 1.0
    sides = (1, -1) if settings.headings == "explore" or settings.enter > 0.0 else ()
    return Gaps(sides, None, radius_m), settings.enter


def _draw_length(settings: DriveSettings, rng: np.random.Generator) -> float:
    if settings.lengths == "longest":
        return settings.longest_m
    return rng.uniform(min(MIN_CLEARANCE_M, settings.longest_m), settings.longest_m)


def _why_stop(bumped: bool, path: _Path, clear_m: float, rest_m: float) -> Ended | None:
    if bumped:
        return "contact"
    if path.held_s > STALL_S or path.slipped_m > SLIP_M:
        return "stall"
    if rest_m < GOAL_TOLERANCE_M:
        return "range" if clear_m < GOAL_TOLERANCE_M else "length"
    return None


def _go_on(settings: DriveSettings, rng: np.random.Generator, mode: DriveMode, ended: Ended, gap: int) -> DriveMode:
    """Draw the next mode; the next segment continues this one if the robot is still at its last sample."""
    continues, chance = ended not in TOUCH_ENDINGS, rng.uniform()
    if mode.kind == "search" and chance > 1 / MEAN_SEARCH_SEGMENTS:
        return DriveMode(continues, "search", mode.side)
    if mode.kind != "search" and gap:
        return DriveMode(continues, "enter", gap)
    if mode.kind != "search" and chance < settings.search:
        return DriveMode(continues, "search", 1 if chance < settings.search / 2 else -1)
    return DriveMode(continues)


def _sample(robot: Robot, travelled_m: float) -> Sample:
    return Sample(travelled_m, robot.wheel_angle(), robot.time(), robot.snapshot())
