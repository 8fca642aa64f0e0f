"""Trajectories of a run for other tools: each method's poses along each drive, and the truth, as TUM files or CSV."""

import csv
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from io import StringIO
from pathlib import Path
from typing import Literal

import numpy as np

from deepgps.api.run import Frame, Run
from deepgps.evaluation.in_use import adapt, open_drive_in_use
from deepgps.learning.trainer import use_threads
from deepgps.positioner.pose import Poses, find_poses
from deepgps.terminal.progress import Report
from deepgps.tracking.tum import write_tum
from sim.errors import InputError
from sim.files.atomic import write_text
from sim.recording.format import Recording, has_truth, open_truth

Format = Literal["tum", "csv"]
DRIVES = ("training", "use")
TRUTH = "truth"
COLUMNS = {
    "position_std": "position_std_m",
    "yaw": "yaw_rad",
    "yaw_std": "yaw_std_rad",
    "yaw_weight": "yaw_weight",
    "other_yaw": "other_yaw_rad",
    "other_weight": "other_weight",
    "novelty": "novelty_m",
    "radius_68": "radius_68_m",
    "radius_95": "radius_95_m",
    "accepted": "accepted",
}
"""Columns of the parts of poses, but for the position."""


@dataclass(frozen=True)
class Trajectory:
    """Poses along a drive.

    Attributes:
        drive: Name of the drive.
        name: Name of the method, or ``TRUTH``.
        time_s: Time of each pose (n,) [s], never falling, from the beginning of the recording.
        poses: The poses.
        start_s: When the recording began [s since 1970]; 0 unless it is of a robot's log.
    """

    drive: str
    name: str
    time_s: np.ndarray
    poses: Poses
    start_s: float = 0.0


def write_trajectories(folder: Path, trajectories: Sequence[Trajectory], formats: Sequence[Format]) -> None:
    """Write ``<format>/<drive>/<method>.<format>`` for each trajectory.

    Args:
        folder: Where to.
        trajectories: What to write.
        formats: Names in ``WRITE``.
    """
    for one in trajectories:
        for name in formats:
            WRITE[name](folder / name / one.drive / f"{one.name}.{name}", one)


def open_drives(run: Run) -> dict[str, Recording]:
    """The recordings of a run's drives by name."""
    in_use = open_drive_in_use(run.recording)
    return {"training": run.recording} | ({} if in_use is None else {"use": in_use})


def find_trajectories(run: Run, method: str | None, frame: Frame | None, progress: Report) -> list[Trajectory]:
    """The true trajectory and the methods' along the training drive and the drive in use.

    Args:
        run: The run.
        method: The only method; None: all.
        frame: Frame of the methods' poses; None: the world's where evaluation has placed the map. The truth is in the
            world's.
        progress: Called with the trajectories done and their number.

    Raises:
        InputError: There is no such method, the recording has no times, or a map has no place in the world.
    """
    methods, drives = run.methods if method is None else (run.choose(method),), open_drives(run)
    total = len(drives) * len(methods) + sum(has_truth(one.folder) for one in drives.values())
    found = list[Trajectory]()
    for one in _follow(run, drives, methods, frame):
        found.append(one)
        progress("trajectories", len(found), total)
    return found


def _follow(
    run: Run, drives: dict[str, Recording], methods: tuple[str, ...], frame: Frame | None
) -> Iterator[Trajectory]:
    """Trajectories one after the other; the lean in use is corrected as in evaluation."""
    in_use = drives.get("use")
    start_s = 1e-9 * run.recording.manifest.start_ns  # all drives of a log count from its start
    for drive, recording in drives.items():
        order, time_s = _put_in_order(recording)
        if has_truth(recording.folder):
            pose = open_truth(recording.folder).pose[order]
            yield Trajectory(drive, TRUTH, time_s, Poses(pose[:, :2], yaw=pose[:, 2]), start_s)
        for method in methods:
            alignment = run.alignment(method, frame or run.choose_frame(method))
            positioner = run.positioner(method)
            positioner = adapt(positioner, in_use)[0] if drive == "use" else positioner
            with use_threads(run.scenario.learn.train.threads):
                poses = find_poses(positioner, recording.observation)
            poses = poses if alignment is None else poses.align(alignment)
            yield Trajectory(drive, method, time_s, poses.take(order), start_s)


def _put_in_order(recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """The observations that have times, in the order of these, and the times [s]."""
    time_s = recording.observation_time
    if time_s is None or not np.isfinite(time_s).any():
        raise InputError(f"{recording.folder} has no times of its observations, which a trajectory needs")
    order = np.argsort(time_s, kind="stable")
    order = order[np.isfinite(time_s[order])]
    return order, time_s[order]


def write_path(path: Path, one: Trajectory) -> None:
    """Write a trajectory as a TUM file."""
    yaw = np.full(len(one.time_s), np.nan) if one.poses.yaw is None else one.poses.yaw
    write_tum(path, one.start_s + one.time_s, np.column_stack([one.poses.position, yaw]))


def write_table(path: Path, one: Trajectory) -> None:
    """Write a trajectory as CSV with a header; a value that is not known is empty."""
    parts = {"x_m": one.poses.position[:, 0], "y_m": one.poses.position[:, 1]}
    for field in fields(one.poses):
        if field.name in COLUMNS and (part := getattr(one.poses, field.name)) is not None:
            parts[COLUMNS[field.name]] = part
    text = StringIO()
    writer = csv.writer(text, lineterminator="\n")
    times = [f"{time:.6f}" for time in one.start_s + one.time_s]
    writer.writerow(["time_s", *parts])
    writer.writerows(zip(times, *(map(_write_value, part.tolist()) for part in parts.values()), strict=True))
    write_text(path, text.getvalue())


def _write_value(value: float | bool) -> str:
    return str(int(value)) if isinstance(value, bool) else "" if np.isnan(value) else f"{value:.9g}"


WRITE: dict[Format, Callable[[Path, Trajectory], None]] = {"tum": write_path, "csv": write_table}
