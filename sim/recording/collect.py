"""Collection of a recording: drive the room, render what the camera sees, write the files.

The drive comes first, in chunks of segments; each chunk is a file that holds the robot's states and everything needed
to drive on. Worker processes make images, or a lidar's scans, from these states. So a killed collection continues where
it stopped, and the result has the same bytes for any number of worker processes.
"""

import logging
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from sim.errors import DamagedError, InputError, WorkError
from sim.files.atomic import check_space, list_files, remove_files
from sim.files.checksums import write_array, write_arrays, write_json
from sim.geometry import save_free_space, spread_headings
from sim.processes import uninterrupted
from sim.recording.assemble import (
    CollectedDrive,
    count_drawn,
    cut_short,
    read_if_whole,
    take_held_out,
    write_drive,
    write_observations,
    write_tag_labels,
    write_tests,
)
from sim.recording.chunks import CHUNK, count_wanted, drive_chunk, find_least, part_files, sense_part
from sim.recording.derive import link_training
from sim.recording.format import (
    OWN_PATH,
    PART,
    RECORDING,
    WORK_PATH,
    Judge,
    Report,
    add_checksums,
    chunk_files,
    open_recording,
    work_folder,
)
from sim.recording.manifest import (
    DEPLOYMENT_FOLDER,
    NO_TESTS,
    PACKAGES,
    Manifest,
    choose_deployment,
    light_part,
    name_sensors,
    seed_deployment,
    set_deployment,
)
from sim.recording.renderers import Part, Renderers, count_renderers
from sim.rng import stream
from sim.robot.world import RoomWorld
from sim.rooms.mjcf import list_notes
from sim.sensors.camera.mount import draw_leans
from sim.sensors.catalog import SENSORS, list_kept
from sim.sensors.encoder import describe_odometry
from sim.settings import DeploymentSettings, SimSettings

ROUNDING_TOLERANCE = 1e-6
"""How far outside the free space a position of the test grid may be, as a part of its spacing: sums are rounded."""
TRIES = 3  # Attempts at assembling a recording when a part turns out to be damaged
log = logging.getLogger(__name__)


@dataclass(frozen=True)
class _Job:
    """A recording to make."""

    settings: SimSettings  # World, robot, sensors, drive and test grid
    seed: int  # Seed of its RNG streams
    world: RoomWorld  # The room that is driven; its settings are those of the drive
    test_pose: np.ndarray  # Poses of the test positions (C, H, 3); empty if test samples are held out
    folder: Path  # The recording's folder
    work: Path  # Folder of its parts
    progress: Report
    workers: int | None  # Processes that draw; None: as many as pay
    start: float  # When the work on it, or on its room, began [s]
    build_s: float  # How long its room takes to build [s]
    base: Path | None = None  # A finished recording from which all but the tests is taken; None: the drive is made
    is_enough: Judge | None = None  # Asked where the drive would end before its last sample; None: it ends there

    def estimate_bytes(self) -> int:
        """Bytes that the recording needs at least, in addition to its existing parts."""
        seen = sum(SENSORS[name].size(self.settings) for name in list_kept(self.settings))
        there = sum(path.stat().st_size for path in list_files(self.work, PART))
        states = 0 if self.base else 8 * self.world.model.nq * self.settings.drive.samples
        # Each image is first in a part and then in the recording, and so is the state of each sample.
        parts = self.count_images() * seen + states
        return parts + max(parts - there, 0)

    def count_images(self) -> int:
        """Number of images to draw, apart from those after turns."""
        driven = 0 if self.base else self.settings.drive.samples + self.settings.grid.held_out
        return driven + math.prod(self.test_pose.shape[:2])


def collect(
    settings: SimSettings,
    seed: int,
    folder: Path,
    progress: Report,
    workers: int | None = None,
    base: Path | None = None,
    is_enough: Judge | None = None,
) -> None:
    """Make a recording, or complete an unfinished one without ``manifest.json``; a deployment drive comes first.

    Progress is a stage (``drive`` or ``render``, or these ``in deployment``), the number of images done and the total.
    Without a number of workers, one renders on each usable core, or fewer if there are few images. Of a base, a
    finished recording for which ``has_same_training_drive`` holds, only what differs is made. A drive that would end
    early goes on while ``is_enough``, which always says the same of the same recording, denies that. Raises InputError
    if the room cannot be used or has no test position, WorkError if there is no renderer, physics failed, or the disk
    is full.
    """
    start = time.perf_counter()
    work = work_folder(folder)
    if (folder / "manifest.json").is_file():
        remove_files(work, WORK_PATH)  # a process was killed just before it removed them
        return
    if folder.is_dir():  # its files were left by a killed process, or is about to be rewritten
        remove_files(folder, OWN_PATH if settings.deployment.drive_samples else RECORDING)
    work.mkdir(parents=True, exist_ok=True)
    taught = settings.model_copy(update={"deployment": DeploymentSettings()})  # the room as it is in training
    world = RoomWorld(taught, drawn=False)
    build_s = time.perf_counter() - start
    for note in list_notes(world.model) if settings.room.mjcf is not None else ():
        log.warning("%s", note)
    test_pose = NO_TESTS if settings.grid.held_out else lay_grid(world, settings)
    job = _Job(settings, seed, world, test_pose, folder, work, progress, workers, start, build_s, base, is_enough)
    jobs = [*_plan_deployment(job), job]
    check_space(folder, sum(one.estimate_bytes() for one in jobs))
    for one in jobs:
        _record(one)


