"""A recording from a robot's log: segments and turns by the wheels, images at them, the poses of motion capture.

The log is read three times, never kept: for the wheels and the times of images, for the turns that tell the lag, and
for the images that the recording holds.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from deepgps.api.record import check_place, write_aside, write_recording
from deepgps.robot_io.logs.camera import PolarSource, open_polar
from deepgps.robot_io.logs.containers import open_log
from deepgps.robot_io.logs.drive import LoggedDrive, read_drive
from deepgps.robot_io.logs.lag import compare_wheels
from deepgps.robot_io.logs.matching import Images, Plan, describe, note_cover, note_reach, plan_recording
from deepgps.robot_io.logs.robot_config import RobotConfig
from deepgps.robot_io.logs.segmentation import KINDS, find_path
from deepgps.terminal.progress import Report
from sim.errors import InputError
from sim.files.atomic import check_space
from sim.files.checksums import read_json
from sim.recording.format import finish_recording
from sim.recording.manifest import DEPLOYMENT_FOLDER
from sim.settings import CameraSettings

MAX_DAMAGED_SHARE = 0.05  # Share of damaged images from which a log is refused
MIN_SEGMENTS = 3
"""Segments from which one is held out, however small the part that is wanted: errors cannot be measured without."""
HEIGHTS_M = (0.2, 1.5)  # Limits of the setting camera.height_m, by which only the viewer draws [m]


def import_log(path: Path, config: RobotConfig, out: Path, progress: Report, config_sha256: str = "") -> dict[str, Any]:
    """Import a log as a recording in a folder of its own; return the manifest's entries on it, with ``notes`` on what
    the user should know.

    Raises InputError if the log or its configuration, of this checksum, cannot be used; one line says why.
    """
    check_place(out)
    with open_log(path) as log:
        drive = read_drive(log, config, progress)
        out.parent.mkdir(parents=True, exist_ok=True)
        source = open_polar(log, config.camera, out.parent)
        lag_s, doubts = compare_wheels(source, drive, config.wheels.lag_s, progress)
        about = {"name": path.name, "config_sha256": config_sha256, "lag_s": lag_s}
        notes = [*log.notes, *drive.notes, *note_reach(source), *note_cover(source.topic, drive), *doubts]
        return _Import(config, source, drive, lag_s).write(about, notes, out, progress)


@dataclass(frozen=True)
class _Import:
    """What an import is made of."""

    config: RobotConfig
    source: PolarSource
    drive: LoggedDrive
    lag_s: float

    def write(self, about: dict[str, Any], notes: list[str], out: Path, progress: Report) -> dict[str, Any]:
        """Choose, draw and write the images; where some are damaged, the choice is made again without them."""
        source, damage = self.source, list[str]()
        while True:  # each round finds another damaged image, and too many are refused
            plans, before = self._choose(), len(source.damaged)
            parts = [one for plan in plans for one in (plan.observation, plan.turn_image)]
            numbers = np.concatenate(parts)
            check_space(out, 2 * len(numbers) * int(np.prod(source.shape)))
            images = source.draw(numbers, progress, "unwrap images")
            if source.damaged:
                first, count = min(source.damaged), len(source.damaged)
                where = f"{source.topic} at {self.drive.image_s[first]:.2f} s"
                damage = [f"{where}: {source.damaged[first]}; damaged images: {count}"]
            if len(source.damaged) > max(MAX_DAMAGED_SHARE * len(source.drawn), 1):
                raise InputError(damage[0])
            if len(source.damaged) == before:
                break
        found = {**about, **describe(self.config, source, self.drive, *plans), "notes": [*notes, *damage]}
        self._store(plans, np.split(images, np.cumsum([len(part) for part in parts[:-1]])), out, found)
        return found

    def _choose(self) -> tuple[Plan, Plan]:
        """The images of the segments to learn from and of those held out; raises InputError if there is no segment."""
        config, driven, images = self.config, self.drive.driven, self._match()
        straight = [number for number, motion in enumerate(driven.motions) if motion.kind == "straight"]
        held_out = round(config.drive.held_out * len(straight))
        if config.drive.held_out and len(straight) >= MIN_SEGMENTS:
            held_out = max(held_out, 1)
        count = len(driven.motions)
        end = straight[-held_out] if held_out else count
        train, test = (
            plan_recording(driven, some, images, config.drive.spacing_m, config.wheels.ticks_per_rev)
            for some in (range(end), range(end, count))
        )
        if not len(train.observation):
            found = ", ".join(f"{sum(one.kind == kind for one in driven.motions)} {kind}" for kind in KINDS)
            hint = "; ".join(("do their times overlap, and do both wheels count forward?", *self.drive.notes[:1]))
            raise InputError(
                f"{config.wheels.topic}, {self.source.topic}: no straight segment with two images was found (motions: "
                f"{found}; images at known angles: {len(images.number)}); {hint}"
            )
        return train, test

    def _match(self) -> Images:
        """The images that can be used, with the wheels at their times."""
        drive, wheels = self.drive, self.config.wheels
        order = np.argsort(drive.image_s, kind="stable")
        time_s = drive.image_s[order]
        angle = drive.driven.wheels.at(time_s + self.lag_s)
        good = np.isfinite(angle).all(axis=1) & ~np.isin(order, list(self.source.damaged))
        if drive.pose is not None and self.config.pose and self.config.pose.use == "truth":
            good &= np.isfinite(drive.pose[order]).all(axis=1)
        good &= np.diff(time_s, prepend=-np.inf) > 0
        path = find_path(angle[good], wheels.radius_m, wheels.track_m)
        return Images(order[good], time_s[good], time_s[good] + self.lag_s, angle[good], path)

    def _store(self, plans: tuple[Plan, Plan], images: Sequence[np.ndarray], out: Path, about: dict[str, Any]) -> None:
        """Write the recording and, where it has no truth, what is held out as its deployment drive."""
        (train, test), pose, known = plans, self.drive.pose, dict[str, Any]()
        if pose is not None and self.config.pose and self.config.pose.use == "labels":
            known = {"labels": pose[train.observation]}
        elif pose is not None:
            known = {"pose": pose[train.observation]}
            if len(test.observation):
                known |= {"test_pose": pose[test.observation], "test_observations": images[2]}
        with write_aside(out) as folder:
            self._write_plan(train, images[:2], folder, {"source": "log", "log": about}, known)
            if "pose" not in known and len(test.observation):
                self._write_plan(test, images[2:], folder / DEPLOYMENT_FOLDER, {"source": "log"}, {})
                finish_recording(folder, read_json(folder / "manifest.json"))

    def _write_plan(
        self, plan: Plan, images: Sequence[np.ndarray], folder: Path, about: dict[str, Any], known: dict[str, Any]
    ) -> None:
        """Write the recording of a plan, of its images and those after turns, with what is known of poses."""
        wheels, field_deg = self.config.wheels, round(float(np.degrees(2 * self.source.lens.half_angle)), 6)
        height_m = float(np.clip(self.config.camera.height_m, *HEIGHTS_M))
        write_recording(
            folder,
            images[0],
            plan.reading,
            plan.time_s,
            {"wheel_radius_m": wheels.radius_m, "track_m": wheels.track_m, "ticks_per_rev": wheels.ticks_per_rev},
            observation_time=self.drive.image_s[plan.observation],
            turns=plan.turns,
            turn_observations=images[1],
            camera=CameraSettings(field_of_view_deg=field_deg, height_m=height_m),
            about={**about, **({"wheels_computed": True} if self.drive.from_odometry else {})},
            **known,
        )
