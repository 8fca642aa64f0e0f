"""A simulated robot drives to goals in a run's own room, by positions of its methods, and its drives are scored.

The alignments that lead goals to the world are fitted before the drives; the drives' true poses are read after them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from deepgps.config.methods import folder_of
from deepgps.config.scenario import Scenario
from deepgps.evaluation.stored_alignment import read_alignment
from deepgps.learning.trainer import use_threads
from deepgps.navigation.route import BORDER, MIN_WAY_M, Floor, check_goal, draw_goals, lay_floor, measure_along
from deepgps.navigation.simulate import TRUE_POSE, WHEELS, Log, Trip, drive_trips
from deepgps.positioner.stored_positioner import load_positioner
from deepgps.runs.collect import find_parts
from deepgps.runs.owned_folder import hold
from deepgps.runs.run_folder import RUN, list_trained, open_run
from deepgps.terminal.progress import Report
from sim.alignment import Alignment
from sim.errors import DamagedError, InputError, quote
from sim.files.checksums import read_arrays, read_json, write_json
from sim.geometry import FreeSpace
from sim.processes import usable_cores
from sim.recording.format import Recording, open_recording, open_truth
from sim.recording.manifest import read_settings
from sim.recording.renderers import Part, Renderers
from sim.rng import stream
from sim.settings import DeploymentSettings

FOLDER, METRICS = "navigate", "metrics.json"  # Folder of the drives in a run's folder, and the file of their figures
SLIP_PER_M = 0.02  # Slip of wheels whose run has none, after a metre [m]
CARRY_GOALS, CARRY_TRIES = 10, 200  # Before every such goal the robot is carried to one of so many places of its drive
DIMMED_LIGHT, PUSH_M = 0.7, 0.3  # Light of another day, over that in training; how far small furniture was moved [m]
LATE_GOALS = 20  # Goals after which dead reckoning is lost
SUCCESS_LIMITS_M = (0.1, 0.2)  # Largest final distances of a success [m]
START_S = 20.0  # How long a worker may take to build a room and load a method [s]


class Order(NamedTuple):
    """What drives are made."""

    goals: int  # Number of goals
    methods: Sequence[str] = ()  # Sources of positions; none: the run's first method, dead reckoning and the truth
    changes: bool = False  # Whether the light differs from training and, in a tenth of the drives, the room
    to: tuple[float, float] | None = None  # The only goal [m]; None: goals are drawn
    in_world: bool = True  # Whether that one is in the world's frame, not in that of the run's first method


@dataclass(frozen=True)
class Driven:
    """Drives to goals by each source of positions."""

    folder: Path  # Where their files are
    trips: Mapping[str, Trip]
    logs: Mapping[str, Log]
    figures: Mapping[str, Any]  # Figures of each source, as in ``navigate/metrics.json``


def navigate_run(run: Path, order: Order, progress: Report) -> Driven:
    """Drive to goals by each method; write a log of each method's drives and ``navigate/metrics.json``.

    What was driven before is not driven again, and figures of other methods with the same goals stay. With ``to``, no
    figures are written. Raises InputError if the folder is no run of a simulated robot with a camera, has no such
    method, or the goal is not on driven floor.
    """
    scenario, folder = open_run(run), run / FOLDER / ("to" if order.to else "changed" if order.changes else "")
    with hold(run, RUN, "the run"):
        recording = open_recording(run / "recording")
        if recording.manifest.source != "simulator":
            raise InputError(f"{run} has learned from a robot's log: there is no simulated robot to drive")
        if recording.kind != "polar_image":
            raise InputError(f"{run} has learned from {recording.kind} observations: only a camera shows the way")
        trips = plan_trips(run, scenario, recording, order, folder / "parts")
        logs, space = _drive(trips, folder, progress), open_truth(recording.folder).free_space
        figures = {name: score(logs[name], trip, space) for name, trip in trips.items()}
        if order.to is None:
            one = next(iter(trips.values()))
            head = {"changes": order.changes, "goals": np.round(one.alignment.apply(one.goals), 6).tolist()}
            before = read_json(folder / METRICS) if (folder / METRICS).is_file() else {}
            same = all(before.get(name) == value for name, value in head.items())
            write_json(folder / METRICS, {**head, "methods": {**(before["methods"] if same else {}), **figures}})
    return Driven(folder, trips, logs, figures)


def plan_trips(run: Path, scenario: Scenario, recording: Recording, order: Order, parts: Path) -> dict[str, Trip]:
    """A trip of each source, to the same goals on the floor of the run's first method, from the same places."""
    trained = [name for name in scenario.methods if name in list_trained(run)]
    if not trained:
        raise InputError(f"{run} holds no trained method, so it has no map to drive by")
    names = order.methods or (trained[0], WHEELS, TRUE_POSE)
    if wrong := [name for name in names if name not in (*trained, WHEELS, TRUE_POSE)]:
        raise InputError(f"--methods {quote(wrong[0])}: {run} has {', '.join((*trained, WHEELS, TRUE_POSE))}")
    maps = dict[str, tuple[Floor, Alignment]]()
    for name in {trained[0], *names} - {WHEELS, TRUE_POSE}:
        with use_threads(1):
            places = load_positioner(folder_of(run, name)).locate_training(recording.observation)
        maps[name] = lay_floor(recording, places), read_alignment(folder_of(run, name))
    floor, home = maps[trained[0]]
    settings = read_settings(recording.manifest)
    if order.to is None:
        doors = home.invert().apply(find_parts(settings)[1].reshape(-1, 2))
        goals = home.apply(draw_goals(floor, scenario.seed, order.goals, doors))
    else:
        goals = np.array([order.to]) if order.in_world else home.apply(np.array([order.to]))
        check_goal(floor, home.invert().apply(goals[0]), f"--to {order.to[0]:g} {order.to[1]:g}")
    placed = _place(open_truth(recording.folder).pose, floor, home, goals, scenario.seed)
    encoder = settings.encoder.model_copy(update={"slip_per_m": settings.encoder.slip_per_m or SLIP_PER_M})
    light = {"light": DIMMED_LIGHT} if order.changes else {}
    usual, moved = (
        settings.model_copy(update={"encoder": encoder, "deployment": DeploymentSettings(**light, **change)})
        for change in ({}, {"moved_m": PUSH_M, "person": 1})
    )
    trips = {}
    for name in names:
        own = name if name in trained else trained[0]
        there, world = maps[own]
        at, changed = world.invert().apply(goals), moved if order.changes else None
        trips[name] = Trip(name, folder_of(run, own), there, at, placed, world, usual, changed, scenario.seed, parts)
    return trips