def _plan_deployment(job: _Job) -> list[_Job]:
    """The recording of the deployment drive, if there is to be one and it is not finished."""
    folder, work = job.folder / DEPLOYMENT_FOLDER, job.work / DEPLOYMENT_FOLDER
    if not job.settings.deployment.drive_samples:
        return []
    if (folder / "manifest.json").is_file():
        remove_files(work, WORK_PATH)
        return []
    remove_files(folder, OWN_PATH)
    work.mkdir(exist_ok=True)
    settings, start = choose_deployment(job.settings), time.perf_counter()
    world, seed = RoomWorld(settings, drawn=False), seed_deployment(job.seed)

    def report(stage: str, done: int, total: int) -> None:
        job.progress(f"{stage} in deployment", done, total)

    return [_Job(settings, seed, world, NO_TESTS, folder, work, report, job.workers, start, job.build_s)]


def _record(job: _Job) -> None:
    """Make one recording, or complete it."""
    with uninterrupted():  # trimesh takes any exception for a missing package
        from sim.recording.scene_mesh import write_scene  # which worker processes, which import this file, do not need

    if job.base is None:
        save_free_space(job.folder / "truth" / "free_space.npz", job.world.free_space)
        write_scene(RoomWorld(job.world.settings).model, job.folder / "scene.glb")
    manifest = _make(job, too_few=0)
    while not _is_enough(job, manifest):
        manifest = _make(job, too_few=manifest["samples"])
    write_json(job.folder / "manifest.json", manifest)
    remove_files(job.work, WORK_PATH)


def _is_enough(job: _Job, manifest: dict[str, Any]) -> bool:
    if job.is_enough is None or job.base is not None or manifest["samples"] >= job.settings.drive.samples:
        return True
    return job.is_enough(open_recording(job.folder, Manifest.model_validate(manifest)))


def _make(job: _Job, too_few: int) -> dict[str, Any]:
    """Make what lasts of a recording whose drive goes on after so many samples that are ``too_few``; returns its
    manifest, which is still to be written."""
    deaths = 0
    count = job.workers or count_renderers(job.count_images())
    for tries in range(TRIES):
        with Renderers(sense_part, count, job.build_s) as renderers:
            parts = _make_parts(renderers, job, too_few)
        deaths += renderers.deaths
        try:
            counts = _assemble(job, *parts)
            break
        except DamagedError as error:  # the part is removed, and is made again
            if tries == TRIES - 1:
                raise WorkError(f"{error}, {TRIES} times: what is written here does not stay as it is") from None
    manifest = {
        "sensors": name_sensors(job.settings),
        "settings": job.settings.model_dump(mode="json"),
        "seed": job.seed,
        **counts,
        "odometry": describe_odometry(job.settings.encoder, job.world.body.wheel_radius_m, job.world.body.track_m),
        "renderer_deaths": deaths,
        "packages": {name: version(name) for name in PACKAGES},
        "collect_s": round(time.perf_counter() - job.start, 2),
    }
    return add_checksums(job.folder, manifest)


def lay_grid(world: RoomWorld, settings: SimSettings) -> np.ndarray:
    """Poses (C, H, 3) of the test grid: every reachable position that no moved furniture blocks, with evenly spread
    headings from +x; raises InputError if there is none."""
    spacing = settings.grid.spacing_m
    (low_x, low_y), (high_x, high_y) = world.bounds
    x, y = (
        spacing * np.arange(np.ceil(a / spacing - ROUNDING_TOLERANCE), np.floor(b / spacing + ROUNDING_TOLERANCE) + 1)
        for a, b in ((low_x, high_x), (low_y, high_y))
    )
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    points = points[world.free_space.is_reachable(points)]
    if settings.deployment.moved_m:
        points = points[RoomWorld(settings, drawn=False).is_free(points)]
    if not len(points):
        raise InputError(f"grid.spacing_m {spacing} m must be smaller: it leaves no test position within reach")
    return spread_headings(points, settings.grid.headings)


