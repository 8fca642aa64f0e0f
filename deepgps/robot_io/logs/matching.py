"""Which images of a log become observations, with the wheels' ticks at their times, and what was found and left out."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from deepgps.robot_io.logs.camera import PolarSource
from deepgps.robot_io.logs.drive import LoggedDrive
from deepgps.robot_io.logs.robot_config import RobotConfig
from deepgps.robot_io.logs.segmentation import Driven, Path
from sim.recording.format import measure_driven
from sim.recording.turns import KINDS, NO_IMAGE
from sim.sensors.encoder import ticks_to_distance

MATCH_M, MATCH_RAD = 0.003, np.radians(0.4)
"""An image shows the place and heading at which a turn begins or ends if it is as near as this [m], [rad]."""
MAX_SHIFT_M, NEIGHBOURHOOD_M = 0.02, 0.3
"""Way between two segments up to which the robot turned in place, and up to which the next one begins nearby [m]."""
DOUBTFUL_DISTANCE_M = 0.12
"""Before the robot backs off, it has touched something: its wheels may have slipped over this last distance [m]."""
MIN_SPACING_SHARE = 0.4  # The last images of a segment are at least this part of the spacing apart
IN_PLACE, BACKED_OFF, RELOCATED = (KINDS.index(name) for name in ("in_place", "backed_off", "relocated"))


@dataclass(frozen=True)
class Plan:
    """What a recording is made of; images are numbered as in the log."""

    observation: np.ndarray  # Image of each observation (N,)
    reading: np.ndarray  # Segment, observation, ticks of the left and of the right wheel (R, 4)
    time_s: np.ndarray  # Time of each reading (R,) [s]
    turn_image: np.ndarray  # Image after each turn in place (K,)
    turns: np.ndarray  # As stored in a recording (T, 4)


@dataclass(frozen=True)
class Images:
    """The images of a log whose time is known and at whose time the wheels' angles are."""

    number: np.ndarray  # Number of each in the log (m,)
    time_s: np.ndarray  # Its time (m,) [s], increasing
    # The time of the wheels' messages that tell where the robot was then (m,) [s]: later by their lag
    wheel_s: np.ndarray
    angle: np.ndarray  # The wheels' angles then (m, 2) [rad]
    path: Path  # Distance and heading then


def plan_recording(driven: Driven, some: range, images: Images, spacing_m: float, ticks: int) -> Plan:
    """Choose images, at a distance from each other [m], for the segments among some of a drive's motions, whose wheels
    count so many ticks a revolution."""
    rows, turn_rows, used = list[int](), list[int](), list[int]()
    readings = list[tuple[int, int, int]]()  # segment, observation, row of the image that tells the ticks
    turns = list[tuple[int, int, int, int]]()
    for number in some:
        chosen = _choose(driven, number, images, spacing_m)
        if len(chosen) < 2:
            continue
        if used:
            kind = judge_turn(driven, range(used[-1] + 1, number))
            after = _find_after(driven, number, images, rows[-1])
            seen = _are_near(driven.path, driven.motions[used[-1]].last, images, np.array(rows[-1:])).all()
            if kind == IN_PLACE and after is not None and seen:
                # the segment begins with the observation before the turn, which the image after it shows again
                turns.append((len(rows) - 1, len(turn_rows), len(readings), IN_PLACE))
                turn_rows.append(after)
                readings.append((len(used), len(rows) - 1, after))
                ahead_m = images.path.travelled_m[chosen] - images.path.travelled_m[after]
                chosen = chosen[ahead_m >= MIN_SPACING_SHARE * spacing_m]
            else:
                turns.append((len(rows) - 1, NO_IMAGE, len(readings), kind))
        readings += [(len(used), len(rows) + place, row) for place, row in enumerate(chosen.tolist())]
        rows += chosen.tolist()
        used.append(number)
    table = np.array(readings, np.int64).reshape(-1, 3)
    counts = np.rint(images.angle[table[:, 2]] * ticks / (2 * np.pi)).astype(np.int64)
    reading, turned = np.column_stack([table[:, :2], counts]), np.array(turns, np.int64).reshape(-1, 4)
    return Plan(images.number[rows], reading, images.time_s[table[:, 2]], images.number[turn_rows], turned)