def _place(truth: np.ndarray, floor: Floor, home: Alignment, goals: np.ndarray, seed: int) -> dict[int, np.ndarray]:
    """True poses (3,) at which the robot is put before some of the goals (G, 2): where its drive was far from them.

    The floor is in the frame that an alignment leads to the world.
    """
    placed, rng, back = dict[int, np.ndarray](), stream(seed, "carried"), home.invert()
    for number in range(0, len(goals), CARRY_GOALS):
        tried = truth[rng.integers(len(truth), size=CARRY_TRIES), :2]
        ways = floor.measure_ways(floor.cells(back.apply(goals[number : number + 1]))[0])
        far = ways[tuple(floor.cells(back.apply(tried)).T)]
        place = tried[np.argmax(far >= min(MIN_WAY_M, far.max()))]
        placed[number] = np.array([*place, rng.uniform(-np.pi, np.pi)])
    return placed


def _drive(trips: Mapping[str, Trip], folder: Path, progress: Report) -> dict[str, Log]:
    """Drive what is not driven yet; returns the logs by method."""
    files = [trip.file(number) for trip in trips.values() for number in range(len(trip.goals))]
    paths = {name: folder / f"{name}.npz" for name in trips}
    for trip in trips.values():
        keep_same(trip)
    with Renderers(partial(drive_trips, trips), min(len(trips), usable_cores()), START_S) as workers:
        for name, path in paths.items():
            workers.give(Part(trips[name].settings, np.empty((0, 0)), path))
        workers.finish(lambda _: progress("navigate", sum(file.is_file() for file in files), len(files)))
    return {name: read_arrays(path) for name, path in paths.items()}