def _make_parts(renderers: Renderers, job: _Job, too_few: int) -> tuple[CollectedDrive, list[Path]]:
    """Drive and draw the missing parts; returns the drive, empty if it is another's, and the files of the tests."""
    given = 0

    def give(part: Part) -> None:
        nonlocal given
        if not _is_drawn(part):
            renderers.give(part)
            given += 1

    tests = _lay_out_tests(job)
    for part in tests:
        give(part)
    drive = CollectedDrive([], [], []) if job.base else _drive(job, give, too_few)
    total = len(tests) + len(drive.images)
    parts = total + len(drive.turns)

    def tell(drawn: int) -> None:
        job.progress("render", round((parts - given + drawn) / parts * total) * CHUNK, total * CHUNK)

    renderers.finish(tell)
    tell(given)
    return drive, [part.path for part in tests]


def _drive(job: _Job, give: Callable[[Part], None], too_few: int) -> CollectedDrive:
    """Drive until there are enough samples and hand each chunk over to be drawn; intact existing chunks are read.

    Where the drive would end with ``too_few``, or was found to when the next chunk was driven, it goes on.
    """
    world, settings, work = job.world, job.world.settings, job.work
    rng, lean, turn_lean = (
        stream(job.seed, *name) for name in (("drive",), ("camera", "lean"), ("camera", "turn_lean"))
    )
    drive, chunk = CollectedDrive([], [], []), None
    driven, wanted, least = 0, 1, 0
    while driven < wanted:
        path, images, turns = chunk_files(work, len(drive.chunks))
        before, chunk = chunk, read_if_whole(path)
        if chunk is None:
            chunk = drive_chunk(world, settings, rng, before, least)
            write_arrays(path, chunk)
        drive.chunks.append(chunk)
        drive.images.append(images)
        leans = draw_leans(settings.camera_mount, len(chunk["state"]), lean)
        lit = light_part(settings, len(drive.chunks) - 1)
        give(Part(lit, chunk["state"], images, leans))
        if settings.drive.turn_images and len(turned := chunk["turn_state"]):
            drive.turns.append(turns)
            give(Part(lit, turned, turns, draw_leans(settings.camera_mount, len(turned), turn_lean)))
        driven, wanted = count_wanted(settings, chunk, least)
        if driven == wanted and (driven <= too_few or chunk_files(work, len(drive.chunks))[0].is_file()):
            least = find_least(driven)
            wanted = count_wanted(settings, chunk, least)[1]
        job.progress("drive", driven, wanted)
    return drive


def _lay_out_tests(job: _Job) -> list[Part]:
    """Divide the test grid into parts: the robot at rest at each pose, in the room as it is in deployment."""
    settings, lean = set_deployment(job.settings), stream(job.seed, "camera", "test_lean")
    poses = job.test_pose.reshape(-1, 3)
    parts = []
    for index, first in enumerate(range(0, len(poses), CHUNK)):
        some = poses[first : first + CHUNK]
        leans = draw_leans(settings.camera_mount, len(some), lean)
        parts.append(Part(settings, job.world.rest_states(some), job.work / f"test-{index:06d}.npz", leans))
    return parts


def _is_drawn(part: Part) -> bool:
    """Whether all files of a part are intact; damaged ones are removed."""
    return all([read_if_whole(path) for path in part_files(part.settings, part.path).values()])


def _assemble(job: _Job, drive: CollectedDrive, tests: list[Path]) -> dict[str, Any]:
    """Write the recording's arrays and return their manifest entries; raises DamagedError for a damaged part."""
    folder, settings, test_pose = job.folder, cut_short(job.settings, drive), job.test_pose
    if job.base is not None:
        counts = link_training(job.base, folder)
    else:
        counts = count_drawn(settings, [*drive.images, *drive.turns, *tests])
        counts |= write_drive(folder, settings, drive, stream(job.seed, "encoder"), job.world.body.wheel_radius_m)
        write_observations(folder, settings, job.seed, drive)
    if settings.grid.held_out:
        test_pose, tests = take_held_out(settings, drive), drive.images
    elif not tests:
        tests = drive.images[:1]  # which tells the shape of an image, since the test arrays are empty
    write_tests(folder, settings, job.seed, tests, test_pose.shape[:2])
    if settings.tag_camera.mounted:
        counts |= write_tag_labels(folder, settings, drive.images, tests, test_pose.shape[:2])
    write_array(folder / "truth" / "test_pose.npy", test_pose)
    return counts
