"""What an import found and left out, for a recording's manifest and for the terminal."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from deepgps.robot_io.logs.camera import PolarSource
from deepgps.robot_io.logs.drive import LoggedDrive
from deepgps.robot_io.logs.matching import Plan
from deepgps.robot_io.logs.robot_config import RobotConfig
from sim.recording.format import measure_driven
from sim.recording.turns import KINDS
from sim.sensors.encoder import ticks_to_distance

MOST = 0.95
"""Part of the drive that images must cover, and part of the images that must be taken during it; else it is noted."""
GAP_S, GAPS = 1.0, 5.0
"""Time between two images in which the drive is not seen [s], if it is also this multiple of the usual time."""
REACH = 0.9
"""Part of the polar image's angle that the camera must see all around; otherwise it is noted."""
LEFT_OUT = {"arc": "arcs", "back": "backward motions", "rest": "rests", "unknown": "gaps"}
"""Kinds of motion that hold neither segments nor turns, and their names in the plural."""


def note_cover(topic: str, drive: LoggedDrive) -> list[str]:
    """Notes if images are missing in a part of the drive, which is not used, or were taken outside of it."""
    begin_s, end_s = drive.wheels.time_s[[0, -1]]
    image_s = np.sort(drive.image_s[np.isfinite(drive.image_s)])
    seen_s = image_s[(image_s >= begin_s) & (image_s <= end_s)]
    if not len(seen_s):
        return []
    notes, step = [], np.diff(seen_s)
    gap = step > max(GAP_S, GAPS * float(np.median(step)) if len(step) else 0.0)
    covered_s = float(step[~gap].sum())
    if covered_s < MOST * (end_s - begin_s):
        longest = f", without {step.max():.0f} s from {seen_s[np.argmax(step)]:.1f} s on" if gap.any() else ""
        notes.append(
            f"{topic}: images cover {covered_s:.0f} of {end_s - begin_s:.0f} s of the drive, from {seen_s[0]:.1f} to "
            f"{seen_s[-1]:.1f} s{longest}; the rest is not used"
        )
    if len(seen_s) < MOST * len(image_s):
        notes.append(
            f"{topic}: {len(image_s) - len(seen_s)} of {len(image_s)} images were taken before or after the wheels "
            "were logged, and are left out"
        )
    return notes


def note_reach(source: PolarSource) -> list[str]:
    """A note if polar images go further from the optical axis than the camera's images do."""
    reach, half = source.camera.find_half_angle(), source.lens.half_angle
    if reach >= REACH * half:
        return []
    return [
        f"{source.topic}: images reach {np.degrees(reach):.0f} deg from the optical axis all around it, and polar "
        f"images {np.degrees(half):.0f}, so these are black in part: are circle_px and field_of_view_deg right?"
    ]


def describe(config: RobotConfig, source: PolarSource, drive: LoggedDrive, train: Plan, test: Plan) -> dict[str, Any]:
    """Entries of the manifest on what was imported.

    Args:
        config: The robot.
        source: Its images.
        drive: Its drive.
        train: What is learned from.
        test: What is held out.
    """
    travelled_m = ticks_to_distance(train.reading[:, 2:], config.wheels.radius_m, config.wheels.ticks_per_rev)
    kind = train.turns[:, 3]
    tested = config.pose is not None and config.pose.use == "truth"  # test images with a pose, and none after turns
    used = (train.observation, train.turn_image, test.observation, *(() if tested else (test.turn_image,)))
    return {
        "wheels_topic": config.wheels.topic,
        "camera_topic": source.topic,
        "pose_topic": config.pose.topic if config.pose else None,
        "offset_s": {topic: None if np.isnan(value) else round(value, 6) for topic, value in drive.offset_s.items()},
        "start_ns": drive.start_ns,
        "duration_s": round(float(np.ptp(drive.wheels.time_s)), 3),
        "camera": _describe_camera(config, source),
        "images": len(drive.image_s),
        "images_used": sum(map(len, used)),
        "held_out": len(test.observation),
        "segments": len(train.motions),
        "segments_m": measure_driven(train.reading[:, 0], travelled_m.mean(axis=1)),
        "turns": {name: int((kind == number).sum()) for number, name in enumerate(KINDS)},
        "turns_seen": len(train.turn_image),
        "left_out": {name: _sum_up(drive, name) for name in LEFT_OUT},
    }


def _describe_camera(config: RobotConfig, source: PolarSource) -> dict[str, Any]:
    camera = source.camera
    return {
        "model": camera.model,
        "size": list(camera.size),
        "focal_px": list(camera.focal),
        "centre_px": list(camera.centre),
        "coefficients": list(camera.coefficients),
        "height_m": config.camera.height_m,
        "forward_deg": config.camera.forward_deg,
        "mirrored": config.camera.mirrored,
    }


def _sum_up(drive: LoggedDrive, kind: str) -> dict[str, float]:
    """Number, duration [s] and distance [m] of the motions of a kind."""
    some = [one for one in drive.motions if one.kind == kind]
    seconds = sum(drive.wheels.time_s[one.last] - drive.wheels.time_s[one.first] for one in some)
    metres = sum(map(drive.path.find_way, some))
    return {"count": len(some), "seconds": round(float(seconds), 1), "metres": round(float(metres), 2)}


def write_summary(about: Mapping[str, Any]) -> str:
    """What an import found and left out, as text of some lines."""
    turns, out = about["turns"], about["left_out"]
    lines = [
        f"{about['segments']} segments, {about['segments_m']:.1f} m, in {about['duration_s']:.0f} s; "
        f"{turns['in_place']} turns in place, {about['turns_seen']} of them seen before and after",
        f"images: {about['images']} in the log, {about['images_used']} used, {about['held_out']} of these held out",
        "left out: "
        + ", ".join(
            f"{out[kind]['count']} {name} ({out[kind]['metres']:.1f} m, {out[kind]['seconds']:.0f} s)"
            for kind, name in LEFT_OUT.items()
        ),
        f"wheels {1000 * about['lag_s']:.0f} ms later than images",
    ]
    return "\n".join([*lines, *(f"note: {note}" for note in about["notes"])])
