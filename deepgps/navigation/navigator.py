"""The navigator: drives the robot to a goal by its own positions, or refuses the goal.

It plans over driven floor, follows the plan, stops before what its ranges see, rolls back from what it touches, plans
around both, and turns for another look when it is unsure where it is. It says itself that it has arrived.
"""

from collections.abc import Callable, Generator
from typing import NamedTuple

import numpy as np

from deepgps.navigation.follow import AIM_RAD, MAX_TURN_RPS, REST, Command, Follower
from deepgps.navigation.position import ARRIVAL_IMAGES, Source
from deepgps.navigation.route import Floor, measure_along

STOP_AT_M, ARRIVAL_M = 0.03, 0.05  # It stops this near to its goal, and has arrived if it is this near at rest [m]
REACH_M = 0.5  # How far ahead it looks with its ranges [m]
STOP_M = 0.03  # It stops this far before what its ranges see [m]
BLOCK_M = 0.1  # Its middle keeps this far from what blocked it twice, or what it touched [m]
FAN_RAD, FAN_M = (0.0, -0.4, 0.4, -0.8, 0.8), 0.2  # It then looks for more so near, to its sides too [rad], [m]
AGAIN_M = 0.15  # It is blocked again if its middle is nearer than this to where it was blocked [m]
SLOW_MPS, ROLL_BACK_M = 0.08, 0.08  # How fast it rolls back from a contact or goes off, and how far back [m/s], [m]
REST_S = 0.2  # How long it rests before a look at rest [s]
LOOKS, LOOK_RAD = 9, 0.8  # So many looks it takes, turned by so much each, to find where it is [rad]
PLACES, AWAY_M = 3, 0.4  # It looks around at so many places, each so far from the one before [m]
MAX_PLANS = 30  # So often it plans
PATIENCE_S, PATIENCE_FACTOR = 60.0, 6.0  # A goal is refused after so long, and so many times what driving takes [s]
RADIUS_M = 0.105  # Radius of the testbed's own robot [m]
CRUISE_MPS = 0.2  # Speed by which it knows how long driving takes [m/s]


class Senses(NamedTuple):
    """What the robot senses now."""

    ticks: np.ndarray  # Cumulative, of the left and right encoder (2,)
    # How far it could drive before a contact, at most ``REACH_M`` [m], at an angle to the left of ahead [rad]
    clear_m: Callable[[float], float]
    bumped: bool  # Whether something presses against it
    look: Callable[[], np.ndarray]  # Takes an image


class Outcome(NamedTuple):
    """How a drive to a goal ended."""

    arrived: bool  # The robot says that it has arrived
    reason: str  # Why the goal was refused, in one line; empty: it was not


Steps = Generator[Command]


