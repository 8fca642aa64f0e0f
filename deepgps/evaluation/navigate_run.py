"""A simulated robot drives to goals in a run's own room, by positions of its methods, and its drives are scored.

The alignments that lead goals to the world are fitted before the drives; the drives' true poses are read after them.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from deepgps.config.methods import folder_of
from deepgps.config.scenario import Scenario
from deepgps.evaluation.stored_alignment import read_alignment
from deepgps.learning.trainer import use_threads
from deepgps.navigation.goals import MIN_WAY_M, check_goal, draw_goals
from deepgps.navigation.route import BORDER, Floor, lay_floor
from deepgps.navigation.simulate import TRUE_POSE, WHEELS, Trip, drive_trips
from deepgps.positioner.stored_positioner import INDEX, load_positioner
from deepgps.runs.owned_folder import hold
from deepgps.runs.run_folder import RUN, list_trained, open_run
from deepgps.terminal.progress import Report
from sim.alignment import Alignment
from sim.errors import DamagedError, InputError, quote
from sim.files.checksums import read_arrays, read_json, sha256, write_json
from sim.geometry import FreeSpace
from sim.processes import usable_cores
from sim.recording.format import Recording, open_recording, open_truth
from sim.recording.manifest import read_settings
from sim.recording.renderers import Part, Renderers
from sim.rng import stream
from sim.settings import DeploymentSettings, SimSettings

FOLDER, METRICS = "navigate", "metrics.json"  # Folder of the drives in a run's folder, and the file of their figures
SLIP_PER_M = 0.02  # Slip of wheels whose run has none, after a metre [m]
CARRY_GOALS = 10  # Before every such goal the robot is carried elsewhere
CHANGED_GOALS, CHANGED_PHASE = 10, 5  # Every such goal, from one on, is in a changed room
DIMMED_LIGHT, PUSH_M = 0.7, 0.3  # Light of another day, over that in training; how far small furniture was moved [m]
LATE_GOALS = 20  # Goals after which dead reckoning is lost
SUCCESS_LIMITS_M = (0.1, 0.2)  # Largest final distances of a success [m]
CARRY_TRIES = 200  # Places of the drive among which the one is chosen to which the robot is carried
START_S = 20.0  # How long a worker may take to build a room and load a method [s]


class Order(NamedTuple):
    """What drives are made."""

    goals: int  # Number of goals
    methods: tuple[str, ...] = ()  # Sources of positions; none: the run's first method, dead reckoning and the truth
    changes: bool = False  # Whether the light differs from training and, in a tenth of the drives, the room
    to: tuple[float, float] | None = None  # The only goal [m]; None: goals are drawn
    in_world: bool = True  # Whether that one is in the world's frame, not in the first method's own


@dataclass(frozen=True)
class Driven:
    """Drives to goals by each source of positions."""

    folder: Path  # Where their files are
    trips: Mapping[str, Trip]
    logs: Mapping[str, Mapping[str, np.ndarray]]  # Arrays of the drives' logs
    figures: Mapping[str, Any]  # Figures of each source, as in ``navigate/metrics.json``


def navigate_run(run: Path, order: Order, progress: Report) -> Driven:
    """Drive to goals by each method, and write ``navigate/metrics.json`` and a log of each method's drives.

    What was driven before is not driven again. With ``to``, no figures are written. Raises InputError if the folder is
    no run of a simulated robot with a camera, has no such method, or the goal is not on driven floor.
    """
    scenario, folder = open_run(run), run / FOLDER if order.to is None else run / FOLDER / "to"
    with hold(run, RUN, "the run"):
        recording = _open_simulated(run)
        trips = plan_trips(run, scenario, recording, order, folder / "parts")
        logs = _drive(trips, folder, progress)
        space = open_truth(recording.folder).free_space
        figures = {name: score(logs[name], trip, space) for name, trip in trips.items()}
        if order.to is None:
            head = {"goals": order.goals, "changes": order.changes}
            write_json(folder / METRICS, {**head, "methods": figures})
    return Driven(folder, trips, logs, figures)


def _open_simulated(run: Path) -> Recording:
    recording = open_recording(run / "recording")
    if recording.manifest.source != "simulator":
        raise InputError(f"{run} has learned from a robot's log: there is no simulated robot to drive")
    if recording.kind != "polar_image":
        raise InputError(f"{run} has learned from observations of kind {recording.kind}: only a camera shows the way")
    return recording


def plan_trips(run: Path, scenario: Scenario, recording: Recording, order: Order, parts: Path) -> dict[str, Trip]:
    """A trip of each source, to the same goals, from the same places; its files are in the folder ``parts``."""
    trained = [name for name in scenario.methods if name in list_trained(run)]
    names = order.methods or (*trained[:1], WHEELS, TRUE_POSE)
    if not trained:
        raise InputError(f"{run} holds no trained method, so it has no map to drive by")
    if wrong := [name for name in names if name not in (*trained, WHEELS, TRUE_POSE)]:
        raise InputError(f"--methods {quote(wrong[0])}: {run} has {', '.join((*trained, WHEELS, TRUE_POSE))}")
    main = next((name for name in names if name in trained), trained[0])
    used, floors, alignments = {main, *names} - {WHEELS, TRUE_POSE}, dict[str, Floor](), dict[str, Alignment]()
    for name in used:
        alignments[name] = read_alignment(folder_of(run, name))
        with use_threads(1):
            places = load_positioner(folder_of(run, name)).locate_training(recording.observation)
        floors[name] = lay_floor(recording, places)
    floor, home = floors[main], alignments[main]
    if order.to is None:
        goals = home.apply(draw_goals(floor, scenario.seed, order.goals))
    else:
        goals = np.array([order.to]) if order.in_world else home.apply(np.array([order.to]))
        check_goal(floor, home.invert().apply(goals[0]), f"--to {order.to[0]:g} {order.to[1]:g}")
    placed = _place(recording, floor, home, goals, scenario.seed)
    settings, changed = _choose_settings(read_settings(recording.manifest), order)
    own = {name: name if name in used else main for name in names}
    return {
        name: Trip(
            name=name,
            folder=folder_of(run, own[name]),
            floor=floors[own[name]],
            goals=alignments[own[name]].invert().apply(goals),
            placed=placed,
            alignment=alignments[own[name]],
            settings=settings,
            changed=changed,
            seed=scenario.seed,
            parts=parts,
        )
        for name in names
    }


def _choose_settings(settings: SimSettings, order: Order) -> tuple[SimSettings, dict[int, SimSettings]]:
    """Settings of the drives, whose wheels slip, and those of goals in a changed room, by their numbers."""
    encoder = settings.encoder.model_copy(update={"slip_per_m": settings.encoder.slip_per_m or SLIP_PER_M})
    usual = DeploymentSettings(light=DIMMED_LIGHT) if order.changes else DeploymentSettings()
    moved = usual.model_copy(update={"moved_m": PUSH_M, "person": 1})
    usual, moved = (settings.model_copy(update={"encoder": encoder, "deployment": one}) for one in (usual, moved))
    return usual, dict.fromkeys(range(CHANGED_PHASE, order.goals, CHANGED_GOALS), moved) if order.changes else {}


def _place(recording: Recording, floor: Floor, home: Alignment, goals: np.ndarray, seed: int) -> np.ndarray:
    """True poses (G, 3) at which the robot is put before goals (G, 2): at places of its drive, far enough from them.

    NaN: it goes on from where it is. The floor is in the frame that an alignment leads to the world.
    """
    truth, placed, rng = open_truth(recording.folder).pose, np.full((len(goals), 3), np.nan), stream(seed, "carried")
    own, there = home.invert().apply(truth[:, :2]), home.invert().apply(goals)
    for number in range(0, len(goals), CARRY_GOALS):
        goal, tried = floor.find(there[number]), rng.integers(len(truth), size=CARRY_TRIES)
        cells = [floor.find(own[one]) for one in tried]
        far = np.zeros(floor.free.shape) if goal is None else floor.ways(goal)[0]
        ways = np.array([0.0 if cell is None else far[tuple(cell)] for cell in cells])
        ways[~np.isfinite(ways)] = 0.0
        chosen = tried[np.flatnonzero(ways >= min(MIN_WAY_M, ways.max()))[0]]
        placed[number] = *truth[chosen, :2], rng.uniform(-np.pi, np.pi)
    return placed


def _drive(trips: Mapping[str, Trip], folder: Path, progress: Report) -> dict[str, dict[str, np.ndarray]]:
    """Drive what is not driven yet; returns the logs by method."""
    folder.mkdir(parents=True, exist_ok=True)
    total, settings = sum(len(trip.goals) for trip in trips.values()), next(iter(trips.values())).settings

    def tell(_: int = 0) -> None:
        done = sum(trip.file(number).is_file() for trip in trips.values() for number in range(len(trip.goals)))
        progress("navigate", done, total)

    with Renderers(partial(drive_trips, dict(trips)), min(len(trips), usable_cores()), START_S) as workers:
        for name, trip in trips.items():
            keep_same(trip)
            workers.give(Part(settings, np.empty((0, 0)), folder / f"{name}.npz"))
        workers.finish(tell)
    return {name: read_arrays(folder / f"{name}.npz") for name in trips}


def keep_same(trip: Trip) -> None:
    """Remove the files of goals that belong to other drives, or follow one that does."""
    trip.parts.mkdir(parents=True, exist_ok=True)
    trained = sha256(trip.folder / INDEX)
    for number, goal in enumerate(trip.goals):
        settings = trip.changed.get(number, trip.settings).model_dump(mode="json")
        order = {"method": trained, "goal": goal.tolist(), "settings": settings}
        path = trip.file(number).with_suffix(".json")
        try:
            same = read_json(path) == order
        except DamagedError:
            same = False
        if not same:
            for late in range(number, len(trip.goals)):
                trip.file(late).unlink(missing_ok=True)
            write_json(path, order)


def score(log: Mapping[str, np.ndarray], trip: Trip, space: FreeSpace) -> dict[str, float]:
    """Figures of drives to G goals, by the true poses in their log and the true places of the goals.

    Goals that moved furniture covers are left out.
    """
    floor = Floor(space.origin - BORDER * space.cell_m, space.cell_m, np.pad(space.reachable, BORDER))
    numbers, places = np.flatnonzero(~log["covered"]), trip.alignment.apply(trip.goals)
    rows = [log["row_goal"] == number for number in numbers]
    drives = [log["true"][row, :2] for row in rows]
    final_m = np.array(
        [np.linalg.norm(drive[-1] - places[number]) for number, drive in zip(numbers, drives, strict=True)]
    )
    ways_m = np.array(
        [measure_way(floor, drive[0], places[number]) for number, drive in zip(numbers, drives, strict=True)]
    )
    driven_m = np.array([np.linalg.norm(np.diff(drive, axis=0), axis=1).sum() for drive in drives])
    time_s = np.array([log["time_s"][row][-1] for row in rows])
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
        "time_s": time_s.mean(),  # To the end of a drive [s]
        "driven_m": driven_m.mean(),  # Way driven to a goal [m]
        "covered": log["covered"].sum(),  # Goals that moved furniture covers
    }
    for name, some, success in (
        (
            "carried_success_0_2m",
            np.isfinite(trip.placed[numbers, 0]) & (numbers > 0),
            useful,
        ),  # it starts at the first
        ("changed_success_0_2m", np.isin(numbers, list(trip.changed)), useful),  # with furniture moved and a person
        ("late_success_0_1m", numbers >= LATE_GOALS, near),
    ):
        figures |= {name: success[some].mean()} if some.any() else {}
    return {name: float(value) for name, value in figures.items()}


def measure_way(floor: Floor, start: np.ndarray, goal: np.ndarray) -> float:
    """Shortest way [m] between two places (2,) over a floor; the straight line where it has none."""
    straight_m, cells = float(np.linalg.norm(goal - start)), (floor.find(start), floor.find(goal))
    way_m = np.inf if cells[0] is None or cells[1] is None else float(floor.ways(cells[0])[0][tuple(cells[1])])
    return max(way_m, straight_m) if np.isfinite(way_m) else straight_m
