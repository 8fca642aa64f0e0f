"""Collection of a recording: drive the room, render what the camera sees, write the files.

The drive comes first, in chunks of segments; each chunk is a file that holds the robot's states and everything needed
to drive on. Worker processes make images, or a lidar's scans, from these states. So a killed collection continues where
it stopped, and the result has the same bytes for any number of worker processes.
"""

import logging
import math
import time
from collections.abc import Callable
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from sim.errors import DamagedError, InputError, WorkError
from sim.files import check_space, list_files, remove_files, write_array, write_arrays
from sim.occupancy import save_free_space
from sim.processes import usable_cores
from sim.recording.assemble import (
    Drive,
    count_drawn,
    read_part,
    take_held_out,
    write_drive,
    write_observations,
    write_tag_labels,
)
from sim.recording.chunks import CHUNK, drive_chunk
from sim.recording.format import COLLECTING, RECORDING, chunk_files, finish_recording, work_folder
from sim.recording.manifest import name_sensors
from sim.recording.renderers import Part, Renderers
from sim.recording.sensing import part_files, sense_part
from sim.rng import stream
from sim.robot.model import TRACK_M, WHEEL_RADIUS_M
from sim.robot.world import RoomWorld
from sim.rooms.mjcf import list_notes
from sim.sensors.camera_faults import spawn_streams
from sim.sensors.camera_mount import draw_leans
from sim.sensors.catalog import SENSORS, list_kept
from sim.sensors.encoder import describe_odometry
from sim.settings import DeploymentSettings, SimSettings

TRIES = 3
"""Attempts at assembling a recording when a part turns out to be damaged."""
PACKAGES = ("mujoco", "numpy", "opencv-python-headless")
log = logging.getLogger(__name__)
Report = Callable[[str, int, int], None]


def collect(settings: SimSettings, seed: int, folder: Path, progress: Report, workers: int | None = None) -> None:
    """Make a recording, or complete an unfinished one.

    Args:
        settings: World, robot, sensors, drive and test grid.
        seed: Seed of the RNG streams for driving and sensors.
        folder: The recording's folder; finished once it holds ``manifest.json``.
        progress: Called with a stage (``drive`` or ``render``), the number of images done and their total.
        workers: Number of rendering processes; None: one for each usable core.

    Raises:
        InputError: The room cannot be used, or has no test position.
        WorkError: There is no renderer, physics failed, or the disk is full.
    """
    from sim.recording.scene_mesh import write_scene  # the worker processes, which import this file too, do not need it

    start = time.perf_counter()
    work = work_folder(folder)
    if (folder / "manifest.json").is_file():
        _remove_parts(work)  # a process was killed just before it removed them
        return
    if folder.is_dir():
        remove_files(folder, RECORDING)  # left by a killed process, or about to be rewritten
    work.mkdir(parents=True, exist_ok=True)
    taught = settings.model_copy(update={"deployment": DeploymentSettings()})  # the room as it is in training
    world = RoomWorld(taught, drawn=False)
    build_s = time.perf_counter() - start
    for note in list_notes(world.model) if settings.room.mjcf is not None else ():
        log.warning("%s", note)
    test_pose = np.empty((0, 1, 3)) if settings.grid.held_out else lay_grid(world, settings)
    check_space(folder, estimate_bytes(settings, world.model.nq, math.prod(test_pose.shape[:2]), work))
    deaths = 0
    for tries in range(TRIES):
        with Renderers(sense_part, workers or usable_cores(), build_s) as renderers:
            parts = _make_parts(renderers, world, settings, test_pose, seed, work, progress)
        deaths += renderers.deaths
        try:
            counts = _assemble(folder, settings, seed, *parts, test_pose)
            break
        except DamagedError as error:  # the part is removed, and is made again
            if tries == TRIES - 1:
                raise WorkError(f"{error}, {TRIES} times: what is written here does not stay as it is") from None
    save_free_space(folder / "truth" / "free_space.npz", world.free_space)
    write_scene(RoomWorld(taught).model, folder / "scene.glb")
    manifest = {
        "sensors": name_sensors(settings),
        "settings": settings.model_dump(mode="json"),
        "seed": seed,
        **counts,
        "odometry": describe_odometry(settings.encoder, WHEEL_RADIUS_M, TRACK_M),
        "renderer_deaths": deaths,
        "packages": {name: version(name) for name in PACKAGES},
        "collect_s": round(time.perf_counter() - start, 2),
    }
    finish_recording(folder, manifest)
    _remove_parts(work)


def estimate_bytes(settings: SimSettings, nq: int, tests: int, work: Path) -> int:
    """Bytes that a recording needs at least, in addition to its existing parts.

    ``tests`` is the number of test images, unless these are held out.
    """
    images = settings.drive.samples + settings.grid.held_out + tests
    seen = sum(SENSORS[name].size(settings) for name in list_kept(settings))
    there = sum(path.stat().st_size for path in list_files(work, COLLECTING))
    # Each image is first in a part and then in the recording, and so is the state of each sample.
    parts = images * seen + 8 * nq * settings.drive.samples
    return parts + max(parts - there, 0)


