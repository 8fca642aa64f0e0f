"""Drives of a simulated robot to one goal after another, each with a file from which the next continues.

The truth in these files is the simulator's; only evaluation reads it, when the drives are over.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from deepgps.learning.trainer import use_threads
from deepgps.navigation.navigator import REACH_M, Navigator, Senses
from deepgps.navigation.position import Reckoned, Source, Tracked
from deepgps.navigation.route import Floor
from deepgps.positioner.stored_positioner import INDEX, load_positioner
from sim.alignment import Alignment
from sim.files.checksums import read_arrays, sha256, write_arrays
from sim.recording.renderers import Part
from sim.rng import stream
from sim.settings import SimSettings

WHEELS, TRUE_POSE = "dead_reckoning", "truth"  # Sources of positions that are no trained methods
LOG_STEPS = 5  # Control periods between two rows of a drive's log
CONTACT_STEPS = 25  # Control periods after a contact in which another one is the same
IMAGE_GOALS = 5  # Goals whose images are kept for people
CHANGED_GOALS, CHANGED_PHASE = 10, 5  # Every such goal, from one on, is in a changed room, if there is one
ROWS = {"row": ("time_s", "true", "estimated", "covariance"), "image": ("image_time_s", "image"), "route": ("route",)}
"""Arrays of a log by part: the number of each row's goal is in ``<part>_goal``."""
Log = dict[str, Any]  # Arrays by name
Robot = Any  # A ``sim.live_robot.LiveRobot``; importing that here would load the physics


@dataclass(frozen=True)
class Trip:
    """Goals of one source of positions."""

    name: str  # A trained method, ``WHEELS`` or ``TRUE_POSE``
    folder: Path  # Folder of the method, or of that on whose floor the others drive
    floor: Floor  # The floor in the method's frame
    goals: np.ndarray  # Goals (G, 2) in the method's frame [m]
    placed: Mapping[int, np.ndarray]  # True poses (3,) at which the robot is put before goals: the first and others
    alignment: Alignment  # From the method's frame to the world's; only for the known start, and the true pose
    settings: SimSettings  # The room and the robot
    moved: SimSettings | None  # Those of the changed room; None: it never changes
    seed: int  # Seed of all that is random in the drives
    parts: Path  # Folder of the files of the goals

    @property
    def changed(self) -> np.ndarray:
        """Whether each goal is in the changed room (G,) bool."""
        return (np.arange(len(self.goals)) % CHANGED_GOALS == CHANGED_PHASE) & (self.moved is not None)

    def file(self, number: int) -> Path:
        """File of a goal."""
        return self.parts / f"{self.name}-{number:04d}.npz"

    def key(self, number: int) -> str:
        """All that decides what is driven up to a goal."""
        settings = [one.model_dump(mode="json") for one in (self.settings, self.moved) if one]
        placed = {before: pose.tolist() for before, pose in self.placed.items() if before <= number}
        trained, goals = sha256(self.folder / INDEX), self.goals[: number + 1].tolist()
        return json.dumps([trained, goals, placed, settings, self.seed])


def drive_trips(trips: Mapping[str, Trip], part: Part, beat: Callable[[], None]) -> None:
    """Run in a worker: drive to all goals of the trip that a part's file names, and join their files in that one."""
    from sim.live_robot import LiveRobot

    trip = trips[part.path.stem]
    with use_threads(1):
        write_arrays(part.path, drive_trip(trip, LiveRobot, beat))


def drive_trip(trip: Trip, make_robot: Callable[[SimSettings], Robot], beat: Callable[[], None]) -> Log:
    """Drive to all goals of a trip that have no file yet; returns all logs, with how each drive ended."""
    left = [number for number in range(len(trip.goals)) if not trip.file(number).is_file()]
    robots, logs = [make_robot(one) for one in (trip.settings, trip.moved) if one and left], list[Log]()
    for number in range(len(trip.goals)):
        if number in left:
            log = _drive_next(trip, number, robots, logs[-1] if logs else None, beat)
            write_arrays(trip.file(number), {**log, "key": np.array(trip.key(number))})
        logs.append(read_arrays(trip.file(number)))
    joined: Log = {"goal": trip.goals}
    for part, names in ROWS.items():
        joined[f"{part}_goal"] = np.repeat(np.arange(len(logs)), [len(log[names[0]]) for log in logs])
        kept = [log for log in logs if len(log[names[0]])] or logs[:1]
        joined |= {name: np.concatenate([log[name] for log in kept]) for name in names}
    return joined | {
        name: np.array([log[name] for log in logs]) for name in ("arrived", "reason", "contacts", "covered")
    }


