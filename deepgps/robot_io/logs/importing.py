"""A recording from a robot's log: segments and turns by the wheels, images at them, the poses of motion capture.

The log is read three times, never kept: for the wheels and the times of images, for the turns that tell the lag, and
for the images that the recording holds.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

import numpy as np

from deepgps.api.record import check_place, write_aside, write_recording
from deepgps.robot_io.logs.camera import PolarSource, open_polar
from deepgps.robot_io.logs.containers import Log, open_log
from deepgps.robot_io.logs.drive import LoggedDrive, find_drive
from deepgps.robot_io.logs.lag import choose_lag, measure_lag
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


@dataclass(frozen=True)
class Choice:
    """The images of a recording, numbered as in the log."""

    train: Plan  # Those of the segments to learn from
    test: Plan  # Those of the segments that are held out

    @property
    def parts(self) -> list[np.ndarray]:
        """Images of the observations and after turns, and the same of what is held out."""
        return [one for plan in (self.train, self.test) for one in (plan.observation, plan.turn_image)]

    @property
    def numbers(self) -> list[int]:
        """All images."""
        return np.concatenate(self.parts).tolist()


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
        drive = find_drive(config, *_read(log, config, progress))
        source = open_polar(log, config.camera)
        out.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=out.parent) as file:
            lag, doubts = measure_lag(source, drive, file, progress)
        lag_s, notes = choose_lag(config.wheels.lag_s, lag)
        about = {"name": path.name, "config_sha256": config_sha256, "lag_s": lag_s}
        notes = [*log.notes, *drive.notes, *note_reach(source), *note_cover(source.topic, drive), *doubts, *notes]
        return _write(config, source, drive, about, notes, out, progress)


def _read(log: Log, config: RobotConfig, progress: Report) -> tuple[WheelLog, ImageList, PoseLog | None]:
    """Read wheels, times of images, and poses, all at once."""
    wheels, images = open_wheels(log, config.wheels), open_images(log, config.camera.topic)
    poses = open_poses(log, config.pose.topic) if config.pose else None
    takers = {config.wheels.topic: wheels.take, images.topic: images.take}
    if poses is not None and config.pose:
        if config.pose.topic in takers:
            raise InputError(f"pose.topic {config.pose.topic}: is the topic of the wheels or of the camera")
        takers[config.pose.topic] = poses.take
    log.feed(takers, progress)
    wheels.check()
    images.check()
    if poses is not None and config.pose:
        poses.check(config.pose.topic)
    return wheels, images, poses


def _write(
    config: RobotConfig,
    source: PolarSource,
    drive: LoggedDrive,
    about: Mapping[str, Any],
    notes: list[str],
    out: Path,
    progress: Report,
) -> dict[str, Any]:
    """Choose, draw and write the images; where some are damaged, the choice is made again without them."""
    while True:  # each round finds another damaged image, and too many are refused
        choice = _choose(config, source, drive, about["lag_s"])
        check_space(out, 2 * len(choice.numbers) * source.size)
        before = len(source.damaged)
        with TemporaryFile(dir=out.parent) as file:
            source.draw(choice.numbers, file, progress, "unwrap images")
            damage = _describe_damage(source, drive)
            if len(source.damaged) > max(MAX_DAMAGED_SHARE * len(source.drawn), 1):
                raise InputError(damage)
            if len(source.damaged) > before:
                continue
            described = {**about, **describe(config, source, drive, choice.train, choice.test)}
            described["notes"] = [*notes, *([damage] if damage else [])]
            _store(config, source, drive, choice, source.map(file, len(choice.numbers)), out, described)
        return described


def _choose(config: RobotConfig, source: PolarSource, drive: LoggedDrive, lag_s: float) -> Choice:
    """Choose the images; raises InputError if there is no segment."""
    wheels = drive.wheels
    path = drive.path
    images = _match(config, source, drive, lag_s)
    straight = [number for number, motion in enumerate(drive.motions) if motion.kind == "straight"]
    held_out = round(config.drive.held_out * len(straight))
    if config.drive.held_out and len(straight) >= MIN_SEGMENTS:
        held_out = max(held_out, 1)
    count = len(straight) - held_out
    end = straight[count] if count < len(straight) else len(drive.motions)
    spacing_m, ticks = config.drive.spacing_m, config.wheels.ticks_per_rev
    train = plan_recording(drive.motions, range(end), wheels, path, images, spacing_m, ticks)
    if not len(train.motions):
        found = {kind: sum(one.kind == kind for one in drive.motions) for kind in KINDS}
        hint = next(iter(drive.notes), "do their times overlap, and do both wheels count forward?")
        raise InputError(
            f"{config.wheels.topic}, {source.topic}: no straight segment with two images was found (motions: "
            f"{', '.join(f'{count} {kind}' for kind, count in found.items())}; images at known angles: "
            f"{len(images.number)}); {hint}"
        )
    test = plan_recording(drive.motions, range(end, len(drive.motions)), wheels, path, images, spacing_m, ticks)
    return Choice(train, test)


def _match(config: RobotConfig, source: PolarSource, drive: LoggedDrive, lag_s: float) -> Images:
    """The images that can be used, with the wheels at their times."""
    order = np.argsort(drive.image_s, kind="stable")
    wheel_s = drive.image_s[order] + lag_s
    angle = drive.wheels.at(np.nan_to_num(wheel_s, nan=-np.inf))
    good = np.isfinite(angle).all(axis=1) & ~np.isin(order, list(source.damaged))
    if drive.pose is not None and config.pose and config.pose.use == "truth":
        good &= np.isfinite(drive.pose[order]).all(axis=1)
    good[1:] &= np.diff(drive.image_s[order]) > 0
    order, wheel_s, angle = order[good], wheel_s[good], angle[good]
    path = find_path(angle, config.wheels.radius_m, config.wheels.track_m)
    return Images(order, drive.image_s[order], wheel_s, angle, path)


def _describe_damage(source: PolarSource, drive: LoggedDrive) -> str:
    """The first damaged image in one line; empty: there is none."""
    if not source.damaged:
        return ""
    number = min(source.damaged)
    return (
        f"{source.topic} at {drive.image_s[number]:.2f} s: {source.damaged[number]}; damaged images: "
        f"{len(source.damaged)}"
    )


def _store(
    config: RobotConfig,
    source: PolarSource,
    drive: LoggedDrive,
    choice: Choice,
    images: np.ndarray,
    out: Path,
    about: Mapping[str, Any],
) -> None:
    """Write the recording and, where it has no truth, what is held out as its deployment drive."""
    observation, turn, test, test_turn = np.split(images, np.cumsum([len(part) for part in choice.parts[:-1]]))
    known = _take_poses(config, drive, choice)
    if "pose" in known and len(test):
        known["test_observations"] = test
    with write_aside(out) as folder:
        entries = {"source": "log", "log": about}
        _write_plan(config, source, drive, choice.train, observation, turn, folder, entries, known)
        if "pose" not in known and len(choice.test.motions):
            _write_plan(
                config, source, drive, choice.test, test, test_turn, folder / DEPLOYMENT_FOLDER, {"source": "log"}, {}
            )
            manifest = read_json(folder / "manifest.json")
            finish_recording(folder, {name: value for name, value in manifest.items() if name not in LAST_ENTRIES})


def _write_plan(
    config: RobotConfig,
    source: PolarSource,
    drive: LoggedDrive,
    plan: Plan,
    observation: np.ndarray,
    turn: np.ndarray,
    folder: Path,
    about: Mapping[str, Any],
    known: Mapping[str, Any],
) -> None:
    """Write the recording of a plan, of its images before and after turns, with what is known of poses."""
    wheels = config.wheels
    write_recording(
        folder,
        observation,
        plan.reading,
        plan.time_s,
        {"wheel_radius_m": wheels.radius_m, "track_m": wheels.track_m, "ticks_per_rev": wheels.ticks_per_rev},
        observation_time=drive.image_s[plan.observation],
        turns=plan.turns,
        turn_observations=turn,
        camera=_describe_lens(config, source),
        about={**about, **({"wheels_computed": True} if drive.from_odometry else {})},
        **known,
    )


def _take_poses(config: RobotConfig, drive: LoggedDrive, choice: Choice) -> dict[str, Any]:
    """Poses of observations, as truth or as labels."""
    if drive.pose is None or config.pose is None:
        return {}
    if config.pose.use == "labels":
        return {"labels": drive.pose[choice.train.observation]}
    test = choice.test.observation
    return {"pose": drive.pose[choice.train.observation], **({"test_pose": drive.pose[test]} if len(test) else {})}


def _describe_lens(config: RobotConfig, source: PolarSource) -> CameraSettings:
    """The camera of the polar images, as a scenario describes it, whose heights are limited."""
    field_deg = round(float(np.degrees(2 * source.lens.half_angle)), 6)
    return CameraSettings(field_of_view_deg=field_deg, height_m=float(np.clip(config.camera.height_m, *HEIGHTS_M)))