class Navigator:
    """Drives to goals on a floor, by a source of positions; each period lasts ``period_s`` [s]."""

    def __init__(self, source: Source, floor: Floor, radius_m: float = RADIUS_M, period_s: float = 0.04) -> None:
        self.source, self.floor, self._radius_m, self._period_s = source, floor, radius_m, period_s
        self.outcome: Outcome | None = None  # None: the robot is on its way
        self.route = np.empty((0, 2))  # The route that it follows (n, 2) [m]

    def start(self, goal: np.ndarray) -> None:
        """Set out for a goal (2,) [m] in the method's frame, from wherever the robot stands."""
        self.outcome, self.route, self._time_s, self._limit_s = None, np.empty((0, 2)), 0.0, PATIENCE_S
        self._goal, self._clear, self._blocked = np.asarray(goal, float), self.floor, list[np.ndarray]()
        self._steps = self._drive()

    def step(self, senses: Senses) -> Command:
        """What to do for the next period; at rest once there is an outcome."""
        if self.outcome is not None:
            return REST
        self._time_s += self._period_s
        self._now = senses
        self.source.move(senses.ticks)
        if self.source.wants_image():
            self._look()
        try:
            command = next(self._steps)
        except StopIteration as end:
            self.outcome = end.value
            return REST
        if self._time_s > self._limit_s:
            self.outcome = Outcome(False, f"not reached in {self._limit_s:.0f} s")
        return Command(command.speed_mps, self.source.hand * command.turn_rps)

    def _look(self) -> None:
        self.source.see(self._now.look())

    def _drive(self) -> Generator[Command, None, Outcome]:
        """All that is done for a goal."""
        for _ in range(MAX_PLANS):
            yield from self._keep(REST, REST_S)
            self._look()
            if not self.source.is_sure():
                yield from self._find_itself()
            if not self.source.is_sure():
                return Outcome(False, f"unsure where it is after {LOOKS} looks at {PLACES} places")
            if self._is_within(ARRIVAL_M):
                if self.source.is_sure(ARRIVAL_IMAGES):
                    return Outcome(True, "")
                yield from self._turn()
                continue
            route = self._clear.plan(self.source.pose()[:2], self._goal)
            if route is None:
                return Outcome(False, "no way over floor that it has driven")
            self.route, needed_s = route, float(measure_along(route)[-1]) / CRUISE_MPS
            self._limit_s = max(self._limit_s, self._time_s + PATIENCE_S + PATIENCE_FACTOR * needed_s)
            yield from self._follow(route)
        return Outcome(False, f"not reached, or not sure of it, with {MAX_PLANS} plans")

    def _is_within(self, distance_m: float) -> bool:
        """Whether it is so near to its goal."""
        return bool(np.linalg.norm(self.source.pose()[:2] - self._goal) < distance_m)

    def _follow(self, route: np.ndarray) -> Steps:
        """Follow a route until the robot is there, blocked or unsure."""
        follower = Follower(route, self._clear.measure_edge(route))
        while self._now.bumped or (self.source.is_sure() and not self._is_within(STOP_AT_M)):
            pose, clear_m = self.source.pose(), self._now.clear_m
            aside = self.source.hand * follower.aim(pose)
            free_m = min(clear_m(0.0), clear_m(aside)) - STOP_M
            command = follower.step(pose, free_m, self._period_s)
            if self._now.bumped or (free_m <= 0.01 and abs(aside) < AIM_RAD):
                again = any(np.linalg.norm(place - pose[:2]) < AGAIN_M for place in self._blocked)
                for angle in FAN_RAD if again else FAN_RAD[: int(self._now.bumped)]:
                    ahead_m = 0.0 if self._now.bumped and not angle else clear_m(angle)
                    if ahead_m < FAN_M:  # something stands before the robot's rim
                        heading = pose[2] + self.source.hand * angle
                        there = (self._radius_m + ahead_m) * np.array([np.cos(heading), np.sin(heading)])
                        self._clear = self._clear.block(pose[:2] + there, BLOCK_M)
                self._blocked.append(pose[:2])
                return (yield from self._keep(Command(-SLOW_MPS, 0.0), ROLL_BACK_M / SLOW_MPS))
            yield command

    def _find_itself(self) -> Steps:
        """Turn for one look after another until the robot is sure where it is; then do so a little way off."""
        for _ in range(PLACES):
            for _ in range(LOOKS):
                yield from self._turn()
                yield from self._keep(REST, REST_S)
                self._look()
                if self.source.is_sure():
                    return
            yield from self._go_away()

    def _go_away(self) -> Steps:
        """Drive straight ahead, where that is clear."""
        for _ in range(LOOKS):
            if self._now.clear_m(0.0) < AWAY_M + STOP_M:
                yield from self._turn()
        for command in self._keep(Command(SLOW_MPS, 0.0), AWAY_M / SLOW_MPS):
            if self._now.clear_m(0.0) < STOP_M or self._now.bumped or self.source.is_sure():
                return
            yield command

    def _turn(self) -> Steps:
        return self._keep(Command(0.0, MAX_TURN_RPS), LOOK_RAD / MAX_TURN_RPS)

    def _keep(self, command: Command, time_s: float) -> Steps:
        for _ in range(round(time_s / self._period_s)):
            yield command
