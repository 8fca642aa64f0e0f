"""Collecting: drive the room, render what the camera sees, write the recording.

The drive goes first, in chunks of segments; each chunk is a file that holds where the robot was and all it takes to
drive on. Images, or a lidar's scans, are made from these states by worker processes. So a killed collection continues
where it stopped, and ends with the same bytes under any number of workers.
"""

import json
import shutil
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from importlib.metadata import version
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from sim.assemble import Drive, make_senses, take_held_out, write_drive, write_horizontal, write_images
from sim.camera_faults import spawn_streams
from sim.drive import Course, Segment, next_segment
from sim.encoder import describe_odometry
from sim.errors import InputError, WorkError
from sim.files import write_array, write_arrays
from sim.mount import draw_leans
from sim.processes import end_with_parent, usable_cores
from sim.records import chunk_files, finish_recording, save_free_space, work_folder
from sim.robot import TRACK_M, WHEEL_RADIUS_M
from sim.sensing import sense_states
from sim.settings import SimSettings, UseSettings
from sim.streams import stream
from sim.world import RoomWorld

CHUNK = 256
"""New observations in a chunk, at least; the last one ends with the drive."""
DEATHS = 3
"""How often renderers may crash: Mesa's software renderer was seen to, on a loaded machine."""
PACKAGES = ("mujoco", "numpy", "opencv-python-headless")
Report = Callable[[str, int, int], None]


def collect(settings: SimSettings, seed: int, folder: Path, progress: Report, workers: int | None = None) -> None:
    """Make a recording, or what is missing of it.

    Args:
        settings: World, robot, sensors, drive and test grid.
        seed: Driving and encoder draw from streams of this number.
        folder: The recording's folder; finished once it holds ``manifest.json``.
        progress: Told how many samples are driven and how many images rendered.
        workers: Rendering processes; none: one for each core that may be used.

    Raises:
        InputError: The room cannot be used, or has no test position.
        WorkError: No renderer, or physics failed.
    """
    from sim.mesh import write_scene  # the workers, which import this file too, do without it

    start = time.perf_counter()
    work = work_folder(folder)
    if (folder / "manifest.json").is_file():
        shutil.rmtree(work, ignore_errors=True)  # killed just before it was removed
        return
    work.mkdir(parents=True, exist_ok=True)
    taught = settings.model_copy(update={"use": UseSettings()})  # the room as it is in training
    world = RoomWorld(taught, drawn=False)
    held_out = settings.grid.held_out
    test_pose = np.empty((0, 1, 3)) if held_out else lay_grid(world, settings)
    for deaths in range(DEATHS + 1):
        pool = ProcessPoolExecutor(workers or usable_cores(), get_context("spawn"), end_with_parent)
        try:
            chance = spawn_streams(seed)
            tests, jobs = _render_grid(pool, world, settings, test_pose, work, chance.test_lean)
            streams = stream(seed, "drive"), chance.lean
            drive, drive_jobs = _drive_and_render(pool, world, taught, *streams, work, progress)
            renderer = _watch([*jobs, *drive_jobs], progress)
            break
        except BrokenProcessPool:  # what the dead have drawn and driven stands, and is not done again
            if deaths == DEATHS:
                raise WorkError("a rendering process died; deepgps doctor checks the renderer") from None
        finally:
            pool.shutdown(cancel_futures=True)
    sense, sense_test = make_senses(settings, seed)
    counts = write_drive(folder, settings, drive, stream(seed, "encoder"), sense)
    if held_out:
        test_pose = take_held_out(settings, drive)
        tests = drive.images
    first = settings.drive.samples if held_out else 0
    write_images(folder / "test" / "observation.npy", tests, test_pose.shape[:2], first, sense_test)
    if settings.horizontal.mounted:
        counts |= write_horizontal(folder, settings, drive.images, tests, test_pose.shape[:2])
    write_array(folder / "truth" / "test_pose.npy", test_pose)
    save_free_space(folder / "truth" / "free_space.npz", world.free_space)
    write_scene(RoomWorld(taught).model, folder / "scene.glb")
    manifest = {
        "settings": settings.model_dump(mode="json"),
        "seed": seed,
        **counts,
        "odometry": describe_odometry(settings.encoder, WHEEL_RADIUS_M, TRACK_M),
        "gl_renderer": renderer,
        "renderer_deaths": deaths,
        "packages": {name: version(name) for name in PACKAGES},
        "collect_s": round(time.perf_counter() - start, 2),
    }
    finish_recording(folder, manifest)
    shutil.rmtree(work)