def judge_turn(driven: Driven, between: range) -> int:
    """Number of the kind of turn that motions between two segments are together."""
    moves = [one for one in (driven.motions[number] for number in between) if one.kind not in {"rest", "turn"}]
    distance = sum(map(driven.path.measure, moves))
    turned = sum(abs(driven.path.turn(one)) for one in moves if one.kind != "back")
    if any(one.kind == "unknown" for one in moves) or distance > NEIGHBOURHOOD_M:
        return RELOCATED
    if distance <= MAX_SHIFT_M:
        return IN_PLACE
    return BACKED_OFF if turned * distance < MAX_SHIFT_M else RELOCATED


def _choose(driven: Driven, number: int, images: Images, spacing_m: float) -> np.ndarray:
    """Rows of the images of a segment, evenly spaced, its first and last included; none if it is no segment."""
    segment, later = driven.motions[number], driven.motions[number + 1 :]
    if segment.kind != "straight":
        return np.empty(0, int)
    rows = np.arange(*_find_span(driven, number, images))
    if next((one.kind == "back" for one in later if one.kind != "rest"), False):
        rows = rows[images.path.travelled_m[rows] <= driven.path.travelled_m[segment.last] - DOUBTFUL_DISTANCE_M]
    if not len(rows):
        return rows
    place = np.maximum.accumulate(images.path.travelled_m[rows])
    target = np.arange(place[0], place[-1], spacing_m)
    target[:1] += MATCH_M / 3  # at rest, the latest
    nearest = np.searchsorted((place[1:] + place[:-1]) / 2, target)
    apart = nearest[place[-1] - place[nearest] >= MIN_SPACING_SHARE * spacing_m]
    return rows[np.unique(np.append(apart, len(place) - 1))]


def _find_span(driven: Driven, number: int, images: Images) -> np.ndarray:
    """Rows of the first image, and after the last one, of a segment and the rests before and after it."""
    motions = driven.motions[max(number - 1, 0) : number + 2]
    near = [one for one in motions if one.kind == "rest" or one is driven.motions[number]]
    return np.searchsorted(images.wheel_s, driven.wheels.time_s[[near[0].first, near[-1].last]])


def _find_after(driven: Driven, number: int, images: Images, last: int) -> int | None:
    """The first row, after the last one of the segment before, that shows a segment's beginning after a turn in place;
    None: there is none."""
    end = np.searchsorted(images.wheel_s, driven.wheels.time_s[driven.motions[number].last])
    rows = np.arange(max(_find_span(driven, number, images)[0], last + 1), end)
    near = rows[_are_near(driven.path, driven.motions[number].first, images, rows)]
    return int(near[0]) if len(near) else None


def _are_near(path: Path, message: int, images: Images, rows: np.ndarray) -> np.ndarray:
    """Which images were taken where the robot was at a message of the wheels, under the same heading."""
    apart_m = images.path.travelled_m[rows] - path.travelled_m[message]
    return (np.abs(apart_m) <= MATCH_M) & (np.abs(images.path.yaw[rows] - path.yaw[message]) <= MATCH_RAD)


MIN_COVERED_SHARE = 0.95
"""Part of the drive that images must cover, and part of the images that must be taken during it; else it is noted."""
GAP_S = 1.0  # Time between two images in which the drive is not seen [s]
MIN_REACH = 0.9  # Part of the polar image's angle that the camera must see all around; otherwise it is noted
OTHER_MOTIONS = {"arc": "arcs", "back": "backward motions", "rest": "rests", "unknown": "gaps"}
"""Kinds of motion that hold neither segments nor turns, and their names in the plural."""


