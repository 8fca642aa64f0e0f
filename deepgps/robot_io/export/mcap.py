"""A run's drives as MCAP files of ROS 2 messages: images, wheels, and the poses of each method with their covariance.

Poses that a method does not accept are on a topic of their own, so that nobody fuses them unawares.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from deepgps.api.run import Run
from deepgps.positioner.confidence import find_normal_radius
from deepgps.positioner.pose import Poses
from deepgps.robot_io.export.trajectories import TRUTH, Trajectory, open_drives
from deepgps.terminal.progress import Report
from sim.recording.format import Recording
from sim.robot_log.mcap_file import Topic, write_mcap
from sim.robot_log.messages import (
    make_compressed_image,
    make_joint_state,
    make_pose,
    make_uncertain_pose,
)

JOINTS = ("wheel_left_joint", "wheel_right_joint")
UNKNOWN_M2, UNKNOWN_RAD2 = 1e6, np.pi**2 / 3
"""Variances of what a method does not know: a position, and a yaw that may be any [m2, rad2]."""
SIGMA_PER_RADIUS = 1.0 / find_normal_radius(0.68)
"""Standard deviation along each axis over the radius of a circle that holds 68 % of a round normal distribution."""


def write_drives(folder: Path, run: Run, trajectories: Sequence[Trajectory], progress: Report) -> None:
    """Write ``mcap/<drive>.mcap`` for the training drive and the drive in use.

    Args:
        folder: Where to.
        run: The run.
        trajectories: Poses along its drives.
        progress: Called with the messages done and their number.
    """
    start_ns = run.recording.manifest.start_ns  # all drives of a log count from its start
    for drive, recording in open_drives(run).items():
        topics = [*list_readings(recording, start_ns), *list_images(recording, start_ns)]
        topics += [topic for one in trajectories if one.drive == drive for topic in list_poses(one, start_ns)]
        write_mcap(folder / "mcap" / f"{drive}.mcap", topics, "export", lambda *done: progress("mcap", *done))


def list_readings(recording: Recording, start_ns: int) -> list[Topic]:
    """The wheels' angles by their ticks; none where the ticks of a revolution are not known."""
    per_rev = recording.manifest.odometry.get("ticks_per_rev")
    if not per_rev or not np.isfinite(recording.time).all():
        return []
    ns, angle = _count_ns(recording.time, start_ns), recording.reading[:, 2:] * (2 * np.pi / per_rev)
    return [Topic("/joint_states", ns, lambda row: make_joint_state(ns[row], JOINTS, angle[row], np.empty(0)))]


def list_images(recording: Recording, start_ns: int) -> list[Topic]:
    """Polar images as PNG; none of other sensors."""
    time_s = recording.observation_time
    if recording.kind != "polar_image" or time_s is None:
        return []
    rows = np.flatnonzero(np.isfinite(time_s))
    ns = _count_ns(time_s[rows], start_ns)

    def take(number: int) -> Any:
        _, file = cv2.imencode(".png", cv2.cvtColor(recording.observation[rows[number]], cv2.COLOR_RGB2BGR))
        return make_compressed_image(ns[number], file, "rgb8; png compressed bgr8", "polar_image")

    return [Topic("/camera/polar/compressed", ns, take)]


def list_poses(one: Trajectory, start_ns: int) -> list[Topic]:
    """The poses of a trajectory: accepted and refused ones, each with its covariance, or the truth without."""
    ns = _count_ns(one.time_s, start_ns)
    yaw = np.zeros(len(ns)) if one.poses.yaw is None else np.nan_to_num(one.poses.yaw)
    pose = np.column_stack([one.poses.position, yaw])
    if one.name == TRUTH:
        return [Topic("/ground_truth/pose", ns, lambda row: make_pose(ns[row], pose[row]))]
    variance = find_variances(one.poses)
    accepted = np.ones(len(ns), bool) if one.poses.accepted is None else one.poses.accepted

    def tell(rows: np.ndarray) -> Callable[[int], Any]:
        def make(number: int) -> Any:
            row = rows[number]
            return make_uncertain_pose(int(ns[row]), pose[row], np.diag(variance[row]))

        return make

    kinds = {"pose": np.flatnonzero(accepted), "refused": np.flatnonzero(~accepted)}
    return [Topic(f"/{one.name}/{kind}", ns[rows], tell(rows)) for kind, rows in kinds.items() if len(rows)]


def find_variances(poses: Poses) -> np.ndarray:
    """Variances of x, y and yaw (n, 3) [m2, m2, rad2], large where they are not known."""
    count = len(poses.position)
    if poses.radius_68 is not None:
        std_m = poses.radius_68 * SIGMA_PER_RADIUS
    else:
        std_m = np.full(count, np.nan) if poses.position_std is None else poses.position_std
    std_rad = np.full(count, np.nan) if poses.yaw_std is None else poses.yaw_std
    place, turn = np.asarray(std_m, float) ** 2, np.asarray(std_rad, float) ** 2
    place, turn = np.where(np.isfinite(place), place, UNKNOWN_M2), np.where(np.isfinite(turn), turn, UNKNOWN_RAD2)
    return np.column_stack([place, place, turn])


def _count_ns(time_s: np.ndarray, start_ns: int) -> np.ndarray:
    return start_ns + np.rint(np.asarray(time_s) * 1e9).astype(np.int64)
