"""A recording from a robot's log: segments and turns by the wheels, images at them, the poses of motion capture.

The log is read three times, never kept: for the wheels and the times of images, for the turns that tell the lag, and
for the images that the recording holds.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

import numpy as np

from deepgps.api.record import check_place, write_aside, write_recording
from deepgps.robot_io.logs.camera import PolarSource, open_polar
from deepgps.robot_io.logs.containers import Log, open_log
from deepgps.robot_io.logs.drive import LoggedDrive, find_drive
from deepgps.robot_io.logs.lag import compare_wheels
from deepgps.robot_io.logs.matching import Images, Plan, describe, note_cover, note_reach, plan_recording
from deepgps.robot_io.logs.messages import PoseLog, WheelLog, open_poses, open_wheels
from deepgps.robot_io.logs.pictures import ImageList, open_images
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

LAST_ENTRIES = ("schema", "sha256", "checksum")
"""Entries of a manifest that are written again when a deployment drive is added."""
HEIGHTS_M = (0.2, 1.5)  # Limits of the setting camera.height_m, by which only the viewer draws [m]


def import_log(path: Path, config: RobotConfig, out: Path, progress: Report, config_sha256: str = "") -> dict[str, Any]:
    """Import a log.

    Args:
        path: The log.
        config: What it does not say of its robot.
        out: Folder of the recording; must be empty or not exist, and no link, mount point or working folder.
        progress: Called with what is done.
        config_sha256: Checksum of the configuration's file, for the manifest.

    Returns:
        The manifest's entries on the log, with ``notes`` on what the user should know.

    Raises:
        InputError: The log or its configuration cannot be used; one line says why, with topic and time.
    """
    check_place(out)
    with open_log(path) as log:
        drive = find_drive(config, *read_times(log, config, progress))
        source = open_polar(log, config.camera)
        out.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=out.parent) as file:
            lag_s, doubts = compare_wheels(source, drive, config.wheels.lag_s, file, progress)
        about = {"name": path.name, "config_sha256": config_sha256, "lag_s": lag_s}
        notes = [*log.notes, *drive.notes, *note_reach(source), *note_cover(source.topic, drive), *doubts]
        return _Import(config, source, drive, lag_s).write(about, notes, out, progress)


def read_times(
    log: Log, config: RobotConfig, progress: Report, with_poses: bool = True
) -> tuple[WheelLog, ImageList, PoseLog | None]:
    """Read wheels, times of images, and poses, all at once."""
    wheels, images = open_wheels(log, config.wheels), open_images(log, config.camera.topic)
    takers, poses = {config.wheels.topic: wheels.take, images.topic: images.take}, None
    if config.pose and with_poses:
        poses = open_poses(log, config.pose.topic)
        if config.pose.topic in takers:
            raise InputError(f"pose.topic {config.pose.topic}: is the topic of the wheels or of the camera")
        takers[config.pose.topic] = poses.take
    log.feed(takers, progress)
    for one in filter(None, (wheels, images, poses)):
        one.check()
    return wheels, images, poses


@dataclass(frozen=True)
class _Import:
    """What an import is made of."""

    config: RobotConfig
    source: PolarSource
    drive: LoggedDrive
    lag_s: float

    def write(self, about: Mapping[str, Any], notes: list[str], out: Path, progress: Report) -> dict[str, Any]:
        """Choose, draw and write the images; where some are damaged, the choice is made again without them."""
        source = self.source
        while True:  # each round finds another damaged image, and too many are refused
            plans, before = self._choose(), len(source.damaged)
            parts = [one for plan in plans for one in (plan.observation, plan.turn_image)]
            numbers = np.concatenate(parts).tolist()
            check_space(out, 2 * len(numbers) * int(np.prod(source.shape)))
            with TemporaryFile(dir=out.parent) as file:
                images = source.draw(numbers, file, progress, "unwrap images")
                damage = self._describe_damage()
                if len(source.damaged) > max(MAX_DAMAGED_SHARE * len(source.drawn), 1):
                    raise InputError(damage[0])
                if len(source.damaged) > before:
                    continue
                found = {**about, **describe(self.config, source, self.drive, *plans), "notes": [*notes, *damage]}
                self._store(plans, np.split(images, np.cumsum([len(part) for part in parts[:-1]])), out, found)
                return found

    def _choose(self) -> tuple[Plan, Plan]:
        """The images of the segments to learn from and of those held out; raises InputError if there is no segment."""
        config, drive, images = self.config, self.drive, self._match()
        straight = [number for number, motion in enumerate(drive.driven.motions) if motion.kind == "straight"]
        held_out = round(config.drive.held_out * len(straight))
        if config.drive.held_out and len(straight) >= MIN_SEGMENTS:
            held_out = max(held_out, 1)
        end = straight[-held_out] if held_out else len(drive.driven.motions)

        def plan(some: range) -> Plan:
            spacing_m, ticks = config.drive.spacing_m, config.wheels.ticks_per_rev
            return plan_recording(drive.driven, some, images, spacing_m, ticks)

        train, test = plan(range(end)), plan(range(end, len(drive.driven.motions)))
        if not len(train.motions):
            found = {kind: sum(one.kind == kind for one in drive.driven.motions) for kind in KINDS}
            hint = next(iter(drive.notes), "do their times overlap, and do both wheels count forward?")
            raise InputError(
                f"{config.wheels.topic}, {self.source.topic}: no straight segment with two images was found (motions: "
                f"{', '.join(f'{count} {kind}' for kind, count in found.items())}; images at known angles: "
                f"{len(images.number)}); {hint}"
            )
        return train, test

    def _match(self) -> Images:
        """The images that can be used, with the wheels at their times."""
        drive, wheels = self.drive, self.config.wheels
        order = np.argsort(drive.image_s, kind="stable")
        wheel_s = drive.image_s[order] + self.lag_s
        angle = drive.driven.wheels.at(np.nan_to_num(wheel_s, nan=-np.inf))
        good = np.isfinite(angle).all(axis=1) & ~np.isin(order, list(self.source.damaged))
        if drive.pose is not None and self.config.pose and self.config.pose.use == "truth":
            good &= np.isfinite(drive.pose[order]).all(axis=1)
        good[1:] &= np.diff(drive.image_s[order]) > 0
        order, wheel_s, angle = order[good], wheel_s[good], angle[good]
        path = find_path(angle, wheels.radius_m, wheels.track_m)
        return Images(order, drive.image_s[order], wheel_s, angle, path)

    def _describe_damage(self) -> list[str]:
        """The first damaged image in one line, if there is one."""
        damaged, topic = self.source.damaged, self.source.topic
        return [
            f"{topic} at {self.drive.image_s[number]:.2f} s: {damaged[number]}; damaged images: {len(damaged)}"
            for number in sorted(damaged)[:1]
        ]

    def _store(
        self, plans: tuple[Plan, Plan], images: Sequence[np.ndarray], out: Path, about: Mapping[str, Any]
    ) -> None:
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
            if "pose" not in known and len(test.motions):
                self._write_plan(test, images[2:], folder / DEPLOYMENT_FOLDER, {"source": "log"}, {})
                manifest = read_json(folder / "manifest.json")
                finish_recording(folder, {name: value for name, value in manifest.items() if name not in LAST_ENTRIES})

    def _write_plan(
        self,
        plan: Plan,
        images: Sequence[np.ndarray],
        folder: Path,
        about: Mapping[str, Any],
        known: Mapping[str, Any],
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
