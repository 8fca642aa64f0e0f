"""The drive: turn in place, drive straight until something says stop, and again. Wheel angles, ranges and bumper only.

Headings are drawn by chance, but a robot that only bounces about seldom finds a nook whose mouth is hardly wider than
itself. So it turns into some of the gaps that it passes; and now and then it searches for a while: after every
segment it turns back to one side as far as it can, and stops wherever there is anything to turn into on that side.

No position, no map: the same code could drive the real robot. Each call of `next_segment` starts and ends with the
robot at rest and keeps only a `DriveMode`, so that a drive can be cut off and continued after any segment.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from sim.errors import WorkError
from sim.geometry import planar_pose
from sim.robot.gaps import Gaps
from sim.robot.model import CONTROL_PERIOD_S, RADIUS_M, wheel_speeds
from sim.robot.motion import ACCELERATION_MPS2, SEEN_M, Robot, back_off, look, ramp, stand, turn, way
from sim.robot.range_finder import REACH_M
from sim.settings import DriveSettings

Ended = Literal["length", "gap", "range", "contact", "stall"]
TOUCHED = ("contact", "stall")
"""After these the robot no longer stands where it last took a sample."""
Mode = Literal["chance", "enter", "search"]

STRAIGHTEN_PER_S = 4.0
"""Gain that keeps the wheel angles equal: difference of their speeds over difference of their angles [1/s]."""
SHARES = (1.0, 0.5, 0.25, 0.125)
"""In a narrow place the robot is content with less and less of SHORTEST_M and of the stopping distance."""
CAUTION = (1.0, 0.5, 0.25, 0.12, 0.06)
"""Shares of the turn rate with which the robot looks for a clear heading, one after another."""
FURTHER_RAD = 0.3
"""After the first clear heading the robot turns on by up to this [rad], not to graze what it just missed."""
CLOSE_M = 0.002
"""Nearer than this to its goal the robot stops: a controller that decides in periods cannot do better."""
SHORTEST_M = 0.16
"""A heading is taken when at least this is clear ahead [m]."""
SEARCHED = 20
"""Segments for which the robot searches, on average."""
TOWARDS_RAD = 0.6 * np.pi
"""To search, the robot turns by this to one side, then back until the way is clear [rad]."""
GRAZE_RAD = 0.05
"""Searching, it turns on by up to this [rad]: it is to graze."""
DOUBT_M = 0.12
"""A contact or stall makes the samples of this last stretch of wheel way doubtful: they are dropped [m]."""
STALL_S = 0.2
"""Wheels that turned less than half of what they were told for this long are blocked [s]."""
SLIP_M = 0.10
"""The wheels turned by this while what is ahead came no nearer: they slip [m]."""
TRIES = 500
WEDGED = 20
"""Between two legs wheels slip, and a whole turn hardly is one: the robot rolls back and turns on, at most so often
before a person has to carry it back to where it started."""


class DriveMode(NamedTuple):
    """Where the next segment is to go, and what it must know of the last."""

    continues: bool = False
    """The robot stands where the last segment ended."""
    kind: Mode = "chance"
    side: int = 0
    """Of the gap to enter, or on which it searches: 1 left, -1 right."""


class Sample(NamedTuple):
    """What is noted at one place: the way since the segment's start [m] and what the simulation writes beside."""

    way_m: float
    wheel_angle: np.ndarray
    time: float
    state: np.ndarray


@dataclass(frozen=True)
class Segment:
    """One straight drive.

    Attributes:
        state: Full positions of the simulation at each sample (m, nq), kept beside for the camera and the truth.
        wheel_angle: Wheel-joint angles at each sample (m, 2): left, right [rad].
        time: Time of each sample (m,) [s].
        continues: The first sample is where the last segment ended, before the turn: the same observation.
        ended: What ended it.
        dropped: How many samples were dropped as doubtful.
        mode: How to go on.
        relocated: How often the robot was relocated before it.
    """

    state: np.ndarray
    wheel_angle: np.ndarray
    time: np.ndarray
    continues: bool
    ended: Ended
    dropped: int
    mode: DriveMode
    relocated: int = 0

    @property
    def pose(self) -> np.ndarray:
        """True planar pose at each sample (m, 3)."""
        return planar_pose(self.state)


