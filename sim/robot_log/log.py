"""The log of a recording's drive: what the robot's computers would have recorded, as an MCAP file.

The drive is repeated, since a recording holds only its samples, and all messages are written in the order in which the
recorder gets them, beside a description of the robot. Names, rates and habits are TurtleBot3's where it has them: a
joint state holds the wheels' angles of the period before its stamp (turtlebot3_node joint_state.cpp).
"""

import logging
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from sim.errors import InputError
from sim.files.atomic import check_overwrite, check_space, only_process, remove_empty
from sim.files.checksums import check_lines, write_lines
from sim.geometry import planar_pose
from sim.recording.format import Report, open_truth
from sim.rng import stream
from sim.robot.model import TRACK_M, WHEEL_RADIUS_M, WHEELS
from sim.robot_log import mcap_file as mcap
from sim.robot_log.mcap_file import JOINTS, Topic
from sim.robot_log.observe import (
    COLUMNS,
    RECORDER,
    ROWS,
    Clock,
    Trace,
    TracedWorld,
    make_base_clock,
    open_camera,
    trace_drive,
)
from sim.rooms.spec import ROBOT_PREFIX
from sim.sensors.camera.lens import make_lens
from sim.sensors.camera.mount import draw_leans
from sim.sensors.encoder import describe_odometry, read_encoders
from sim.settings import ImageFaultSettings, SimSettings

IMAGE = "/camera/image_raw/compressed"
PICTURE_BYTES = 40_000  # About the size of a picture
log = logging.getLogger(__name__)


def robot_file(log: Path) -> Path:
    """Path of the robot's description beside a log."""
    return log.with_suffix(".robot.yaml")


def check_log(path: Path, settings: SimSettings) -> None:
    """Raise InputError if a log of these settings, and the robot's description, cannot be written to these files."""
    if path.suffix != ".mcap":
        raise InputError(f"{path}: the name of a log must end in .mcap")
    check_overwrite(path, lambda _: mcap.read_key(path) is not None, 0)
    check_overwrite(robot_file(path), lambda _: _is_own(robot_file(path)), 0)
    if settings.world != "room" or settings.sensor != "fisheye":
        raise InputError(f"--log {path}: a log needs world room and sensor fisheye, for its pictures")
    if settings.robot.mjcf is not None:
        raise InputError(f"--log {path}: logs are of the testbed's own robot, and robot.mjcf is another")
    faults = {
        "image_faults": settings.image_faults != ImageFaultSettings(),
        "camera_mount.driven_m": settings.camera_mount.driven_m,
        "drive.mixed_light": settings.drive.mixed_light,
        "drive.person": settings.drive.person,
    }
    for name in (name for name, on in faults.items() if on):
        raise InputError(f"--log {path}: {name} applies to polar images, and a log holds raw ones; leave it out")


def _is_own(file: Path) -> bool:
    """Whether a description of a robot is as deepgps wrote it."""
    with suppress(InputError):
        check_lines(file)
        return True
    return False


def write_robot(log: Path, settings: SimSettings) -> None:
    """Write the description of the robot beside its log."""
    camera, (left, right) = settings.camera, JOINTS
    odometry = describe_odometry(settings.encoder, WHEEL_RADIUS_M, TRACK_M)
    known = camera.model_dump(include={"field_of_view_deg", "height_m", "rings", "sectors"})
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
        "camera": {"topic": IMAGE, "info": "/camera/camera_info", "circle_px": ROWS / 2, **known},
        "pose": {"topic": "/ground_truth/pose", "use": "truth"},
        "drive": {"spacing_m": settings.drive.spacing_m},
        "clocks": "logged",
    }
    write_lines(robot_file(log), yaml.safe_dump(values, sort_keys=False))


def write_log(path: Path, settings: SimSettings, seed: int, recording: Path, key: str, progress: Report) -> None:
    """Write the log of a recording's drive, and the robot's description beside it.

    Settings and seed are those of the recording, which must have been driven by this simulator; ``key`` names what
    determines the log: one of other settings is replaced when the new one is complete. Raises InputError if the
    recording holds another drive than these settings give here, WorkError if there is no renderer, physics failed, or
    the disk is full.
    """
    lock = path.with_name(f"{path.name}.lock")
    with only_process(lock):
        if mcap.read_key(path) == key:
            log.warning("%s is complete already", path)
        else:
            topics = _observe(settings, seed, recording, progress)
            check_space(path, sum(PICTURE_BYTES * len(topic.logged) for topic in topics if topic.name == IMAGE))
            write_robot(path, settings)
            mcap.write_mcap(path, topics, key, lambda *done: progress("log write", *done))
        remove_empty(lock, path.parent)


