"""The drive of a log: everything by one clock, and what the robot did by its wheels."""

from dataclasses import dataclass

import numpy as np

from deepgps.robot_io.logs.clocks import Clocked, choose_times
from deepgps.robot_io.logs.containers import Log
from deepgps.robot_io.logs.messages import POSE_KINDS, OdometryLog, PoseLog, open_wheels
from deepgps.robot_io.logs.pictures import list_images
from deepgps.robot_io.logs.robot_config import RobotConfig
from deepgps.robot_io.logs.sample import Heard
from deepgps.robot_io.logs.segmentation import Driven, follow
from deepgps.robot_io.logs.wheels import clean_wheels, fill_counts, interpolate
from deepgps.terminal.progress import Report
from sim.errors import InputError
from sim.geometry import wrap

POSE_GAP_S = 0.5  # Longest time between two poses across which they are interpolated [s]


@dataclass(frozen=True)
class LoggedDrive:
    """A log's drive, by its wheels and the times of its images."""

    driven: Driven  # What the robot did
    clocks: Clocked  # Times of all topics by one clock
    listed: Heard  # Its images, as they are stamped
    image_s: np.ndarray  # Time of each image (m,) [s] by the same clock; NaN where it is not known
    pose: np.ndarray | None  # Poses at the images (m, 3), NaN where there is none; None: they are not known
    notes: tuple[str, ...]  # What the user should know
    from_odometry: bool  # Whether the wheels are computed from an odometry


def read_drive(log: Log, config: RobotConfig, progress: Report) -> LoggedDrive:
    """Read wheels, times of images and poses, bring them to one clock, and find what the robot did; raises InputError
    like ``import_log``."""
    wheel_log, listed, pose_log = open_wheels(log, config.wheels), list_images(log, config.camera.topic), None
    if config.pose:
        log.check_topic(config.pose.topic, "pose.topic", POSE_KINDS)
        if config.pose.topic == wheel_log.topic:
            raise InputError(f"pose.topic {config.pose.topic}: is the topic of the wheels")
        pose_log = PoseLog(config.pose.topic)
    heard = [one for one in (wheel_log, listed, pose_log) if one is not None]
    log.feed(heard, progress)
    for one in heard:
        one.check()
    clocks = choose_times({one.topic: (one.log_ns, one.stamp_ns) for one in heard}, config.clocks == "logged")
    from_odometry = isinstance(wheel_log, OdometryLog)
    notes, image_s, pose = [*clocks.notes], clocks.time_s[listed.topic], None
    topic, time_s, ticks = wheel_log.topic, clocks.time_s[wheel_log.topic], config.wheels.ticks_per_rev
    wheels = fill_counts(clean_wheels(time_s, wheel_log.angle, ticks, topic, image_s, from_odometry), topic)
    driven = follow(wheels, config.wheels.radius_m, config.wheels.track_m)
    if config.pose and pose_log is not None:
        notes += pose_log.list_notes()
        pose = find_poses(clocks.time_s[pose_log.topic], pose_log.pose, image_s)
        if config.pose.use == "truth" and (lacking := int(np.isnan(pose[:, 0]).sum())):
            notes.append(f"{pose_log.topic}: {lacking} images have no pose within half a second and are left out")
    notes += [*wheel_log.list_notes(), *wheels.notes]
    return LoggedDrive(driven, clocks, listed, image_s, pose, tuple(notes), from_odometry)


def find_poses(time_s: np.ndarray, pose: np.ndarray, at_s: np.ndarray) -> np.ndarray:
    """Poses (m, 3) at some times (m,) [s], interpolated from x, y [m], yaw [rad] (n, 3) at times (n,) [s] that may be
    NaN; NaN where none was measured within half a second."""
    order = np.argsort(time_s, kind="stable")
    order = order[np.isfinite(time_s[order])]
    if len(order) < 2:
        return np.full((len(at_s), 3), np.nan)
    time_s, pose = time_s[order], pose[order]
    pose[:, 2] = np.unwrap(pose[:, 2])
    found = interpolate(at_s, time_s, pose, np.diff(time_s) > POSE_GAP_S)
    found[:, 2] = wrap(found[:, 2])
    return found
