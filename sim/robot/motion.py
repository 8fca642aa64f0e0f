"""How the robot moves: it looks, turns in place, rolls back and pauses, controlled by its wheel angles."""

from typing import Protocol

import numpy as np

from sim.robot.model import CONTROL_PERIOD_S, Body, wheel_motion, wheel_speeds
from sim.robot.range_finder import clear_length
from sim.settings import TURN_RATE_RPS

ACCELERATION_MPS2 = 0.5
TURN_ACCELERATION_RPS2 = 6.0
REST_S = 0.12  # The robot pauses this long after a stop, until it no longer rocks [s]
PATIENCE_TURNS = 4  # A turn is given up if it takes longer than this many full turns would
GOAL_TOLERANCE_RAD, GOAL_TOLERANCE_M = 0.01, 0.002
"""The robot stops when it is nearer than this to its goal: a controller that acts once per period can do no better."""
RANGE_TOLERANCE_M = 0.01  # Ranges that differ by less than this count as unchanged [m]
ROLL_BACK_M = 0.06
ROLL_BACK_MPS = 0.08


class Robot(Protocol):
    """What the drive needs from a robot. None of it is ground truth: the drive never reads what is in a snapshot."""

    @property
    def body(self) -> Body: ...
    def step(self, wheel_speed: np.ndarray) -> None: ...
    def wheel_angle(self) -> np.ndarray: ...
    def ranges(self, reach_m: float, turned_rad: float = 0.0) -> np.ndarray: ...
    def bumped(self) -> bool: ...
    def time(self) -> float: ...
    def snapshot(self) -> np.ndarray: ...
    def carry(self, rng: np.random.Generator) -> None: ...


def look(robot: Robot, reach_m: float, turned_rad: float = 0.0) -> float:
    """How far the robot could drive before a contact [m], at most the reach, at an angle to the left of ahead [rad]."""
    return clear_length(robot.ranges(reach_m, turned_rad), robot.body.radius_m)


def turn(robot: Robot, angle: float, until_clear_m: float | None = None, caution: float = 1.0) -> bool:
    """Turn in place from rest by an angle [rad], measured by the wheel angles, at a fraction ``caution`` of the turn
    rate; if so much must be clear ahead [m], on from the first heading that is. False: a full turn found none."""
    period, start = CONTROL_PERIOD_S, robot.wheel_angle()
    goal = abs(angle) if until_clear_m is None else np.inf
    rate, highest = 0.0, TURN_RATE_RPS * caution
    deadline = robot.time() + PATIENCE_TURNS * 2 * np.pi / highest
    while robot.time() < deadline:
        turned = abs(wheel_motion(robot.wheel_angle() - start, robot.body)[1])
        if until_clear_m is not None and goal == np.inf:
            if look(robot, until_clear_m + robot.body.radius_m + RANGE_TOLERANCE_M) >= until_clear_m:
                goal = turned + abs(angle) + rate**2 / (2 * TURN_ACCELERATION_RPS2)
            elif turned > 2 * np.pi:
                break
        if goal - turned < GOAL_TOLERANCE_RAD:
            break
        rate = ramp(rate, highest, TURN_ACCELERATION_RPS2, goal - turned, period)
        robot.step(wheel_speeds(0.0, np.copysign(rate, angle), robot.body))
    halt(robot)
    return goal < np.inf


def back_off(robot: Robot) -> None:
    """Roll back a little from the contact."""
    start, deadline = robot.wheel_angle(), robot.time() + 3 * ROLL_BACK_M / ROLL_BACK_MPS
    while travelled(robot, start) > -ROLL_BACK_M and robot.time() < deadline:
        robot.step(wheel_speeds(-ROLL_BACK_MPS, 0.0, robot.body))
    halt(robot)


def halt(robot: Robot) -> None:
    for _ in range(max(1, round(REST_S / CONTROL_PERIOD_S))):
        robot.step(wheel_speeds(0.0, 0.0))


def ramp(speed: float, highest: float, acceleration: float, rest: float, period: float) -> float:
    """Return the speed for the next period: it changes no faster than the acceleration and is zero at the goal.

    Braking from v needs v^2 / 2a, and the robot travels for one more period before braking can begin.
    """
    braking = np.sqrt(2 * acceleration * max(rest - speed * period, 0.0))
    return float(min(highest, speed + acceleration * period, braking))


def travelled(robot: Robot, start: np.ndarray) -> float:
    """Return the distance travelled by the wheel angles since they were ``start`` (2,) [m]."""
    return wheel_motion(robot.wheel_angle() - start, robot.body)[0]