def _observe(settings: SimSettings, seed: int, recording: Path, progress: Report) -> list[Topic]:
    """Drive again; return the topics."""
    world = TracedWorld(settings)
    truth = open_truth(recording)
    trace, angle = trace_drive(world, seed, len(truth.pose), progress)
    if not np.array_equal(angle[: len(truth.wheel_angle)], truth.wheel_angle):
        raise InputError(
            f"{recording} holds another drive than its settings give on this machine, with these versions of the "
            "packages; make it again with --fresh, then its log can be made"
        )
    wheels = make_wheel_topic(trace, world, seed, make_base_clock(seed))
    return [*list_camera_topics(trace, world.settings, seed), wheels, make_truth_topic(trace, seed)]


JOINT_S, PICTURE_S, TRUTH_S = 0.05, 0.1, 0.05
"""Periods of the wheels (TurtleBot3: 20 Hz), the pictures and the truth [s]."""
JPEG_FORMAT = "rgb8; jpeg compressed bgr8"
BASE_LATENCY_S, PICTURE_LATENCY_S, TRUTH_LATENCY_S = (0.002, 0.002), (0.025, 0.005), (0.001, 0.0)
"""How much later than its stamp a message is recorded: at least, and on average in addition [s]. A picture is
compressed first."""


def list_camera_topics(trace: Trace, settings: SimSettings, seed: int) -> list[Topic]:
    """Pictures, each drawn when it is written, and their calibration."""
    time, state = trace.find(RECORDER, PICTURE_S)
    leans = draw_leans(settings.camera_mount, len(state), stream(seed, "log", "lean"))
    lens, stamp, sense = make_lens(settings.camera), RECORDER.read(time), open_camera(settings)
    logged = _arrive(time, PICTURE_LATENCY_S, seed, "picture")

    def take_picture(row: int) -> Any:
        picture = sense(state[row], None if leans is None else leans[row])
        return mcap.make_compressed_image(stamp[row], picture, JPEG_FORMAT)

    def describe_camera(row: int) -> Any:
        return mcap.make_camera_info(stamp[row], (ROWS, COLUMNS), lens.focal_length(ROWS / 2), lens.k)

    return [Topic("/camera/camera_info", logged, describe_camera), Topic(IMAGE, logged, take_picture)]


def make_wheel_topic(trace: Trace, world: TracedWorld, seed: int, clock: Clock) -> Topic:
    """Wheel angles by ticks, of which a reading that never arrives is missing, by the clock of their computer."""
    (time, state), encoder = trace.find(clock, JOINT_S), world.settings.encoder
    ticks, arrived = read_encoders(
        state[:, find_wheels(world)], WHEEL_RADIUS_M, encoder, stream(seed, "log", "encoder")
    )
    angle = ticks * (2 * np.pi / encoder.ticks_per_rev)
    rim_mps = np.diff(angle, axis=0, prepend=angle[:1]) * (WHEEL_RADIUS_M / JOINT_S)
    read = np.flatnonzero(arrived[:-1])
    time = time[read + 1]
    stamp = clock.read(time)

    def make(row: int) -> Any:
        return mcap.make_joint_state(stamp[row], JOINTS, angle[read[row]], rim_mps[read[row]])

    return Topic("/joint_states", _arrive(time, BASE_LATENCY_S, seed, "joint"), make)


def find_wheels(world: TracedWorld) -> list[int]:
    """Where the left and the right wheel's angle are in the full position."""
    return [world.model.joint(ROBOT_PREFIX + name).qposadr[0] for name in WHEELS]


def make_truth_topic(trace: Trace, seed: int) -> Topic:
    """The truth, as a tracking system would record it on the same computer as the pictures."""
    time, state = trace.find(RECORDER, TRUTH_S)
    pose, stamp = planar_pose(state), RECORDER.read(time)
    logged = _arrive(time, TRUTH_LATENCY_S, seed, "truth")
    return Topic("/ground_truth/pose", logged, lambda row: mcap.make_pose(stamp[row], pose[row]))


def _arrive(time_s: np.ndarray, latency_s: tuple[float, float], seed: int, name: str) -> np.ndarray:
    """When messages of these times are recorded (n,) [ns], in their order."""
    least_s, more_s = latency_s
    late_s = least_s + more_s * stream(seed, "log", "delay", name).standard_exponential(len(time_s))
    return np.maximum.accumulate(RECORDER.read(time_s + late_s))