def lay_grid(world: RoomWorld, settings: SimSettings) -> np.ndarray:
    """Poses (C, H, 3) of the test grid: every reachable position that no moved furniture blocks, with evenly spread
    headings from +x; raises InputError if there is none."""
    spacing, headings = settings.grid.spacing_m, settings.grid.headings
    (low_x, low_y), (high_x, high_y) = world.bounds
    x, y = (np.arange(np.ceil(a / spacing), b / spacing) * spacing for a, b in ((low_x, high_x), (low_y, high_y)))
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 1, 2)
    points = points[world.free_space.is_reachable(points[:, 0])]
    if settings.deployment.moved_m:
        points = points[RoomWorld(settings, drawn=False).is_free(points[:, 0])]
    if not len(points):
        raise InputError(f"grid.spacing_m {spacing} m must be smaller: it leaves no test position within reach")
    yaw = np.broadcast_to(2 * np.pi * np.arange(headings)[:, None] / headings, (len(points), headings, 1))
    return np.concatenate([points.repeat(headings, axis=1), yaw], axis=-1)


def _make_parts(
    renderers: Renderers,
    world: RoomWorld,
    settings: SimSettings,
    test_pose: np.ndarray,
    seed: int,
    work: Path,
    progress: Report,
) -> tuple[Drive, list[Path]]:
    """Drive and draw the missing parts; returns the drive and the files of the test images."""
    chance, given = spawn_streams(seed), 0

    def give(part: Part) -> None:
        nonlocal given
        if not _is_drawn(part):
            renderers.give(part)
            given += 1

    tests = _lay_out_tests(world, settings, test_pose, work, chance.test_lean)
    for part in tests:
        give(part)
    taught = settings.model_copy(update={"deployment": DeploymentSettings()})
    drive = _drive(world, taught, seed, work, give, progress)
    total = len(tests) + len(drive.images)
    parts = total + len(drive.turns)

    def tell(drawn: int) -> None:
        progress("render", round((parts - given + drawn) / parts * total) * CHUNK, total * CHUNK)

    renderers.finish(tell)
    tell(given)
    return drive, [part.path for part in tests]


def _drive(
    world: RoomWorld,
    settings: SimSettings,
    seed: int,
    work: Path,
    give: Callable[[Part], None],
    progress: Report,
) -> Drive:
    """Drive until there are enough samples and hand each chunk over to be drawn; intact existing chunks are read."""
    rng, chance = stream(seed, "drive"), spawn_streams(seed)
    drive, chunk = Drive([], [], []), None
    driven, wanted = 0, settings.drive.samples + settings.grid.held_out
    while driven < wanted:
        path, images, turns = chunk_files(work, len(drive.chunks))
        chunk = _read_if_whole(path) or _drive_on(path, world, settings, rng, chunk)
        drive.chunks.append(chunk)
        drive.images.append(images)
        leans = draw_leans(settings.camera_mount, len(chunk["state"]), chance.lean)
        give(Part(settings, chunk["state"], images, leans))
        if settings.drive.turn_images and len(turned := chunk["turn_state"]):
            drive.turns.append(turns)
            give(Part(settings, turned, turns, draw_leans(settings.camera_mount, len(turned), chance.turn_lean)))
        driven = int(chunk["observations"])
        progress("drive", min(driven, wanted), wanted)
    return drive


def _drive_on(
    path: Path,
    world: RoomWorld,
    settings: SimSettings,
    rng: np.random.Generator,
    before: dict[str, np.ndarray] | None,
) -> dict[str, np.ndarray]:
    """Drive a chunk and write it."""
    chunk = drive_chunk(world, settings, rng, before)
    write_arrays(path, chunk)
    return chunk


def _lay_out_tests(
    world: RoomWorld, settings: SimSettings, test_pose: np.ndarray, work: Path, lean: np.random.Generator
) -> list[Part]:
    """Divide the test grid into parts: the robot at rest at each pose, in the room as it is in deployment."""
    poses = test_pose.reshape(-1, 3)
    parts = []
    for index, first in enumerate(range(0, len(poses), CHUNK)):
        some = poses[first : first + CHUNK]
        leans = draw_leans(settings.camera_mount, len(some), lean)
        parts.append(Part(settings, world.rest_states(some), work / f"test-{index:06d}.npz", leans))
    return parts


def _is_drawn(part: Part) -> bool:
    """Whether all files of a part are intact; damaged ones are removed."""
    return all([_read_if_whole(path) for path in part_files(part.settings, part.path).values()])


def _read_if_whole(path: Path) -> dict[str, np.ndarray] | None:
    """Arrays of a file of the work folder, if it exists; a damaged file is removed."""
    with suppress(DamagedError):
        return read_part(path)
    return None


def _assemble(
    folder: Path, settings: SimSettings, seed: int, drive: Drive, tests: list[Path], test_pose: np.ndarray
) -> dict[str, Any]:
    """Write the recording's arrays and return their manifest entries; raises DamagedError for a damaged part."""
    drawn = count_drawn(settings, [*drive.images, *drive.turns, *tests])
    counts = write_drive(folder, settings, drive, stream(seed, "encoder"))
    if settings.grid.held_out:
        test_pose, tests = take_held_out(settings, drive), drive.images
    write_observations(folder, settings, seed, drive, tests, test_pose.shape[:2])
    if settings.tag_camera.mounted:
        counts |= write_tag_labels(folder, settings, drive.images, tests, test_pose.shape[:2])
    write_array(folder / "truth" / "test_pose.npy", test_pose)
    return counts | drawn


def _remove_parts(work: Path) -> None:
    remove_files(work, COLLECTING)
    with suppress(OSError):  # it holds a file that is not ours
        work.rmdir()
