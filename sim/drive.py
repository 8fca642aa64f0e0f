"""The drive: turn in place, drive straight until something says stop, and again. Wheel angles, ranges and bumper only.

No position, no map: the same code could drive the real robot. Each call of `next_segment` starts and ends with the
robot at rest and keeps nothing in between, so that a drive can be cut off and continued after any segment.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, NamedTuple, Protocol

import numpy as np

from sim.errors import WorkError
from sim.ranges import REACH_M, clear_length
from sim.robot import RADIUS_M, TRACK_M, WHEEL_RADIUS_M, planar_pose, wheel_speeds
from sim.settings import DriveSettings

Ended = Literal["length", "range", "contact", "stall"]

ACCELERATION_MPS2 = 0.5
TURN_ACCELERATION_RPS2 = 6.0
STRAIGHTEN_PER_S = 4.0
"""Gain that keeps the wheel angles equal: difference of their speeds over difference of their angles [1/s]."""
REST_S = 0.12
"""The robot stands this long after it has stopped, so that it no longer rocks [s]."""
PATIENCE_TURNS = 4
"""A turn that takes longer than this many whole turns would is given up."""
SHARES = (1.0, 0.5, 0.25, 0.125)
"""In a narrow place the robot is content with less and less of SHORTEST_M and of the stopping distance."""
CAUTION = (1.0, 0.5, 0.25, 0.12, 0.06)
"""Shares of the turn rate with which the robot looks for a clear heading, one after another."""
FURTHER_RAD = 0.3
"""After the first clear heading the robot turns on by up to this [rad], not to graze what it just missed."""
CLOSE_M = 0.002
CLOSE_RAD = 0.01
"""Nearer than this to its goal the robot stops: a controller that decides in periods cannot do better."""
SHORTEST_M = 0.16
"""A heading is taken when at least this is clear ahead [m]."""
DOUBT_M = 0.12
"""A contact or stall makes the samples of this last stretch of wheel way doubtful: they are dropped [m]."""
STALL_S = 0.2
"""Wheels that turned less than half of what they were told for this long are blocked [s]."""
SLIP_M = 0.10
SEEN_M = 0.01
"""The wheels turned by SLIP_M while what is ahead came nearer by less than SEEN_M: they slip [m]."""
BACK_M = 0.06
BACK_MPS = 0.08
TRIES = 500


class Robot(Protocol):
    """What the drive needs of a robot; none of it is the truth, and it never looks into a snapshot."""

    def step(self, wheel_speed: np.ndarray) -> None: ...
    def wheel_angle(self) -> np.ndarray: ...
    def ranges(self, reach_m: float) -> np.ndarray: ...
    def bumped(self) -> bool: ...
    def time(self) -> float: ...
    def snapshot(self) -> np.ndarray: ...


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
    """

    state: np.ndarray
    wheel_angle: np.ndarray
    time: np.ndarray
    continues: bool
    ended: Ended
    dropped: int

    @property
    def pose(self) -> np.ndarray:
        """True planar pose at each sample (m, 3)."""
        return planar_pose(self.state)

    @property
    def reached_end(self) -> bool:
        """Whether its last sample is where the robot now stands, so that the next segment may continue it."""
        return self.ended in ("length", "range")


def drive(robot: Robot, settings: DriveSettings, rng: np.random.Generator) -> Iterator[Segment]:
    """Drive for ever, one segment after another."""
    continues = False
    while True:
        segment = next_segment(robot, settings, rng, continues)
        continues = segment.reached_end
        yield segment


def next_segment(robot: Robot, settings: DriveSettings, rng: np.random.Generator, continues: bool) -> Segment:
    """Turn to a clear heading and drive one straight segment of at least two samples.

    Args:
        robot: Stands still.
        settings: How to drive and when to look.
        rng: Decides headings and lengths.
        continues: The robot stands where the last segment ended (its ``reached_end``).

    Raises:
        WorkError: the robot is stuck.
    """
    for _ in range(TRIES):
        stop_m = _turn_to_clear(robot, settings, rng)
        segment = _go_straight(robot, settings, stop_m, continues)
        if not segment.reached_end:
            _back_off(robot, settings)
        if len(segment.time) >= 2:
            return segment
        continues = False
    raise WorkError(f"the robot is stuck at {robot.time():.1f} s: {TRIES} attempts to drive straight failed")


def _turn_to_clear(robot: Robot, settings: DriveSettings, rng: np.random.Generator) -> float:
    """Turn by a random angle, and on in the same direction until enough is clear ahead.

    Returns:
        The room to leave before the body [m]: the settings' own, less where a whole turn found nothing clear.
    """
    angle = rng.uniform(-np.pi, np.pi)
    _turn(robot, settings, angle)
    for share in SHARES:
        enough_m, stop_m = SHORTEST_M * share, settings.stop_distance_m * share
        # The clear headings may be fewer than a brisk turn overshoots: from try to try more slowly and less far on.
        for caution in CAUTION:
            if _look_ahead(robot, REACH_M) - stop_m >= enough_m:
                return stop_m
            further = np.copysign(rng.uniform(0.0, FURTHER_RAD) * caution, angle)
            if not _turn(robot, settings, further, until_clear_m=enough_m + stop_m, caution=caution):
                break
    raise WorkError(f"the robot is stuck at {robot.time():.1f} s: nothing is clear all around")


def _look_ahead(robot: Robot, reach_m: float) -> float:
    """How far the robot may go straight ahead before it touches [m], as far as rays of a reach tell."""
    return clear_length(robot.ranges(reach_m))