def keep_same(trip: Trip) -> None:
    """Remove the files of goals that belong to other drives, or are damaged."""
    trip.parts.mkdir(parents=True, exist_ok=True)
    for number in range(len(trip.goals)):
        try:
            same = read_arrays(trip.file(number))["key"] == trip.key(number)
        except DamagedError:
            same = False
        if not same:
            trip.file(number).unlink(missing_ok=True)


def score(log: Log, trip: Trip, space: FreeSpace) -> dict[str, float]:
    """Figures of drives to G goals, by the true poses in their log and the true places of the goals.

    Goals that moved furniture covers are left out.
    """
    floor = Floor(space.origin - BORDER * space.cell_m, space.cell_m, np.pad(space.reachable, BORDER))
    numbers = np.flatnonzero(~log["covered"])
    places, rows = trip.alignment.apply(trip.goals[numbers]), [log["row_goal"] == number for number in numbers]
    drives = [log["true"][row, :2] for row in rows]
    final_m = np.linalg.norm([drive[-1] for drive in drives] - places, axis=1)
    ways_m = np.array([measure_way(floor, drive[0], place) for drive, place in zip(drives, places, strict=True)])
    driven_m = np.array([measure_along(drive)[-1] for drive in drives])
    arrived, contacts = log["arrived"][numbers], log["contacts"][numbers]
    near, useful = (arrived & (final_m < limit_m) for limit_m in SUCCESS_LIMITS_M)
    figures = {
        "success_0_1m": near.mean(),  # Share of goals at which the robot said that it had arrived, and was so near
        "success_0_2m": useful.mean(),  # The same within 0.2 m
        # Success at 0.2 m, weighted by the shortest way over the driven one (Anderson et al., arXiv:1807.06757)
        "spl": (useful * ways_m / np.maximum(ways_m, driven_m)).mean(),
        "collisions_per_run": contacts.mean(),  # Contacts on the way to a goal
        "runs_without_collision": (contacts == 0).mean(),  # Share of goals without a contact
        "final_distance_median_m": np.median(final_m),  # From the goal, of all drives [m]
        "final_distance_p95_m": np.percentile(final_m, 95.0),  # From the goal, of all drives [m]
        "refused": (~arrived).mean(),  # Share of goals that the robot refused
        "time_s": np.mean([log["time_s"][row][-1] for row in rows]),  # To the end of a drive [s]
        "driven_m": driven_m.mean(),  # Way driven to a goal [m]
        "covered": log["covered"].sum(),  # Goals that moved furniture covers
    }
    for name, some, success in (
        ("carried_success_0_2m", np.isin(numbers, list(trip.placed)) & (numbers > 0), useful),
        ("changed_success_0_2m", trip.changed[numbers], useful),  # with furniture moved and a person
        ("late_success_0_1m", numbers >= LATE_GOALS, near),
    ):
        figures |= {name: success[some].mean()} if some.any() else {}
    return {name: float(value) for name, value in figures.items()}


def measure_way(floor: Floor, start: np.ndarray, goal: np.ndarray) -> float:
    """Shortest way [m] between two places (2,) over a floor; at least the straight line."""
    first, last = floor.find(start), floor.find(goal)
    way_m = 0.0 if first is None or last is None else floor.measure_ways(first)[tuple(last)]
    return max(float(way_m), float(np.linalg.norm(goal - start)))
