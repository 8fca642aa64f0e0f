"""Drives of a simulated robot to one goal after another, each written as a file from which the next continues.

The truth that these files hold is the simulator's; only evaluation reads it, when the drives are over.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from deepgps.learning.trainer import use_threads
from deepgps.navigation.navigator import REACH_M, Navigator, Senses
from deepgps.navigation.position import Reckoned, Source, Told, Tracked
from deepgps.navigation.route import Floor
from deepgps.positioner.stored_positioner import load_positioner
from sim.alignment import Alignment
from sim.files.checksums import read_arrays, write_arrays
from sim.recording.renderers import Part
from sim.rng import stream
from sim.settings import SimSettings

WHEELS, TRUE_POSE = "dead_reckoning", "truth"  # Sources of positions that are no trained methods
LOG_STEPS = 5  # Control periods between two rows of a drive's log
CONTACT_STEPS = 25  # Control periods after a contact in which another one is the same
IMAGE_GOALS = 5  # Goals whose images are kept for people
Beat = Callable[[], None]  # Signals that the work continues
KINDS = {"time_s": "row", "image_time_s": "image", "route": "route"}
"""Parts of a log, by the first array of each: the number of its goal is in ``<part>_goal``."""


class Robot(Protocol):
    """What a drive needs of a robot; ``pose``, ``place``, ``state`` and ``set_state`` are the simulator's alone."""

    @property
    def period_s(self) -> float: ...
    @property
    def radius_m(self) -> float: ...
    @property
    def odometry(self) -> Mapping[str, float]: ...
    def begin(self, rng: np.random.Generator) -> None: ...
    def step(self, speed_mps: float, turn_rate_rps: float) -> None: ...
    def ticks(self) -> np.ndarray: ...
    def clear_m(self, reach_m: float, turned_rad: float = 0.0) -> float: ...
    def bumped(self) -> bool: ...
    def image(self) -> np.ndarray: ...
    def pose(self) -> np.ndarray: ...
    def is_free(self, place: np.ndarray) -> bool: ...
    def place(self, pose: np.ndarray) -> None: ...
    def state(self) -> dict[str, np.ndarray]: ...
    def set_state(self, state: Mapping[str, np.ndarray]) -> None: ...


@dataclass(frozen=True)
class Trip:
    """Goals of one source of positions."""

    name: str  # A trained method, ``WHEELS`` or ``TRUE_POSE``
    folder: Path  # Folder of the method, or of that on whose floor the others drive
    floor: Floor  # The floor in the method's frame
    goals: np.ndarray  # Goals (G, 2) in the method's frame [m]
    placed: np.ndarray  # True pose (G, 3) at which the robot is put before each goal; NaN: it goes on from where it is
    alignment: Alignment  # From the method's frame to the world's; only for the known start, and the true pose
    settings: SimSettings  # The room and the robot
    changed: Mapping[int, SimSettings]  # Those of goals in a changed room, by their numbers
    seed: int  # Seed of all that is random in the drives
    parts: Path  # Folder of the files of the goals

    def file(self, number: int) -> Path:
        """File of a goal."""
        return self.parts / f"{self.name}-{number:04d}.npz"

    def is_placed(self, number: int) -> bool:
        """Whether the robot is put elsewhere before a goal."""
        return bool(np.isfinite(self.placed[number, 0]))


def drive_trips(trips: Mapping[str, Trip], part: Part, beat: Beat) -> None:
    """Run in a worker: drive to all goals of the trip that a part's file names, from the last finished goal on."""
    from sim.live_robot import LiveRobot

    trip = trips[part.path.stem]
    with use_threads(1):
        drive_trip(trip, LiveRobot, beat)
    write_arrays(part.path, join(trip))


def drive_trip(trip: Trip, make_robot: Callable[[SimSettings], Robot], beat: Beat) -> None:
    """Drive to all goals of a trip; files of goals that exist are read."""
    robots: dict[SimSettings, Robot] = {}
    before: dict[str, np.ndarray] | None = None
    for number in range(len(trip.goals)):
        if trip.file(number).is_file():
            before = read_arrays(trip.file(number))
            continue
        settings = trip.changed.get(number, trip.settings)
        for one in (trip.settings, settings):
            robots[one] = robots[one] if one in robots else make_robot(one)
        robot, usual = robots[settings], robots[trip.settings]
        start = trip.placed[number] if before is None or trip.is_placed(number) else before["true"][-1]
        robot = robot if robot.is_free(start[:2]) else usual  # where a piece was moved to, the robot cannot stand
        navigator = _prepare(trip, number, robot, before)
        before = drive_goal(navigator, robot, trip.goals[number], beat, number < IMAGE_GOALS)
        place = trip.alignment.apply(trip.goals[number])
        before["covered"] = np.array(usual.is_free(place) and not robot.is_free(place))  # by what was moved
        write_arrays(trip.file(number), before)