def _drive_next(
    trip: Trip,
    number: int,
    robots: Sequence[Robot],
    before: Log | None,
    beat: Callable[[], None],
) -> Log:
    """Drive to a goal from where, and with what, the one before has ended; returns the log with the state after it."""
    goal, start = trip.goals[number], trip.placed[number] if number in trip.placed or not before else before["true"][-1]
    robot = usual = robots[0]
    if trip.changed[number] and robots[-1].is_free(start[:2]):  # where a piece was moved to, it cannot stand
        robot = robots[-1]
    robot.begin(stream(trip.seed, "navigation", number))
    if before:
        robot.unpack(before)
    if number in trip.placed:
        robot.put(start)
    source = make_source(trip, robot)
    if before:
        source.unpack(before)
    navigator = Navigator(source, trip.floor, robot.body.radius_m, robot.period_s)
    log, place = drive_goal(navigator, robot, goal, beat, number < IMAGE_GOALS), trip.alignment.apply(goal)
    covered = np.array(usual.is_free(place) and not robot.is_free(place))  # by what was moved
    return {**log, **robot.pack(), **source.pack(), "covered": covered}


def make_source(trip: Trip, robot: Robot) -> Source:
    """The source of positions of a trip, for a robot at its start."""
    back, hand = trip.alignment.invert(), int(np.sign(np.linalg.det(trip.alignment.rotation)))

    def find_pose() -> np.ndarray:
        x, y, yaw = robot.pose()
        return np.array([*back.apply(np.array([x, y])), back.turn(yaw)])

    if trip.name == TRUE_POSE:
        return Source(find_pose, hand)
    if trip.name == WHEELS:
        return Reckoned(robot.odometry, find_pose(), hand)
    return Tracked(_load(trip.folder), robot.odometry, trip.name)


_load = lru_cache(maxsize=1)(load_positioner)


def drive_goal(
    navigator: Navigator,
    robot: Robot,
    goal: np.ndarray,
    beat: Callable[[], None] = lambda: None,
    keep_images: bool = False,
) -> Log:
    """Drive to a goal (2,) [m]; returns the log of the drive and how it ended.

    Rows of the log (T): time [s], true and estimated pose (T, 3), and covariance of the position (T, 2, 2) [m^2].
    """
    rows, seen, route = list[tuple[Any, ...]](), list[tuple[float, np.ndarray]](), list[np.ndarray]()
    number, contacts, contact = 0, 0, -CONTACT_STEPS
    source, followed = navigator.source, None

    def look() -> np.ndarray:
        seen.append((number * robot.period_s, robot.image()))
        return seen[-1][1]

    navigator.start(goal)
    while navigator.outcome is None:
        beat()
        if bumped := robot.bumped():
            contacts, contact = contacts + (number - contact >= CONTACT_STEPS), number
        command = navigator.step(Senses(robot.ticks(), partial(robot.clear_m, REACH_M), bumped, look))
        if number % LOG_STEPS == 0 or navigator.outcome is not None:
            rows.append((number * robot.period_s, robot.pose(), source.pose(), source.covariance()))
        if navigator.route is not followed:
            followed = navigator.route
            route.extend(followed)
        robot.drive(*command)
        number += 1
    log: Log = dict(zip(ROWS["row"], map(np.array, zip(*rows, strict=True)), strict=True))
    kept = seen if keep_images else []
    log |= {"image_time_s": [time_s for time_s, _ in kept], "image": np.array([image for _, image in kept], np.uint8)}
    log |= {"route": route, "contacts": contacts, **navigator.outcome._asdict()}
    return {name: np.array(value) for name, value in log.items()}
