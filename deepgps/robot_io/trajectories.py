"""A run's drives for other tools: the truth and each method's poses, as TUM files, as CSV or as MCAP.

An MCAP file holds ROS 2 messages: images, wheels, and poses with their covariance. Poses that a method does not accept
are on a topic of their own, so that nobody fuses them unawares.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from deepgps.api.run import Frame, Run
from deepgps.evaluation.deployment import adapt, open_deployment
from deepgps.learning.trainer import use_threads
from deepgps.positioner.pose import Poses, find_poses
from deepgps.positioner.registration import find_normal_radius
from deepgps.terminal.progress import Report
from deepgps.tracking.track import write_tum
from sim.errors import InputError
from sim.files.atomic import write_text
from sim.recording.format import Recording, has_truth, open_truth
from sim.robot_log.mcap_file import (
    JOINTS,
    Topic,
    make_compressed_image,
    make_joint_state,
    make_pose,
    make_uncertain_pose,
    write_mcap,
)

TRUTH = "truth"
COLUMNS = {
    "yaw": "yaw_rad",
    "yaw_std": "yaw_std_rad",
    "novelty": "novelty_m",
    "radius_68": "radius_68_m",
    "radius_95": "radius_95_m",
    "accepted": "accepted",
}
"""Columns of the parts of poses, but for the position."""
UNKNOWN_VARIANCE_M2, UNKNOWN_VARIANCE_RAD2 = 1e6, np.pi**2 / 3
"""Variances of what a method does not know: a position, and a yaw that may be any [m2, rad2]."""
SIGMA_PER_RADIUS = 1.0 / find_normal_radius(0.68)
"""Standard deviation along each axis over the radius of a circle that holds 68 % of a round normal distribution."""


@dataclass(frozen=True)
class Trajectory:
    """Poses along a drive."""

    drive: str  # Name of the drive
    name: str  # Name of the method, or ``TRUTH``
    time_s: np.ndarray  # Time of each pose (n,) [s], never falling, from the beginning of the recording
    poses: Poses  # The poses
    start_s: float = 0.0  # When the recording began [s since 1970]; 0 unless it is of a robot's log


def write_trajectories(folder: Path, trajectories: Sequence[Trajectory], formats: Sequence[str]) -> None:
    """Write ``<format>/<drive>/<method>.<format>`` for each trajectory, in those formats that are for one."""
    for one in trajectories:
        if "tum" in formats:
            yaw = np.full(len(one.time_s), np.nan) if one.poses.yaw is None else one.poses.yaw
            path = np.column_stack([one.poses.position, yaw])
            write_tum(folder / "tum" / one.drive / f"{one.name}.tum", one.start_s + one.time_s, path)
        if "csv" in formats:
            write_table(folder / "csv" / one.drive / f"{one.name}.csv", one)


def open_drives(run: Run) -> dict[str, Recording]:
    """The recordings of a run's drives by name."""
    deployment = open_deployment(run.recording)
    return {"training": run.recording} | ({} if deployment is None else {"use": deployment})


def find_trajectories(run: Run, method: str | None, frame: Frame | None, progress: Report) -> list[Trajectory]:
    """The true trajectory and those of a method, or of all, along the training drive and the deployment drive.

    Without a frame, the methods' is the world's where evaluation has placed the map; the truth is in the world's.
    Raises InputError if there is no such method, the recording has no times, or a map has no place in the world.
    """
    methods, drives = run.methods if method is None else (run.choose(method),), open_drives(run)
    start_s = 1e-9 * run.recording.manifest.start_ns  # all drives of a log count from its start
    found = list[Trajectory]()
    for drive, recording in drives.items():
        order, time_s = _put_in_order(recording)
        if has_truth(recording.folder):
            pose = open_truth(recording.folder).pose[order]
            found.append(Trajectory(drive, TRUTH, time_s, Poses(pose[:, :2], yaw=pose[:, 2]), start_s))
        for number, name in enumerate(methods):
            progress(f"trajectories, {drive}", number, len(methods))
            alignment, positioner = run.alignment(name, frame or run.choose_frame(name)), run.positioner(name)
            if drive == "use":
                positioner, _ = adapt(positioner, recording)  # the lean in deployment is corrected as in evaluation
            with use_threads(run.scenario.learn.train.threads):
                poses = find_poses(positioner, recording.observation)
            poses = (poses if alignment is None else poses.align(alignment)).take(order)
            found.append(Trajectory(drive, name, time_s, poses, start_s))
        progress(f"trajectories, {drive}", len(methods), len(methods))
    return found


def _put_in_order(recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """The observations that have times, in the order of these, and the times [s]."""
    time_s = recording.observation_time
    if time_s is None or not np.isfinite(time_s).any():
        raise InputError(f"{recording.folder} has no times of its observations, which a trajectory needs")
    order = np.argsort(time_s, kind="stable")
    order = order[np.isfinite(time_s[order])]
    return order, time_s[order]


def write_table(path: Path, one: Trajectory) -> None:
    """Write a trajectory as CSV with a header; a value that is not known is empty."""
    columns = {"x_m": one.poses.position[:, 0], "y_m": one.poses.position[:, 1]}
    columns |= {name: vars(one.poses)[part] for part, name in COLUMNS.items() if vars(one.poses)[part] is not None}
    times = [f"{time_s:.6f}" for time_s in one.start_s + one.time_s]
    rows = zip(times, *(map(_write_value, column.tolist()) for column in columns.values()), strict=True)
    write_text(path, "\n".join([",".join(["time_s", *columns]), *map(",".join, rows), ""]))


def _write_value(value: float | bool) -> str:
    return str(int(value)) if isinstance(value, bool) else "" if np.isnan(value) else f"{value:.9g}"


def write_drives(folder: Path, run: Run, trajectories: Sequence[Trajectory], progress: Report) -> None:
    """Write ``mcap/<drive>.mcap`` for the training drive and the deployment drive, with trajectories along them."""
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

    def make(rows: np.ndarray, number: int) -> Any:
        row = rows[number]
        return make_uncertain_pose(int(ns[row]), pose[row], variance[row])

    kinds = {"pose": np.flatnonzero(accepted), "refused": np.flatnonzero(~accepted)}
    return [Topic(f"/{one.name}/{kind}", ns[rows], partial(make, rows)) for kind, rows in kinds.items() if len(rows)]


def find_variances(poses: Poses) -> np.ndarray:
    """Variances of x, y and yaw (n, 3) [m2, m2, rad2], large where they are not known."""
    unknown = np.full(len(poses.position), np.nan)
    place = unknown if poses.radius_68 is None else poses.radius_68 * SIGMA_PER_RADIUS
    std = np.column_stack([place, place, unknown if poses.yaw_std is None else poses.yaw_std])
    return np.where(np.isfinite(std), std**2, (UNKNOWN_VARIANCE_M2, UNKNOWN_VARIANCE_M2, UNKNOWN_VARIANCE_RAD2))


def _count_ns(time_s: np.ndarray, start_ns: int) -> np.ndarray:
    return start_ns + np.rint(np.asarray(time_s) * 1e9).astype(np.int64)
