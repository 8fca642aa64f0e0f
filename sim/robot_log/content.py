"""The topics of a log, from what was observed; names, rates and habits are TurtleBot3's where it has them.

A joint state holds the wheels' angles of the period before its stamp (turtlebot3_node joint_state.cpp).
"""

from collections.abc import Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from sim.rng import stream
from sim.robot.model import WHEEL_RADIUS_M
from sim.robot.range_finder import ANGLE, REACH_M
from sim.robot_log.mcap_file import (
    BASE_FRAME,
    CAMERA_FRAME,
    MAP_FRAME,
    Topic,
    make_camera_info,
    make_compressed_image,
    make_joint_state,
    make_pose,
    make_range,
    make_transforms,
)
from sim.robot_log.observe import COLUMNS, JOINT_S, PART_PICTURES, RECORDER, ROWS, Clock, Observed, read_pictures
from sim.sensors.camera.lens import make_lens
from sim.sensors.encoder import read_encoders
from sim.settings import SimSettings

JOINTS = ("wheel_left_joint", "wheel_right_joint")
JPEG_FORMAT = "rgb8; jpeg compressed bgr8"
RAY_HEIGHT_M = 0.1
"""Height of the rays' frames above the floor; what they measure is the nearest at any height of the robot [m]."""
BASE_LATENCY_S, PICTURE_LATENCY_S, TRUTH_LATENCY_S = (0.002, 0.002), (0.025, 0.005), (0.001, 0.0)
"""How much later than its stamp a message is recorded: at least, and on average in addition [s]. A picture is
compressed first."""


def list_topics(seen: Observed, settings: SimSettings, seed: int, base: Clock, parts: Sequence[Path]) -> list[Topic]:
    """All topics of a log; the seed is for the encoders' faults and for delays, the clock is that of wheels and
    rays."""
    return [
        *_list_camera_topics(seen, settings, seed, parts),
        _list_joints(seen, settings, seed, base),
        *_list_rays(seen, seed, base),
        *_list_truth(seen, seed),
    ]


def _list_camera_topics(seen: Observed, settings: SimSettings, seed: int, parts: Sequence[Path]) -> list[Topic]:
    """Pictures and calibration, and once where the sensors are on the robot."""
    camera, mount, lens = settings.camera, settings.camera_mount, make_lens(settings.camera)
    stamp, logged = RECORDER.read(seen.picture_time), _arrive(seen.picture_time, PICTURE_LATENCY_S, seed, "picture")
    # The camera's axes: to the right in the image is the robot's left, down in the image is its back.
    frames = [(BASE_FRAME, CAMERA_FRAME, (mount.ahead_m, mount.left_m, camera.height_m), np.pi / 2)]
    frames += [(BASE_FRAME, _ray_frame(ray), (0.0, 0.0, RAY_HEIGHT_M), angle) for ray, angle in enumerate(ANGLE)]
    start = RECORDER.read(np.zeros(1))
    read = lru_cache(maxsize=1)(read_pictures)  # rows are asked for in order

    def take_picture(row: int) -> Any:
        return make_compressed_image(stamp[row], read(parts[row // PART_PICTURES])[row % PART_PICTURES], JPEG_FORMAT)

    def describe_camera(row: int) -> Any:
        return make_camera_info(stamp[row], (ROWS, COLUMNS), lens.focal_length(ROWS / 2), lens.k)

    return [
        Topic("/tf_static", start, lambda row: make_transforms(start[row], frames)),
        Topic("/camera/camera_info", logged, describe_camera),
        Topic("/camera/image_raw/compressed", logged, take_picture),
    ]


def _list_joints(seen: Observed, settings: SimSettings, seed: int, base: Clock) -> Topic:
    """Wheel angles by ticks; a reading that never arrives is missing."""
    ticks, arrived = read_encoders(seen.joint_angle, WHEEL_RADIUS_M, settings.encoder, stream(seed, "log", "encoder"))
    angle = ticks * (2 * np.pi / settings.encoder.ticks_per_rev)
    rim_mps = np.diff(angle, axis=0, prepend=angle[:1]) * (WHEEL_RADIUS_M / JOINT_S)
    read = np.flatnonzero(arrived[:-1])
    time = seen.joint_time[read + 1]
    stamp, logged = base.read(time), _arrive(time, BASE_LATENCY_S, seed, "joint")

    def read_joints(row: int) -> Any:
        return make_joint_state(stamp[row], JOINTS, angle[read[row]], rim_mps[read[row]])

    return Topic("/joint_states", logged, read_joints)


def _list_rays(seen: Observed, seed: int, base: Clock) -> list[Topic]:
    stamp, logged = base.read(seen.ray_time), _arrive(seen.ray_time, BASE_LATENCY_S, seed, "ray")

    def measure(ray: int, row: int) -> Any:
        return make_range(stamp[row], _ray_frame(ray), float(seen.ray_m[row, ray]), REACH_M)

    return [Topic(f"/range/{_ray_frame(ray)}", logged, partial(measure, ray)) for ray in range(len(ANGLE))]


def _list_truth(seen: Observed, seed: int) -> list[Topic]:
    """The truth, as a tracking system would record it on the same computer as the pictures."""
    stamp, logged = RECORDER.read(seen.truth_time), _arrive(seen.truth_time, TRUTH_LATENCY_S, seed, "truth")

    def transform(row: int) -> Any:
        x, y, yaw = seen.truth_pose[row]
        return make_transforms(stamp[row], [(MAP_FRAME, BASE_FRAME, (x, y, 0.0), yaw)])

    return [
        Topic("/ground_truth/pose", logged, lambda row: make_pose(stamp[row], seen.truth_pose[row])),
        Topic("/tf", logged, transform),
    ]


def _ray_frame(ray: int) -> str:
    """Name of a ray by its direction [deg]; as a name, with left and right in place of a sign."""
    degrees = round(np.degrees(ANGLE[ray]))
    return f"ray_{'right' if degrees < 0 else 'left'}_{abs(degrees):02d}"


def _arrive(time_s: np.ndarray, latency_s: tuple[float, float], seed: int, name: str) -> np.ndarray:
    """When messages of these times are recorded (n,) [ns], in their order."""
    least_s, more_s = latency_s
    late_s = least_s + more_s * stream(seed, "log", "delay", name).standard_exponential(len(time_s))
    return np.maximum.accumulate(RECORDER.read(time_s + late_s))