def drive(robot: Robot, settings: DriveSettings, rng: np.random.Generator) -> Iterator[Segment]:
    """Drive for ever, one segment after another."""
    mode = DriveMode()
    while True:
        segment = next_segment(robot, settings, rng, mode)
        mode = segment.mode
        yield segment


def next_segment(robot: Robot, settings: DriveSettings, rng: np.random.Generator, mode: DriveMode) -> Segment:
    """Turn to a clear heading and drive one straight segment of at least two samples.

    Args:
        robot: Stands still.
        settings: How to drive and when to look.
        rng: Decides headings, when to enter or search, and where a relocated robot is put.
        mode: The last segment's, or a new one.

    Raises:
        WorkError: the robot is stuck.
    """
    wedged = relocated = 0
    for _ in range(TRIES):
        while (stop_m := _turn_to_clear(robot, settings, rng, mode)) is None:
            mode = mode._replace(continues=False)
            wedged += 1
            if wedged <= WEDGED:
                back_off(robot, settings)
            elif not relocated:
                robot.carry(rng)
                wedged, relocated = 0, 1
            else:
                raise WorkError(f"the robot is stuck at {robot.time():.1f} s: nothing is clear all around")
        segment = _go_straight(robot, settings, rng, stop_m, mode)
        if segment.ended in TOUCHED:
            back_off(robot, settings)
        if len(segment.time) >= 2:
            return replace(segment, relocated=relocated)
        mode = segment.mode._replace(continues=False)
    raise WorkError(f"the robot is stuck at {robot.time():.1f} s: {TRIES} attempts to drive straight failed")


def _turn_to_clear(robot: Robot, settings: DriveSettings, rng: np.random.Generator, mode: DriveMode) -> float | None:
    """Turn where the mode says, and on until enough is clear ahead.

    Returns:
        The room to leave before the body [m]: the settings' own, less where a whole turn found nothing clear; None: it
        found nothing at all.
    """
    angle, sense, further_rad = _aim(rng, mode)
    turn(robot, settings, angle)
    for share in SHARES:
        enough_m, stop_m = SHORTEST_M * share, settings.stop_distance_m * share
        # The clear headings may be fewer than a brisk turn overshoots: from try to try more slowly and less far on.
        for caution in CAUTION:
            if look(robot, REACH_M) - stop_m >= enough_m:
                return stop_m
            further = sense * rng.uniform(0.0, further_rad) * caution
            if not turn(robot, settings, further, until_clear_m=enough_m + stop_m, caution=caution):
                break
    return None


def _aim(rng: np.random.Generator, mode: DriveMode) -> tuple[float, float, float]:
    """Angle to turn [rad]; the sense to go on where that is not clear; how far past what blocks it [rad]."""
    if mode.kind == "search":
        return mode.side * TOWARDS_RAD, -mode.side, GRAZE_RAD
    angle = mode.side * np.pi / 2 if mode.kind == "enter" else rng.uniform(-np.pi, np.pi)
    return angle, np.sign(angle), FURTHER_RAD


