"""The drive of a log: everything by one clock, and what the robot did by its wheels."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from deepgps.robot_io.logs.clocks import Clocked, choose_times
from deepgps.robot_io.logs.messages import UNUSABLE_NOTE, PoseLog, WheelLog, find_poses
from deepgps.robot_io.logs.pictures import ImageList
from deepgps.robot_io.logs.robot_config import RobotConfig
from deepgps.robot_io.logs.segmentation import Motion, Path, find_motions, find_path
from deepgps.robot_io.logs.wheels import Wheels, clean_wheels, fill_counts


@dataclass(frozen=True)
class LoggedDrive:
    """A log's drive, by its wheels and the times of its images."""

    wheels: Wheels  # The wheels
    path: Path  # Distance and heading by them
    motions: list[Motion]  # What the robot did
    clocks: Clocked  # Times of all topics by one clock
    image_s: np.ndarray  # Time of each image (m,) [s]; NaN where it is not known
    pose: np.ndarray | None  # Poses at the images (m, 3), NaN where there is none; None: they are not known
    notes: tuple[str, ...]  # What the user should know
    from_odometry: bool  # Whether the wheels are computed from an odometry


def find_drive(config: RobotConfig, wheel_log: WheelLog, listed: ImageList, pose_log: PoseLog | None) -> LoggedDrive:
    """Bring everything to one clock and find what the robot did; raises InputError like ``import_log``."""
    logs: dict[str, Any] = {config.wheels.topic: wheel_log, listed.topic: listed}
    if config.pose and pose_log is not None:
        logs[config.pose.topic] = pose_log
    clocks = choose_times({topic: (one.log_ns, one.stamp_ns) for topic, one in logs.items()}, config.clocks == "logged")
    time_s, notes = clocks.time_s, [*clocks.notes]
    image_s, pose = time_s[listed.topic], None
    wheels = clean_wheels(
        time_s[config.wheels.topic], wheel_log.angle, config.wheels.ticks_per_rev, config.wheels.topic, image_s
    )
    wheels = fill_counts(wheels, config.wheels.topic)
    path = find_path(wheels.angle, config.wheels.radius_m, config.wheels.track_m)
    motions = find_motions(wheels, path, config.wheels.track_m)
    if config.pose and pose_log is not None:
        if pose_log.without:
            notes.append(f"{config.pose.topic}: {pose_log.without} messages are left out: {UNUSABLE_NOTE}")
        pose = find_poses(time_s[config.pose.topic], pose_log.pose, np.nan_to_num(image_s, nan=-np.inf))
        if config.pose.use == "truth" and (lacking := int(np.isnan(pose[:, 0]).sum())):
            notes.append(f"{config.pose.topic}: {lacking} images have no pose within half a second and are left out")
    if wheel_log.without:
        why = f"are left out: {UNUSABLE_NOTE}" if wheel_log.from_odometry else "hold neither wheel"
        notes.append(f"{config.wheels.topic}: {wheel_log.without} messages {why}")
    if wheel_log.from_odometry:
        notes.append(f"{config.wheels.topic}: wheels are computed from the odometry, so they cannot be diagnosed")
    if wheel_log.goes_sideways:
        notes.append(f"{config.wheels.topic}: the odometry goes sideways, as no wheels can: is its orientation right?")
    notes += [*wheels.notes, *_doubt_direction(config.wheels.topic, motions, path)]
    return LoggedDrive(wheels, path, motions, clocks, image_s, pose, tuple(notes), wheel_log.from_odometry)


def _doubt_direction(topic: str, motions: list[Motion], path: Path) -> list[str]:
    """A note if the robot drove backward more than forward, as it seems if both wheels count backward."""
    ahead_m, back_m = (sum(path.measure(one) for one in motions if one.kind == kind) for kind in ("straight", "back"))
    if back_m <= ahead_m:
        return []
    return [
        f"{topic}: the robot drove {back_m:.1f} m backward and {ahead_m:.1f} m forward: do both wheels count forward?"
    ]