def note_cover(topic: str, drive: LoggedDrive) -> list[str]:
    """A note if images are missing in a part of the drive, which is not used, or were taken outside of it."""
    begin_s, end_s = drive.driven.wheels.time_s[[0, -1]]
    image_s = np.sort(drive.image_s[np.isfinite(drive.image_s)])
    seen_s = image_s[(image_s >= begin_s) & (image_s <= end_s)]
    step = np.diff(seen_s, prepend=begin_s, append=end_s)
    covered_s, outside = float(step[step <= GAP_S].sum()), len(image_s) - len(seen_s)
    if covered_s >= MIN_COVERED_SHARE * (end_s - begin_s) and len(seen_s) >= MIN_COVERED_SHARE * len(image_s):
        return []
    return [
        f"{topic}: images cover {covered_s:.0f} of {end_s - begin_s:.0f} s of the drive, at most {step.max():.0f} s in "
        f"a row are missing, and {outside} of {len(image_s)} images were taken before or after it; the rest is not used"
    ]


def note_reach(source: PolarSource) -> list[str]:
    """A note if polar images go further from the optical axis than the camera's images do."""
    reach, half = source.unwrap.camera.find_half_angle(), source.lens.half_angle
    if reach >= MIN_REACH * half:
        return []
    return [
        f"{source.topic}: images reach {np.degrees(reach):.0f} deg from the optical axis all around it, and polar "
        f"images {np.degrees(half):.0f}, so these are black in part: are circle_px and field_of_view_deg right?"
    ]


def describe(config: RobotConfig, source: PolarSource, drive: LoggedDrive, train: Plan, test: Plan) -> dict[str, Any]:
    """Entries of the manifest on what was imported, to learn from and held out."""
    travelled_m = ticks_to_distance(train.reading[:, 2:], config.wheels.radius_m, config.wheels.ticks_per_rev)
    kind = train.turns[:, 3]
    tested = config.pose is not None and config.pose.use == "truth"  # test images with a pose, and none after turns
    used = (train.observation, train.turn_image, test.observation, *(() if tested else (test.turn_image,)))
    return {
        "wheels_topic": config.wheels.topic,
        "camera_topic": source.topic,
        "pose_topic": config.pose.topic if config.pose else None,
        "offset_s": {topic: round(offset_s, 6) for topic, offset_s in drive.clocks.offset_s.items()},
        "start_ns": drive.clocks.start_ns,
        "duration_s": round(float(np.ptp(drive.driven.wheels.time_s)), 3),
        "camera": {
            **asdict(source.unwrap.camera),
            **config.camera.model_dump(include={"height_m", "forward_deg", "mirrored"}),
        },
        "images": len(drive.image_s),
        "images_used": sum(map(len, used)),
        "held_out": len(test.observation),
        "segments": len(np.unique(train.reading[:, 0])),
        "segments_m": measure_driven(train.reading[:, 0], travelled_m.mean(axis=1)),
        "turns": {name: int((kind == number).sum()) for number, name in enumerate(KINDS)},
        "turns_seen": len(train.turn_image),
        "left_out": {name: drive.driven.sum_up(name) for name in OTHER_MOTIONS},
    }


def write_summary(about: Mapping[str, Any]) -> str:
    """What an import found and left out, as text of some lines."""
    out = "{count} {name} ({metres:.1f} m, {seconds:.0f} s)"
    left_out = [out.format(name=name, **about["left_out"][kind]) for kind, name in OTHER_MOTIONS.items()]
    lines = [
        f"{about['segments']} segments, {about['segments_m']:.1f} m, in {about['duration_s']:.0f} s; "
        f"{about['turns']['in_place']} turns in place, {about['turns_seen']} of them seen before and after",
        f"images: {about['images']} in the log, {about['images_used']} used, {about['held_out']} of these held out",
        f"left out: {', '.join(left_out)}",
        f"wheels {1000 * about['lag_s']:.0f} ms later than images",
        *(f"note: {note}" for note in about["notes"]),
    ]
    return "\n".join(lines)