def _go_straight(
    robot: Robot, settings: DriveSettings, rng: np.random.Generator, stop_m: float, mode: DriveMode
) -> Segment:
    """Drive straight until the length, an gap, the ranges, the bumper or a stall stop it, and take the samples.

    Args:
        robot: Stands still.
        settings: How fast, how far, when to look.
        rng: Decides at which gaps to stop, and how to go on.
        stop_m: Room to leave before the body [m].
        mode: Whether it continues the last segment, and on which side it searches.
    """
    period, spacing = CONTROL_PERIOD_S, settings.spacing_m
    start, samples = robot.wheel_angle(), [_sample(robot, 0.0)]
    speed = way_m = slip_from_m = held_s = 0.0
    seen_m, length_m, gap = np.inf, _draw_length(settings, rng), 0
    if mode.kind == "search":
        gaps, heed = Gaps((mode.side,), SHORTEST_M + stop_m), 1.0
    else:
        gaps, heed = Gaps((1, -1) if settings.enter > 0.0 else (), None), settings.enter
    # Near rays are enough to stop in time, and cheaper.
    blind_m = settings.speed_mps**2 / (2 * ACCELERATION_MPS2) + SLIP_M + 0.1
    reach_m = blind_m + stop_m + RADIUS_M + SEEN_M
    ended: Ended | None = None
    while True:
        clear_m = look(robot, reach_m) - stop_m
        if abs(clear_m - seen_m) > SEEN_M or clear_m > blind_m:
            seen_m, slip_from_m = clear_m, way_m
        for side in gaps.find(robot, way_m) if not gap else ():
            if rng.uniform() < heed:
                gap, length_m = side, min(length_m, way_m + speed**2 / (2 * ACCELERATION_MPS2))
        rest_m = min(length_m - way_m, clear_m)
        if ended := _why_stop(robot.bumped(), held_s, way_m - slip_from_m, clear_m, rest_m):
            break
        speed = ramp(speed, settings.speed_mps, ACCELERATION_MPS2, rest_m, period)
        left, right = robot.wheel_angle() - start
        even = STRAIGHTEN_PER_S * (left - right) / 2
        robot.step(wheel_speeds(speed, 0.0) + (-even, even))
        before_m, way_m = way_m, way(robot, start)
        held_s = held_s + period if way_m - before_m < speed * period / 2 else 0.0
        if settings.strategy == "dense" and way_m >= len(samples) * spacing:
            samples.append(_sample(robot, way_m))
    stand(robot, settings)
    taken = len(samples)
    if ended in TOUCHED:
        samples = [sample for sample in samples if sample.way_m <= way_m - DOUBT_M]
    elif way_m < CLOSE_M:
        samples = []
    else:
        samples.append(_sample(robot, way(robot, start)))
        # The end is the next segment's start: a regular sample just before it gives way.
        if len(samples) > 2 and samples[-1].way_m - samples[-2].way_m < spacing / 2:
            del samples[-2]
    return Segment(
        state=np.array([sample.state for sample in samples]),
        wheel_angle=np.array([sample.wheel_angle for sample in samples]),
        time=np.array([sample.time for sample in samples]),
        continues=mode.continues,
        ended="gap" if ended == "length" and gap else ended,
        dropped=max(taken - len(samples), 0),
        mode=_go_on(settings, rng, mode, ended, gap),
    )


def _draw_length(settings: DriveSettings, rng: np.random.Generator) -> float:
    if settings.lengths == "longest":
        return settings.longest_m
    return rng.uniform(min(SHORTEST_M, settings.longest_m), settings.longest_m)


def _why_stop(bumped: bool, held_s: float, slipped_m: float, clear_m: float, rest_m: float) -> Ended | None:
    if bumped:
        return "contact"
    if held_s > STALL_S or slipped_m > SLIP_M:
        return "stall"
    if rest_m < CLOSE_M:
        return "range" if clear_m < CLOSE_M else "length"
    return None


def _go_on(settings: DriveSettings, rng: np.random.Generator, mode: DriveMode, ended: Ended, gap: int) -> DriveMode:
    """Draw the next mode; the next segment continues this one if the robot stands where its last sample is."""
    continues, chance = ended not in TOUCHED, rng.uniform()
    if mode.kind == "search" and chance > 1 / SEARCHED:
        return DriveMode(continues, "search", mode.side)
    if mode.kind != "search" and gap:
        return DriveMode(continues, "enter", gap)
    if mode.kind != "search" and chance < settings.search:
        return DriveMode(continues, "search", 1 if chance < settings.search / 2 else -1)
    return DriveMode(continues)


def _sample(robot: Robot, way_m: float) -> Sample:
    return Sample(way_m, robot.wheel_angle(), robot.time(), robot.snapshot())
