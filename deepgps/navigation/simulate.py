"""Drives of a simulated robot to one goal after another, logged with the truth, which only evaluation reads."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from deepgps.learning.trainer import use_threads
from deepgps.navigation.navigator import REACH_M, Navigator, Senses
from deepgps.navigation.position import Reckoned, Source, Tracked
from deepgps.navigation.route import Floor
from deepgps.positioner.stored_positioner import INDEX, load_positioner
from sim.alignment import Alignment
from sim.files.checksums import sha256, write_arrays
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

    @property
    def changed(self) -> np.ndarray:
        """Whether each goal is in the changed room (G,) bool."""
        return (np.arange(len(self.goals)) % CHANGED_GOALS == CHANGED_PHASE) & (self.moved is not None)

    @property
    def key(self) -> str:
        """All that decides what is driven."""
        settings = [None if one is None else one.model_dump(mode="json") for one in (self.settings, self.moved)]
        placed = {number: pose.tolist() for number, pose in self.placed.items()}
        return json.dumps([sha256(self.folder / INDEX), self.goals.tolist(), placed, settings, self.seed])


def drive_trips(trips: Mapping[str, Trip], part: Part, beat: Callable[[], None]) -> None:
    """Run in a worker: drive to all goals of the trip that a part's file names, and write that file."""
    from sim.live_robot import LiveRobot

    trip = trips[part.path.stem]
    with use_threads(1):
        write_arrays(part.path, {**drive_trip(trip, LiveRobot, beat), "key": np.array(trip.key)})


def drive_trip(trip: Trip, make_robot: Callable[[SimSettings], Robot], beat: Callable[[], None]) -> Log:
    """Drive to all goals of a trip; returns their logs, one after another, with how each drive ended."""
    robot = usual = make_robot(trip.settings)
    other = usual if trip.moved is None else make_robot(trip.moved)
    back, hand = trip.alignment.invert(), int(np.sign(np.linalg.det(trip.alignment.rotation)))
    logs = list[Log]()

    def find_pose() -> np.ndarray:
        x, y, yaw = robot.pose()
        return np.array([*back.apply(np.array([x, y])), back.turn(yaw)])

    robot.put(trip.placed[0])
    if trip.name == TRUE_POSE:
        source = Source(find_pose, hand)
    elif trip.name == WHEELS:
        source = Reckoned(robot.odometry, find_pose(), hand)
    else:
        source = Tracked(load_positioner(trip.folder), robot.odometry, trip.name)
    navigator = Navigator(source, trip.floor, robot.body.radius_m, robot.period_s)
    for number, (goal, changed) in enumerate(zip(trip.goals, trip.changed, strict=True)):
        before, pose = robot, trip.placed.get(number, robot.pose())
        robot = other if changed and other.is_free(pose[:2]) else usual  # where a piece was moved to, it cannot stand
        robot.begin(stream(trip.seed, "navigation", number))
        if robot is not before:
            robot.continue_from(before)
        if number in trip.placed:
            robot.put(pose)
        log, place = drive_goal(navigator, robot, goal, beat, number < IMAGE_GOALS), trip.alignment.apply(goal)
        logs.append({**log, "covered": usual.is_free(place) and not robot.is_free(place)})  # by what was moved
    joined: Log = {"goal": trip.goals}
    for part, names in ROWS.items():
        joined[f"{part}_goal"] = np.repeat(np.arange(len(logs)), [len(log[names[0]]) for log in logs])
        joined |= {name: np.array([row for log in logs for row in log[name]]) for name in names}
    return joined | {
        name: np.array([log[name] for log in logs]) for name in ("arrived", "reason", "contacts", "covered")
    }


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
    log |= {"image_time_s": [time_s for time_s, _ in kept], "image": [image for _, image in kept], "route": route}
    return {**log, "contacts": contacts, **navigator.outcome._asdict()}
