"""A simulated robot drives to goals in a run's own room, by positions of its methods; its drives are scored.

The alignments that lead goals to the world are fitted before the drives. The truth of the drives is read afterwards.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from deepgps.config.methods import folder_of
from deepgps.config.scenario import Scenario
from deepgps.evaluation.stored_alignment import read_alignment
from deepgps.learning.trainer import use_threads
from deepgps.navigation.goals import MIN_WAY_M, check_goal, draw_goals
from deepgps.navigation.route import Floor, lay_floor
from deepgps.navigation.simulate import TRUTH, WHEELS, Trip, drive_trips, take_from_world
from deepgps.positioner.stored_positioner import load_positioner
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

FOLDER = "navigate"  # Folder of the drives in a run's folder
SLIP_PER_M = 0.02  # Slip of the wheels of a run without any, after a metre [m]
CARRY_GOALS, CHANGED_GOALS = 10, 10  # Before every such goal the robot is carried; every such one is in a changed room
CHANGED_PHASE = 5  # Number of the first goal in a changed room
DIMMED_LIGHT, MOVED_M = 0.7, 0.3  # Light of another day, of that in training; how far small furniture was moved [m]
LATE_GOALS = 20  # Goals after so many, at which dead reckoning is lost
NEAR_M, USEFUL_M = 0.1, 0.2  # Final distances of a success [m]
START_S = 20.0  # How long a worker may take to build a room and load a method [s]


@dataclass(frozen=True)
class Driven:
    """Drives to goals, of each source of positions by its name."""

    trips: Mapping[str, Trip]
    logs: Mapping[str, dict[str, np.ndarray]]  # Arrays of the drives' logs
    figures: dict[str, Any]  # Contents of ``navigate/metrics.json``


def navigate_run(
    run: Path,
    goals: int,
    methods: Sequence[str],
    changes: bool,
    progress: Report,
    to: tuple[float, float] | None = None,
    in_world: bool = True,
) -> Driven:
    """Drive to goals by each method, and write ``navigate/metrics.json`` and a log of each method's drives.

    By default the methods are the first of the run, dead reckoning and the true pose. With ``to``, a place in the
    world's frame or the first method's own, that one is the only goal, and no figures are written. Raises InputError if
    the folder is no run of a simulated robot with a camera, has no map, or the goal is not on driven floor.
    """
    scenario = open_run(run)
    with hold(run, RUN, "the run"):
        recording = _open_simulated(run)
        trips = _plan(run, scenario, recording, goals, methods, changes, (to, in_world))
        logs = _drive(trips, run / FOLDER, progress)
        space = open_truth(recording.folder).free_space
        figures = {name: score(logs[name], trip, space) for name, trip in trips.items()}
        if to is None:
            write_json(run / FOLDER / "metrics.json", {"goals": goals, "changes": changes, "methods": figures})
    return Driven(trips, logs, figures)


def _open_simulated(run: Path) -> Recording:
    recording = open_recording(run / "recording")
    if recording.manifest.source != "simulator":
        raise InputError(f"{run} has learned from a robot's log: there is no simulated robot to drive")
    if recording.kind != "polar_image" or recording.manifest.settings.get("world", "room") != "room":
        raise InputError(
            f"{run} has learned from observations of kind {recording.kind}: only a robot with a camera drives"
        )
    return recording


def _plan(
    run: Path,
    scenario: Scenario,
    recording: Recording,
    count: int,
    methods: Sequence[str],
    changes: bool,
    to: tuple[tuple[float, float] | None, bool],
) -> dict[str, Trip]:
    """A trip of each method, to the same goals and from the same places."""
    trained = list_trained(run)
    own = [name for name in scenario.methods if name in trained]
    if not own:
        raise InputError(f"{run} holds no trained method, so it has no map to drive by")
    names = list(methods) or [own[0], WHEELS, TRUTH]
    if unknown := [name for name in names if name not in (*own, WHEELS, TRUTH)]:
        raise InputError(f"--methods {quote(unknown[0])}: {run} has {', '.join((*own, WHEELS, TRUTH))}")
    main = next((name for name in names if name in own), own[0])
    alignments = {name: read_alignment(folder_of(run, name)) for name in {main, *names} - {WHEELS, TRUTH}}
    floors = {name: _lay(recording, folder_of(run, name)) for name in alignments}
    place, floor, home = to[0], floors[main], alignments[main]
    if place is None:
        goals = draw_goals(floor, scenario.seed, count)
    else:
        own_place = np.array(place) if not to[1] else take_from_world(home, np.array([*place, 0.0]))[:2]
        check_goal(floor, own_place, f"--to {place[0]:g} {place[1]:g}")
        goals = own_place[None]
    in_world = home.apply(goals)
    settings = _set_slip(read_settings(recording.manifest))
    placed = _place(recording, floor, home, goals, scenario.seed)
    changed = _list_changed(settings, len(goals)) if changes and place is None else {}
    trips = {}
    for name in names:
        frame = name if name in alignments else main
        there = np.array([take_from_world(alignments[frame], np.array([*one, 0.0]))[:2] for one in in_world])
        parts = run / FOLDER / "parts"
        trips[name] = Trip(
            name, folder_of(run, frame), floors[frame], there, placed, alignments[frame],
            changed.get(-1, settings), changed, scenario.seed, parts,
        )  # fmt: skip
    return trips


def _lay(recording: Recording, folder: Path) -> Floor:
    with use_threads(1):
        return lay_floor(recording, load_positioner(folder).locate_training(recording.observation))


def _set_slip(settings: SimSettings) -> SimSettings:
    """The settings of the drives: the room as in training, and wheels that slip."""
    encoder = settings.encoder
    encoder = encoder.model_copy(update={"slip_per_m": encoder.slip_per_m or SLIP_PER_M})
    return settings.model_copy(update={"encoder": encoder, "deployment": DeploymentSettings()})


def _list_changed(settings: SimSettings, count: int) -> dict[int, SimSettings]:
    """Settings of goals in a changed room by their numbers, and as -1 those of all others, in other light."""
    light = settings.model_copy(update={"deployment": DeploymentSettings(light=DIMMED_LIGHT)})
    moved = DeploymentSettings(light=DIMMED_LIGHT, moved_m=MOVED_M, person=1)
    changed = settings.model_copy(update={"deployment": moved})
    return {-1: light} | dict.fromkeys(range(CHANGED_PHASE, count, CHANGED_GOALS), changed)


def _place(recording: Recording, floor: Floor, home: Alignment, goals: np.ndarray, seed: int) -> np.ndarray:
    """True poses (G, 3) at which the robot is put before goals: at places of the drive, far enough from the goal."""
    pose, placed, rng = open_truth(recording.folder).pose, np.full((len(goals), 3), np.nan), stream(seed, "carried")
    for number in range(0, len(goals), CARRY_GOALS):
        cell = floor.find(goals[number])
        far = floor.ways(cell)[0] if cell is not None else np.zeros(floor.free.shape)
        some = pose[rng.permutation(len(pose))[:200]]
        starts = [floor.find(take_from_world(home, one)[:2]) for one in some]
        ways = np.array([0.0 if start is None else far[tuple(start)] for start in starts])
        ways[~np.isfinite(ways)] = 0.0
        chosen = int(np.flatnonzero(ways >= min(MIN_WAY_M, ways.max()))[0])
        placed[number] = *some[chosen, :2], rng.uniform(-np.pi, np.pi)
    return placed


def _drive(trips: Mapping[str, Trip], folder: Path, progress: Report) -> dict[str, dict[str, np.ndarray]]:
    """Drive what is not driven yet; returns the logs by method."""
    parts = next(iter(trips.values())).parts
    parts.mkdir(parents=True, exist_ok=True)
    _keep_same(trips, parts)
    total, settings = sum(len(trip.goals) for trip in trips.values()), next(iter(trips.values())).settings

    def tell(_: int = 0) -> None:
        done = sum(trip.file(number).is_file() for trip in trips.values() for number in range(len(trip.goals)))
        progress("navigate", done, total)

    tell()
    draw: Callable[..., None] = partial(drive_trips, dict(trips))
    with Renderers(draw, min(len(trips), usable_cores()), START_S) as workers:
        for name in trips:
            (folder / f"{name}.npz").unlink(missing_ok=True)
            workers.give(Part(settings, np.empty((0, 0)), folder / f"{name}.npz"))
        workers.finish(tell)
    return {name: read_arrays(folder / f"{name}.npz") for name in trips}


def _keep_same(trips: Mapping[str, Trip], parts: Path) -> None:
    """Remove files of goals that belong to other drives than these."""
    for name, trip in trips.items():
        trained = sha256(trip.folder / "positioner.json")
        for number, goal in enumerate(trip.goals):
            changed = trip.changed.get(number, trip.settings).model_dump_json()
            now = {"method": trained, "goal": goal.tolist(), "settings": changed}
            path = parts / f"{name}-{number:04d}.json"
            try:
                same = read_json(path) == now
            except DamagedError:
                same = False
            if not same:
                for late in parts.glob(f"{name}-*"):
                    if int(late.stem.rpartition("-")[2]) >= number:
                        late.unlink()
                write_json(path, now)


def score(log: Mapping[str, np.ndarray], trip: Trip, space: FreeSpace) -> dict[str, Any]:
    """Figures of a method's drives to G goals, by the true poses of its log and the goals' true places."""
    rows = [np.flatnonzero(log["row_goal"] == number) for number in range(len(trip.goals))]
    goal, floor = trip.alignment.apply(trip.goals), Floor(space.origin, space.cell_m, space.reachable)
    final_m = np.array(
        [np.linalg.norm(log["true"][row[-1], :2] - place) for row, place in zip(rows, goal, strict=True)]
    )
    driven_m = np.array([np.linalg.norm(np.diff(log["true"][row, :2], axis=0), axis=1).sum() for row in rows])
    ways_m = np.array(
        [_measure_way(floor, log["true"][row[0], :2], place) for row, place in zip(rows, goal, strict=True)]
    )
    arrived, carried = log["arrived"], np.isfinite(trip.placed[:, 0])
    changed = np.isin(np.arange(len(goal)), list(trip.changed))
    near, useful = arrived & (final_m < NEAR_M), arrived & (final_m < USEFUL_M)
    carried[0] = False  # where it starts
    efficiency = np.where(useful, ways_m / np.maximum(np.maximum(ways_m, driven_m), 1e-9), 0.0)
    figures = {
        "success_0_1m": near.mean(),  # Share of goals where the robot said that it arrived, and was so near
        "success_0_2m": useful.mean(),  # The same at 0.2 m
        "spl": efficiency.mean(),  # Success at 0.2 m weighted by shortest way over driven way (Anderson et al., 2018)
        "collisions_per_run": log["contacts"].mean(),  # Contacts on the way to a goal
        "runs_without_collision": (log["contacts"] == 0).mean(),  # Share of goals without a contact
        "final_distance_median_m": np.median(final_m),  # Distance from the goal at the end [m]
        "final_distance_p95_m": np.percentile(final_m, 95.0),  # Distance from the goal at the end [m]
        "refused": (~arrived).mean(),  # Share of goals that the robot refused
        "time_s": np.mean([log["time_s"][row[-1]] for row in rows]),  # Mean time to the end [s]
        "driven_m": driven_m.mean(),  # Mean way driven [m]
    }
    for name, some, success in (
        ("carried_success_0_2m", carried, useful),
        ("changed_success_0_2m", changed, useful),
        ("late_success_0_1m", np.arange(len(goal)) >= LATE_GOALS, near),
    ):
        if some.any():
            figures[name] = success[some].mean()
    return {name: float(value) for name, value in figures.items()}


def _measure_way(floor: Floor, start: np.ndarray, goal: np.ndarray) -> float:
    """Shortest way [m] over true free floor; the straight line where a place is not on it."""
    straight, cells = float(np.linalg.norm(goal - start)), (floor.find(start), floor.find(goal))
    if cells[0] is None or cells[1] is None:
        return straight
    far = float(floor.ways(cells[0])[0][tuple(cells[1])])
    return max(straight, far) if np.isfinite(far) else straight
