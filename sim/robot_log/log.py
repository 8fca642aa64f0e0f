"""The log of a recording's drive: what the robot's computers would have recorded, as an MCAP file.

The drive is repeated, since a recording holds only its samples. Worker processes draw the pictures into parts, which
stay if the work is interrupted. At last all messages are written in the order in which the recorder gets them, beside a
description of the robot.
"""

import logging
import os
import re
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from glob import escape
from pathlib import Path

import numpy as np
import yaml

from sim.errors import DamagedError, InputError
from sim.files.atomic import PART, check_overwrite, check_space, list_files, lock, remove_files
from sim.files.checksums import check_lines, read_json, write_json, write_lines
from sim.recording.assemble import read_if_whole
from sim.recording.format import Report, open_truth
from sim.recording.renderers import Part, Renderers, count_renderers
from sim.rng import stream
from sim.robot.model import TRACK_M, WHEEL_RADIUS_M
from sim.robot_log.content import JOINTS, list_topics
from sim.robot_log.mcap_file import check_file, holds, write_mcap
from sim.robot_log.observe import (
    PART_PICTURES,
    ROWS,
    Observed,
    TracedWorld,
    draw_part,
    join,
    make_base_clock,
    observe,
    trace_drive,
)
from sim.sensors.camera.mount import draw_leans
from sim.sensors.encoder import describe_odometry
from sim.settings import ImageFaultSettings, SimSettings

ROBOT_HEAD = "# The robot of a simulated log, for deepgps import.\n"


def robot_file(log: Path) -> Path:
    """Path of the robot's description beside a log."""
    return log.with_suffix(".robot.yaml")


def _check_robot(path: Path) -> None:
    """Raise InputError if a robot's description is not as deepgps wrote it."""
    check_overwrite(path, lambda data: ROBOT_HEAD.encode() in data)
    try:
        if path.exists():
            check_lines(path)
    except InputError:
        raise InputError(
            f"{path} was edited, or is of another format, and would be overwritten: move it away, or give the "
            "log another name"
        ) from None


def check_log(path: Path, settings: SimSettings) -> None:
    """Raise InputError if a log of these settings, and the robot's description, cannot be written to these files."""
    check_file(path)
    _check_robot(robot_file(path))
    if settings.world != "room" or settings.sensor != "fisheye":
        raise InputError(f"--log {path}: a log needs world room and sensor fisheye, for its pictures")
    if settings.robot.mjcf is not None:
        raise InputError(f"--log {path}: logs are of the testbed's own robot, and robot.mjcf is another")
    faults = {
        "image_faults": settings.image_faults != ImageFaultSettings(),
        "camera_mount.driven_m": settings.camera_mount.driven_m,
        "drive.mixed_light": settings.drive.mixed_light,
    }
    for name in (name for name, on in faults.items() if on):
        raise InputError(f"--log {path}: {name} applies to polar images, and a log holds raw ones; leave it out")


def write_robot(log: Path, settings: SimSettings) -> None:
    """Write the description of the robot beside its log."""
    camera, (left, right) = settings.camera, JOINTS
    odometry = describe_odometry(settings.encoder, WHEEL_RADIUS_M, TRACK_M)
    values = {
        "wheels": {
            "topic": "/joint_states",
            "left": left,
            "right": right,
            "radius_m": odometry["wheel_radius_m"],
            "track_m": odometry["track_m"],
            "ticks_per_rev": odometry["ticks_per_rev"],
            "lag_s": "estimate",  # half of it is the period that messages are late; the rest, how clocks are aligned
        },
        "camera": {
            "topic": "/camera/image_raw/compressed",
            "info": "/camera/camera_info",
            "field_of_view_deg": camera.field_of_view_deg,
            "circle_px": ROWS / 2,
            **{name: getattr(camera, name) for name in ("height_m", "rings", "sectors")},
        },
        "pose": {"topic": "/ground_truth/pose", "use": "truth"},
        "drive": {"spacing_m": settings.drive.spacing_m},
        "clocks": "align",
    }
    write_lines(robot_file(log), ROBOT_HEAD + yaml.safe_dump(values, sort_keys=False))


PARTS = re.compile(r"log\.json|picture-\d+\.npz")  # Names of the files in the folder of an unfinished log
PICTURE_BYTES = 40_000  # About the size of a picture
log = logging.getLogger(__name__)


