"""Chunks of a drive: each holds the robot's states and everything needed to drive on.

Worker processes sense the states; each opens its sensors once and keeps them.
"""

import json
import os
import zlib
from collections.abc import Callable
from functools import cache, lru_cache
from pathlib import Path

import mujoco
import numpy as np

from sim.files.checksums import write_arrays
from sim.recording.manifest import LIGHT_STATES
from sim.recording.renderers import Part, UnsteadyError
from sim.recording.turns import KINDS
from sim.robot.drive import DriveMode, Segment, next_segment
from sim.robot.explorer import make_planner
from sim.robot.world import RoomWorld
from sim.sensors.catalog import SENSORS, Opened, list_carried, load
from sim.settings import SimSettings

CHUNK = 256  # Fewest new observations in a chunk, except in the last one of a drive


def drive_chunk(
    world: RoomWorld,
    settings: SimSettings,
    rng: np.random.Generator,
    before: dict[str, np.ndarray] | None,
    least: int = 0,
) -> dict[str, np.ndarray]:
    """Drive the next chunk; the chunk ``before`` holds everything that it depends on but the ``least`` observations."""
    if before is None:
        world.start(rng)
        segments = observations = 0
        mode = DriveMode()
    else:
        world.set_state(before["world_state"])
        rng.bit_generator.state = json.loads(str(before["rng_state"]))
        segments, observations = int(before["segments"]), int(before["observations"])
        mode = DriveMode(bool(before["continues"]), before["mode"].item(), int(before["side"]))
    planner = make_planner(world, settings.drive)
    if before:
        planner.set_state(before)
    first, driven, dropped, relocated = observations, list[dict[str, np.ndarray]](), 0, 0
    while observations - first < CHUNK and not _is_done(settings, observations, planner.unseen, least):
        segment = next_segment(world, settings.drive, rng, mode, planner)
        driven.append(_number(segment, segments, observations))
        observations += len(driven[-1]["state"])
        segments, mode = segments + 1, segment.mode
        dropped += segment.dropped
        relocated += segment.relocated
    return {
        **{name: np.concatenate([one[name] for one in driven]) for name in driven[0]},
        "dropped": np.array(dropped),
        "relocated": np.array(relocated),
        "segments": np.array(segments),
        "observations": np.array(observations),
        "continues": np.array(mode.continues),
        "mode": np.array(mode.kind),
        "side": np.array(mode.side),
        **planner.state(),
        "world_state": world.state(),
        "rng_state": np.array(json.dumps(rng.bit_generator.state)),
    }


def _is_done(settings: SimSettings, observations: int, unseen: np.ndarray, least: int) -> bool:
    """Whether a drive of at least so many observations, unless there are no more, ends after others, with a share of
    the floor ``unseen`` as planners tell it."""
    until = settings.drive.until.unseen
    seen = until is not None and observations >= least and bool(unseen[0] <= until)
    return seen or observations >= settings.drive.samples + settings.grid.held_out


def count_wanted(settings: SimSettings, chunk: dict[str, np.ndarray], least: int = 0) -> tuple[int, int]:
    """Observations driven up to the end of a chunk, at most those that are wanted in all, and these."""
    driven, wanted = int(chunk["observations"]), settings.drive.samples + settings.grid.held_out
    done = _is_done(settings, driven, chunk.get("unseen", np.ones(3)), least)
    return min(driven, wanted), min(driven, wanted) if done else wanted


def find_least(driven: int) -> int:
    """Fewest observations of a drive that goes on, since those ``driven`` were too few: half as many again."""
    return driven + (driven + 1) // 2