def _turn(
    robot: Robot,
    settings: DriveSettings,
    angle: float,
    until_clear_m: float | None = None,
    caution: float = 1.0,
) -> bool:
    """Turn in place by an angle [rad], closed on the wheel angles.

    Args:
        robot: Stands still.
        settings: How fast to turn.
        angle: How far; counted from the first heading with this much clear ahead where ``until_clear_m`` [m] is given.
        until_clear_m: See there.
        caution: Share of the settings' turn rate to turn with.

    Returns:
        False where a whole turn found nothing clear.
    """
    period, start = settings.control_period_s, robot.wheel_angle()
    goal = abs(angle) if until_clear_m is None else np.inf
    rate, highest = 0.0, settings.turn_rate_rps * caution
    deadline = robot.time() + PATIENCE_TURNS * 2 * np.pi / highest
    while robot.time() < deadline:
        left, right = robot.wheel_angle() - start
        turned = abs(right - left) * WHEEL_RADIUS_M / TRACK_M
        if until_clear_m is not None and goal == np.inf:
            if _look_ahead(robot, until_clear_m + RADIUS_M + SEEN_M) >= until_clear_m:
                goal = turned + abs(angle) + rate**2 / (2 * TURN_ACCELERATION_RPS2)
            elif turned > 2 * np.pi:
                break
        if goal - turned < CLOSE_RAD:
            break
        rate = _ramp(rate, highest, TURN_ACCELERATION_RPS2, goal - turned, period)
        robot.step(wheel_speeds(0.0, np.copysign(rate, angle)))
    _stand(robot, settings)
    return goal < np.inf


def _go_straight(robot: Robot, settings: DriveSettings, stop_m: float, continues: bool) -> Segment:
    """Drive straight until the length, the ranges, the bumper or a stall stop it, and take the samples.

    Args:
        robot: Stands still.
        settings: How fast, how far, when to look.
        stop_m: Room to leave before the body [m].
        continues: See `next_segment`.
    """
    period, spacing = settings.control_period_s, settings.spacing_m
    start, samples = robot.wheel_angle(), [_sample(robot, 0.0)]
    speed = way_m = slip_from_m = held_s = 0.0
    seen_m = np.inf
    # Near rays are enough to stop in time, and cheaper.
    blind_m = settings.speed_mps**2 / (2 * ACCELERATION_MPS2) + SLIP_M + 0.1
    reach_m = blind_m + stop_m + RADIUS_M + SEEN_M
    ended: Ended | None = None
    while True:
        clear_m = _look_ahead(robot, reach_m) - stop_m
        if abs(clear_m - seen_m) > SEEN_M or clear_m > blind_m:
            seen_m, slip_from_m = clear_m, way_m
        rest_m = min(settings.longest_m - way_m, clear_m)
        if ended := _why_stop(robot.bumped(), held_s, way_m - slip_from_m, clear_m, rest_m):
            break
        speed = _ramp(speed, settings.speed_mps, ACCELERATION_MPS2, rest_m, period)
        left, right = robot.wheel_angle() - start
        even = STRAIGHTEN_PER_S * (left - right) / 2
        robot.step(wheel_speeds(speed, 0.0) + (-even, even))
        before_m, way_m = way_m, _way(robot, start)
        held_s = held_s + period if way_m - before_m < speed * period / 2 else 0.0
        if settings.strategy == "dense" and way_m >= len(samples) * spacing:
            samples.append(_sample(robot, way_m))
    _stand(robot, settings)
    taken = len(samples)
    if ended in ("contact", "stall"):
        samples = [sample for sample in samples if sample.way_m <= way_m - DOUBT_M]
    elif way_m < CLOSE_M:
        samples = []
    else:
        samples.append(_sample(robot, _way(robot, start)))
        # The end is the next segment's start: a regular sample just before it gives way.
        if len(samples) > 2 and samples[-1].way_m - samples[-2].way_m < spacing / 2:
            del samples[-2]
    return Segment(
        state=np.array([sample.state for sample in samples]),
        wheel_angle=np.array([sample.wheel_angle for sample in samples]),
        time=np.array([sample.time for sample in samples]),
        continues=continues,
        ended=ended,
        dropped=max(taken - len(samples), 0),
    )


def _why_stop(bumped: bool, held_s: float, slipped_m: float, clear_m: float, rest_m: float) -> Ended | None:
    if bumped:
        return "contact"
    if held_s > STALL_S or slipped_m > SLIP_M:
        return "stall"
    if rest_m < CLOSE_M:
        return "range" if clear_m < CLOSE_M else "length"
    return None


def _back_off(robot: Robot, settings: DriveSettings) -> None:
    """Roll back a little from what was touched."""
    start, deadline = robot.wheel_angle(), robot.time() + 3 * BACK_M / BACK_MPS
    while _way(robot, start) > -BACK_M and robot.time() < deadline:
        robot.step(wheel_speeds(-BACK_MPS, 0.0))
    _stand(robot, settings)


def _stand(robot: Robot, settings: DriveSettings) -> None:
    for _ in range(max(1, round(REST_S / settings.control_period_s))):
        robot.step(wheel_speeds(0.0, 0.0))


def _ramp(speed: float, highest: float, acceleration: float, rest: float, period: float) -> float:
    """Speed for the next period: rises and falls no faster than the acceleration, and is zero where nothing rests.

    Braking from v needs v^2 / 2a; the way of the period to come is spent before braking can begin.
    """
    braking = np.sqrt(2 * acceleration * max(rest - speed * period, 0.0))
    return float(min(highest, speed + acceleration * period, braking))


def _way(robot: Robot, start: np.ndarray) -> float:
    """Way by the wheel angles since they were ``start`` (2,) [m]."""
    left, right = robot.wheel_angle() - start
    return float(left + right) / 2 * WHEEL_RADIUS_M


def _sample(robot: Robot, way_m: float) -> Sample:
    return Sample(way_m, robot.wheel_angle(), robot.time(), robot.snapshot())
