"""The drive of a log: everything by one clock, and what the robot did by its wheels."""

from dataclasses import dataclass

import numpy as np

from deepgps.robot_io.logs.clocks import Clocked, choose_times
from deepgps.robot_io.logs.messages import OdometryLog, PoseLog, WheelLog
from deepgps.robot_io.logs.robot_config import RobotConfig
from deepgps.robot_io.logs.sample import Heard
from deepgps.robot_io.logs.segmentation import Driven, follow
from deepgps.robot_io.logs.wheels import clean_wheels, fill_counts, interpolate
from sim.geometry import wrap

POSE_GAP_S = 0.5  # Longest time between two poses across which they are interpolated [s]


@dataclass(frozen=True)
class LoggedDrive:
    """A log's drive, by its wheels and the times of its images."""

    driven: Driven  # What the robot did
    clocks: Clocked  # Times of all topics by one clock
    image_s: np.ndarray  # Time of each image (m,) [s]; NaN where it is not known
    pose: np.ndarray | None  # Poses at the images (m, 3), NaN where there is none; None: they are not known
    notes: tuple[str, ...]  # What the user should know
    from_odometry: bool  # Whether the wheels are computed from an odometry


def find_drive(config: RobotConfig, wheel_log: WheelLog, listed: Heard, pose_log: PoseLog | None) -> LoggedDrive:
    """Bring everything to one clock and find what the robot did; raises InputError like ``import_log``."""
    from_odometry = isinstance(wheel_log, OdometryLog)
    heard = [one for one in (wheel_log, listed, pose_log) if one is not None]
    clocks = choose_times({one.topic: (one.log_ns, one.stamp_ns) for one in heard}, config.clocks == "logged")
    notes, image_s, pose = [*clocks.notes], clocks.time_s[listed.topic], None
    wheels = clean_wheels(
        clocks.time_s[wheel_log.topic],
        wheel_log.angle,
        config.wheels.ticks_per_rev,
        wheel_log.topic,
        image_s,
        from_odometry,
    )
    wheels = fill_counts(wheels, wheel_log.topic)
    driven = follow(wheels, config.wheels.radius_m, config.wheels.track_m)
    if config.pose and pose_log is not None:
        notes += pose_log.list_notes()
        pose = find_poses(clocks.time_s[pose_log.topic], pose_log.pose, image_s)
        if config.pose.use == "truth" and (lacking := int(np.isnan(pose[:, 0]).sum())):
            notes.append(f"{pose_log.topic}: {lacking} images have no pose within half a second and are left out")
    notes += [*wheel_log.list_notes(), *wheels.notes]
    ahead_m, back_m = (driven.sum_up(kind)[2] for kind in ("straight", "back"))
    if back_m > ahead_m:  # as it seems if both wheels count backward
        notes.append(
            f"{wheel_log.topic}: the robot drove {back_m:.1f} m backward and {ahead_m:.1f} m forward: do both wheels "
            "count forward?"
        )
    return LoggedDrive(driven, clocks, image_s, pose, tuple(notes), from_odometry)


def find_poses(time_s: np.ndarray, pose: np.ndarray, at_s: np.ndarray) -> np.ndarray:
    """Poses (m, 3) at some times (m,) [s], interpolated; NaN where none was measured within half a second.

    Args:
        time_s: Times of the poses (n,) [s]; NaN where they are not known.
        pose: Poses (n, 3) x, y [m], yaw [rad].
        at_s: The times.
    """
    order = np.argsort(time_s, kind="stable")
    order = order[np.isfinite(time_s[order])]
    if len(order) < 2:
        return np.full((len(at_s), 3), np.nan)
    time_s, pose = time_s[order], pose[order]
    pose[:, 2] = np.unwrap(pose[:, 2])
    found = interpolate(at_s, time_s, pose, np.diff(time_s) > POSE_GAP_S)
    found[:, 2] = wrap(found[:, 2])
    return found