def lay_grid(world: RoomWorld, settings: SimSettings) -> np.ndarray:
    """Poses (C, H, 3) of the test grid: every position within reach that nothing moved has blocked, the headings spread
    evenly from +x; raises InputError where there is none."""
    spacing, headings = settings.grid.spacing_m, settings.grid.headings
    (low_x, low_y), (high_x, high_y) = world.bounds
    x, y = (np.arange(np.ceil(a / spacing), b / spacing) * spacing for a, b in ((low_x, high_x), (low_y, high_y)))
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 1, 2)
    points = points[world.free_space.is_reachable(points[:, 0])]
    if settings.use.moved_m:
        points = points[RoomWorld(settings, drawn=False).is_free(points[:, 0])]
    if not len(points):
        raise InputError(f"grid.spacing_m {spacing} m must be smaller: it leaves no test position within reach")
    yaw = np.broadcast_to(2 * np.pi * np.arange(headings)[:, None] / headings, (len(points), headings, 1))
    return np.concatenate([points.repeat(headings, axis=1), yaw], axis=-1)


def drive_chunk(
    world: RoomWorld, settings: SimSettings, rng: np.random.Generator, before: dict[str, np.ndarray] | None
) -> dict[str, np.ndarray]:
    """Drive the next chunk after the chunk ``before``, which holds all that it depends on."""
    if before is None:
        world.start(rng)
        segments = observations = 0
        course = Course()
    else:
        world.set_state(before["world_state"])
        rng.bit_generator.state = json.loads(str(before["rng_state"]))
        segments, observations = int(before["segments"]), int(before["observations"])
        course = Course(bool(before["continues"]), before["mode"].item(), int(before["side"]))
    first, driven, dropped, carried = observations, list[dict[str, np.ndarray]](), 0, 0
    wanted = settings.drive.samples + settings.grid.held_out
    while observations - first < CHUNK and observations < wanted:
        segment = next_segment(world, settings.drive, rng, course)
        driven.append(_number(segment, segments, observations))
        observations += len(driven[-1]["state"])
        segments, course = segments + 1, segment.course
        dropped += segment.dropped
        carried += segment.carried
    return {
        **{name: np.concatenate([one[name] for one in driven]) for name in driven[0]},
        "dropped": np.array(dropped),
        "carried": np.array(carried),
        "segments": np.array(segments),
        "observations": np.array(observations),
        "continues": np.array(course.continues),
        "mode": np.array(course.mode),
        "side": np.array(course.side),
        "world_state": world.state(),
        "rng_state": np.array(json.dumps(rng.bit_generator.state)),
    }


def _number(segment: Segment, number: int, observations: int) -> dict[str, np.ndarray]:
    """A segment's new states and its readings, numbered over the whole drive."""
    first = observations - 1 if segment.continues else observations
    count = len(segment.time)
    return {
        "state": segment.state[1:] if segment.continues else segment.state,
        "segment": np.full(count, number),
        "observation": np.arange(first, first + count),
        "wheel_angle": segment.wheel_angle,
        "time": segment.time,
    }


def _drive_and_render(
    pool: ProcessPoolExecutor,
    world: RoomWorld,
    settings: SimSettings,
    rng: np.random.Generator,
    lean: np.random.Generator,
    work: Path,
    progress: Report,
) -> tuple[Drive, list[Future]]:
    """Drive until there are enough samples, handing each chunk to the renderers; chunks that stand are read."""
    drive, jobs, chunk = Drive([], []), [], None
    driven, wanted = 0, settings.drive.samples + settings.grid.held_out
    while driven < wanted:
        index = len(drive.chunks)
        path, images = chunk_files(work, index)
        if not path.is_file():
            write_arrays(path, drive_chunk(world, settings, rng, chunk))
        with np.load(path, allow_pickle=False) as stored:
            chunk = dict(stored)
        drive.chunks.append(chunk)
        drive.images.append(images)
        leans = draw_leans(settings.mount, len(chunk["state"]), lean)
        jobs.append(pool.submit(sense_states, settings, chunk["state"], drive.images[-1], leans))
        driven = int(chunk["observations"])
        progress("drive", min(driven, wanted), wanted)
    return drive, jobs


def _render_grid(
    pool: ProcessPoolExecutor,
    world: RoomWorld,
    settings: SimSettings,
    test_pose: np.ndarray,
    work: Path,
    lean: np.random.Generator,
) -> tuple[list[Path], list[Future]]:
    """Hand the test grid to the renderers: the robot settled and at rest at each pose, in the room as it is in use."""
    parts = np.split(test_pose.reshape(-1, 3), range(CHUNK, test_pose.size // 3, CHUNK))
    paths = [work / f"test-{index:06d}.npy" for index in range(len(parts))]
    states = [world.rest_states(part) for part in parts]
    leans = [draw_leans(settings.mount, len(part), lean) for part in parts]
    jobs = zip(states, paths, leans, strict=True)
    return paths, [pool.submit(sense_states, settings, *job) for job in jobs]


def _watch(jobs: Sequence[Future], progress: Report) -> str:
    """Wait for all images; returns the name of the renderer that made them."""
    renderer = ""
    for done, job in enumerate(as_completed(jobs), start=1):
        renderer = job.result() or renderer
        progress("render", done * CHUNK, len(jobs) * CHUNK)
    return renderer