def _number(segment: Segment, number: int, observations: int) -> dict[str, np.ndarray]:
    """A segment's new states and its readings, numbered over the complete drive."""
    first = observations - 1 if segment.continues else observations
    count, kind = len(segment.time), "in_place" if segment.continues else "backed_off"
    if segment.relocated:
        kind = "relocated"
    return {
        "state": segment.state[1:] if segment.continues else segment.state,
        "turn_state": segment.state[: segment.continues],
        "turn_kind": np.array([KINDS.index(kind)]),
        "segment": np.full(count, number),
        "observation": np.arange(first, first + count),
        "wheel_angle": segment.wheel_angle,
        "time": segment.time,
    }


IMAGE, RENDERER, REPEATS, DIFFERENCES = "image", "renderer", "drawn_twice", "differed"
"""Names of the arrays in a part's files."""
Beat = Callable[[], None]  # Signals that the work continues


def sense_part(part: Part, beat: Beat) -> None:
    """Run in a worker: write those files of a part that do not exist yet, one for each sensor.

    One image of each camera is drawn again after the others to check that the renderer can be trusted. A file holds the
    observations, if they are kept, and what was found in them; the name of the renderer (``renderer``), how many images
    were drawn twice and how often they differed. Raises UnsteadyError if one differed; its file is not written.
    """
    for name, path in part_files(part.settings, part.path).items():
        if path.is_file():
            continue
        sensor, seen = SENSORS[name], observe(name, part.settings, part.states, part.leans, beat)
        if sensor.renders:
            _draw_again(name, part, path, seen, beat)
        kept = {IMAGE: seen} if sensor.kept(part.settings) else {}
        found = vars(load(sensor.extract)(seen)) if sensor.extract else {}
        renderer = np.array(open_sensors(part.settings)[name].renderer)  # pyright: ignore[reportArgumentType]
        counts = {REPEATS: np.array(sensor.renders + part.differed), DIFFERENCES: np.array(part.differed)}
        write_arrays(path, {**kept, **found, RENDERER: renderer, **counts})


def part_files(settings: SimSettings, path: Path) -> dict[str, Path]:
    """Files of a part by sensor: that of the sensor from which methods learn is ``path``, the others are next to it."""
    first, *others = list_carried(settings)
    return {first: path, **{name: path.with_suffix(f".{name}.npz") for name in others}}


def observe(
    name: str, settings: SimSettings, states: np.ndarray, leans: np.ndarray | None = None, beat: Beat = lambda: None
) -> np.ndarray:
    """Ideal observations (n, ...) of a sensor at states (n, nq), with the fisheye camera leaning by (n, 2) [rad].

    Runs in a worker; ``beat`` is called after each observation.
    """
    sense = open_sensors(settings)[name].sense  # pyright: ignore[reportArgumentType] (frozen settings do hash)
    seen = []
    for number, state in enumerate(states):
        seen.append(sense(state, None if leans is None else leans[number]))
        beat()
    return np.stack(seen)


def _draw_again(name: str, part: Part, path: Path, images: np.ndarray, beat: Beat) -> None:
    """Draw one image of a part again; raises UnsteadyError if it comes out different."""
    count = len(images)
    again = zlib.crc32(path.name.encode()) % max(count - 1, 1)  # not the last one, so that others come between
    rows = slice(again, again + 1)
    leans = None if part.leans is None else part.leans[rows]
    if not np.array_equal(observe(name, part.settings, part.states[rows], leans, beat)[0], images[again]):
        raise UnsteadyError(f"{path}: image {again} of {count} was drawn twice and came out different")


@lru_cache(maxsize=len(LIGHT_STATES))
def open_sensors(settings: SimSettings) -> dict[str, Opened]:
    """The sensors that the robot carries, opened once per worker process, since a context belongs to its process.

    Those of a drive in changing light stay open for each state of the light.
    """
    os.environ.setdefault("LP_NUM_THREADS", "0")  # no extra threads: the worker processes already share the cores

    @cache
    def scene() -> mujoco.MjModel:
        return RoomWorld(settings).model

    return {name: load(SENSORS[name].open or "")(settings, scene) for name in list_carried(settings)}