def _prepare(trip: Trip, number: int, robot: Robot, before: Mapping[str, np.ndarray] | None) -> Navigator:
    """The navigator before a goal, and the robot at its start, as the goal before left both."""
    robot.begin(stream(trip.seed, "navigation", number))
    if before is not None:
        robot.set_state({name.removeprefix("robot/"): part for name, part in before.items() if "robot/" in name})
    if trip.is_placed(number):
        robot.place(trip.placed[number])
    source = make_source(trip, robot)
    if before is not None:
        source.unpack({name.removeprefix("source/"): part for name, part in before.items() if "source/" in name})
    return Navigator(source, trip.floor, robot.radius_m, robot.period_s)


def make_source(trip: Trip, robot: Robot) -> Source:
    """The source of positions of a trip, for a robot at its start."""
    back, hand = trip.alignment.invert(), int(np.sign(np.linalg.det(trip.alignment.rotation)))

    def find() -> np.ndarray:
        x, y, yaw = robot.pose()
        return np.array([*back.apply(np.array([x, y])), back.turn(yaw)])

    if trip.name == TRUE_POSE:
        return Told(find, hand)
    if trip.name == WHEELS:
        return Reckoned(robot.odometry, find(), hand)
    return Tracked(_load(trip.folder), robot.odometry, trip.name)


_load = lru_cache(maxsize=1)(load_positioner)


def drive_goal(
    navigator: Navigator, robot: Robot, goal: np.ndarray, beat: Beat = lambda: None, keep_images: bool = False
) -> dict[str, np.ndarray]:
    """Drive to a goal (2,) [m]; returns the log of the drive, how it ended and the state after it, as arrays by name.

    Rows of the log (T): time [s], true and estimated pose (T, 3), and covariance of the position (T, 2, 2) [m^2].
    """
    rows, seen, routes = list[tuple[Any, ...]](), list[tuple[float, np.ndarray]](), [np.empty((0, 2))]
    number, contacts, contact = 0, 0, -CONTACT_STEPS
    source = navigator.source

    def look() -> np.ndarray:
        image = robot.image()
        if keep_images:
            seen.append((number * robot.period_s, image))
        return image

    navigator.start(goal)
    while navigator.outcome is None:
        beat()
        if bumped := robot.bumped():
            contacts, contact = contacts + (number - contact >= CONTACT_STEPS), number
        command = navigator.step(Senses(robot.ticks(), partial(robot.clear_m, REACH_M), bumped, look))
        if number % LOG_STEPS == 0 or navigator.outcome is not None:
            rows.append((number * robot.period_s, robot.pose(), source.pose(), source.covariance()))
        if navigator.route is not routes[-1]:
            routes.append(navigator.route)
        robot.step(*command)
        number += 1
    time_s, true, estimated, covariance = (np.array(part) for part in zip(*rows, strict=True))
    return {
        "time_s": time_s,
        "true": true,
        "estimated": estimated,
        "covariance": covariance,
        "image_time_s": np.array([time_s for time_s, _ in seen]),
        "image": np.array([image for _, image in seen], np.uint8),
        "route": np.concatenate(routes),
        "arrived": np.array(navigator.outcome.arrived),
        "reason": np.array(navigator.outcome.reason),
        "contacts": np.array(contacts),
        **{f"robot/{name}": part for name, part in robot.state().items()},
        **{f"source/{name}": part for name, part in source.pack().items()},
    }


def join(trip: Trip) -> dict[str, np.ndarray]:
    """The logs of all goals of a trip as arrays by name: rows with the number of their goal, and one row a goal."""
    goals = [read_arrays(trip.file(number)) for number in range(len(trip.goals))]
    joined = {"goal": trip.goals}
    for first, others in (("time_s", ("true", "estimated", "covariance")), ("image_time_s", ("image",)), ("route", ())):
        kept = [(number, one) for number, one in enumerate(goals) if len(one[first])]
        joined[f"{KINDS[first]}_goal"] = np.repeat(
            np.array([number for number, _ in kept], int), [len(one[first]) for _, one in kept]
        )
        for name in (first, *others):
            joined[name] = np.concatenate([one[name] for _, one in kept] or [goals[0][name]])
    return joined | {
        name: np.stack([one[name] for one in goals]) for name in ("arrived", "reason", "contacts", "covered")
    }