def write_log(
    path: Path,
    settings: SimSettings,
    seed: int,
    recording: Path,
    key: str,
    progress: Report,
    workers: int | None = None,
) -> None:
    """Write the log of a recording's drive, or complete an unfinished one, and the robot's description beside it.

    Settings and seed are those of the recording, which must have been driven by this simulator; ``key`` names what
    determines the log: one of other settings is replaced when the new one is complete. Without a number of workers, as
    many draw as pay. Raises InputError if the recording holds another drive than these settings give here, WorkError if
    there is no renderer, physics failed, or the disk is full.
    """
    work = path.with_name(f"{path.name}.parts")
    with _hold(work, path):
        if holds(path, key):
            log.warning("%s is complete already", path)
            remove_files(work, PARTS)
            return
        for orphan in path.parent.glob(f"{escape(path.name)}.*{PART}"):  # of a process that was stopped while it wrote
            orphan.unlink()
        _keep_parts(work, key)
        start = time.perf_counter()
        world = TracedWorld(settings)
        build_s = time.perf_counter() - start
        seen = _drive(world, seed, recording, progress)
        pictures = PICTURE_BYTES * len(seen.picture_time)  # each is first in a part and then in the log
        check_space(path, pictures + max(pictures - sum(part.stat().st_size for part in list_files(work, PARTS)), 0))
        parts = list(_lay_out(world.settings, seed, seen.picture_state, work))
        with Renderers(draw_part, workers or count_renderers(len(seen.picture_time)), build_s) as renderers:
            _draw(renderers, parts, progress)
        topics = list_topics(seen, settings, seed, make_base_clock(seed), [part.path for part in parts])
        write_robot(path, settings)
        write_mcap(path, topics, key, lambda *done: progress("log write", *done))
        remove_files(work, PARTS)


@contextmanager
def _hold(work: Path, path: Path) -> Iterator[None]:
    """Lock the folder of an unfinished log against other processes; a dead process holds no lock.

    Raises InputError if another process writes this log, or the folder cannot be made.
    """
    try:
        work.mkdir(parents=True, exist_ok=True)
        folder = os.open(work, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    except OSError as error:
        raise InputError(f"--log {path}: {work} cannot be made: {error.strerror}") from None
    try:
        if not lock(folder, work):
            raise InputError(f"--log {path} is being written by another process")
        yield
    finally:
        os.close(folder)


def _keep_parts(work: Path, key: str) -> None:
    """Keep the parts of an interrupted work on the same log, and say so; remove those of another log."""
    mark, held = work / "log.json", None
    with suppress(DamagedError):
        held = read_json(mark).get("key")
    pictures = any(path.name != mark.name for path in list_files(work, PARTS))
    if held == key and pictures:
        log.warning("%s holds the beginning of this log: it is continued", work)
    elif held != key and pictures:
        log.warning("%s holds the beginning of another log: this one is started again", work)
        remove_files(work, PARTS)
    write_json(mark, {"key": key})


def _drive(world: TracedWorld, seed: int, recording: Path, progress: Report) -> Observed:
    """Repeat the drive of a recording and observe it; raises InputError if the wheels turned otherwise there."""
    base, seen, angle = make_base_clock(seed), list[Observed](), list[np.ndarray]()
    wanted = world.settings.drive.samples + world.settings.grid.held_out
    for stretch in trace_drive(world, seed):
        seen.append(observe(world, stretch, base))
        angle.append(stretch.wheel_angle)
        progress("log drive", min(stretch.observations, wanted), wanted)
    recorded = open_truth(recording).wheel_angle
    if not np.array_equal(np.concatenate(angle)[: len(recorded)], recorded):
        raise InputError(
            f"{recording} holds another drive than its settings give on this machine, with these versions of the "
            "packages; make it again with --fresh, then its log can be made"
        )
    return join(seen)


def _lay_out(settings: SimSettings, seed: int, states: np.ndarray, work: Path) -> Iterator[Part]:
    """Divide the pictures at states (n, nq) into parts."""
    leans = draw_leans(settings.camera_mount, len(states), stream(seed, "log", "lean"))
    for number, first in enumerate(range(0, len(states), PART_PICTURES)):
        rows = slice(first, first + PART_PICTURES)
        path = work / f"picture-{number:06d}.npz"
        yield Part(settings, states[rows], path, None if leans is None else leans[rows])


def _draw(renderers: Renderers, parts: Sequence[Part], progress: Report) -> None:
    missing = [part for part in parts if not read_if_whole(part.path)]
    for part in missing:
        renderers.give(part)

    def tell(drawn: int) -> None:
        progress("log render", (len(parts) - len(missing) + drawn) * PART_PICTURES, len(parts) * PART_PICTURES)

    tell(0)
    renderers.finish(tell)
    tell(len(missing))
