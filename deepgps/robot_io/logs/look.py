"""What a log holds, as comments of a ``robot.yaml`` that is proposed for it: the text is such a file as it is."""

from array import array
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from deepgps.robot_io.logs import plain_folder
from deepgps.robot_io.logs.camera import CAMERA_INFO, read_info
from deepgps.robot_io.logs.clocks import find_fault, take_logged, take_times
from deepgps.robot_io.logs.containers import Log, open_log
from deepgps.robot_io.logs.messages import GAP_S, JOINT_STATE, ODOMETRY, POSE_KINDS
from deepgps.robot_io.logs.pictures import COMPRESSED_IMAGE, RAW_IMAGE, decoder
from deepgps.robot_io.logs.sample import Part, Sample
from deepgps.terminal.progress import Report
from sim.errors import InputError, shorten

FIRST_MESSAGES = 50  # Messages of a topic that are decoded
TURTLEBOT3 = ("wheel_left_joint", "wheel_right_joint")
BURGER = {"radius_m": 0.033, "track_m": 0.16}
DECODED_TYPES = (JOINT_STATE, CAMERA_INFO, RAW_IMAGE, COMPRESSED_IMAGE)
DESCRIBED_TYPES = (*DECODED_TYPES, ODOMETRY, *POSE_KINDS)  # Types of which more is said than the number of messages


@dataclass
class Seen:
    """What was seen of a topic."""

    kind: str  # Its type
    log_ns: array = field(default_factory=lambda: array("q"))  # When each message was logged (n,) [ns]
    stamp_ns: array = field(default_factory=lambda: array("q"))  # Its stamp (n,) [ns]; 0: none
    details: dict[str, None] = field(default_factory=dict)  # What its first messages say
    names: dict[str, None] = field(default_factory=dict)  # Names of joints
    calibrated: bool = False  # Whether there is a calibration that can be used
    size: tuple[int, ...] = ()  # Width and height of the first image [px]; empty: there is none


def look(path: Path, progress: Report) -> str:
    """Read a log and describe it.

    Args:
        path: The log.
        progress: Called with the messages read.

    Returns:
        A ``robot.yaml`` with what was found as comments.

    Raises:
        InputError: It is no log.
    """
    with open_log(path) as log:
        seen = {topic: Seen(kind) for topic, kind in sorted(log.types.items())}

        def take(sample: Sample, part: Part) -> None:
            one = seen[sample.topic]
            one.log_ns.append(sample.log_ns)
            one.stamp_ns.append(sample.stamp_ns)
            if len(one.log_ns) <= FIRST_MESSAGES and one.kind in DECODED_TYPES:
                _take_details(one, part.decode(sample))

        log.feed(dict.fromkeys(seen, take), progress, "look")
        lines = [f"# {shorten(str(path), 300)}", *(f"# note: {note}" for note in log.notes), "#"]
        for topic, one in seen.items():
            lines += [f"# {line}" for line in _describe(topic, one)]
        plain = plain_folder.is_plain(path)
        verdict, clocks = _judge_clocks(seen)
        return "\n".join([*lines, "#", f"# clocks: {verdict}", "#", *_propose(log, seen, plain), f"clocks: {clocks}"])


def _take_details(one: Seen, message: Any) -> None:
    if one.kind == JOINT_STATE:
        one.names.update(dict.fromkeys(message.name))
    elif one.kind == CAMERA_INFO:
        one.details[_describe_info(one, message)] = None
    elif not one.details:
        said = message.encoding if one.kind == RAW_IMAGE else f"format {message.format!r}"
        try:
            height, width = decoder(one.kind)(message).shape[:2]
            one.details[f"{said}, {width} x {height} px"] = None
            one.size = width, height
        except InputError as error:
            one.details[f"{said}: {error}"] = None


def _describe_info(one: Seen, message: Any) -> str:
    try:
        camera = read_info(message)
    except InputError as error:
        return f"cannot be used: {error}"
    if camera is None:
        return "not calibrated: K is 0"
    one.calibrated = True
    numbers = ", ".join(f"{value:.6g}" for value in (*camera.focal, *camera.centre))
    return f"{camera.model}, {camera.size[0]} x {camera.size[1]} px, fx fy cx cy {numbers}"


def _describe(topic: str, one: Seen) -> list[str]:
    """Lines on a topic: its type and number of messages, their rate, gaps, order and clock, and what they hold."""
    count = len(one.log_ns)
    lines = [f"{topic}  {one.kind}  {count} messages"]
    if one.kind not in DESCRIBED_TYPES:
        return lines
    if count > 1:
        time_s = np.array(one.log_ns) * 1e-9
        steps = np.diff(np.sort(time_s))
        typical = float(np.median(steps))
        rate = f"{1 / typical:.1f} Hz" if typical > 0 else "all at once"
        lines.append(f"    {rate}, {np.ptp(time_s):.1f} s, longest gap {steps.max():.2f} s")
    stamp = np.array(one.stamp_ns, np.int64)
    if count and stamp.any():
        late = (np.array(one.log_ns) - stamp)[stamp != 0] * 1e-9
        disordered = int((np.diff(stamp[stamp != 0]) < 0).sum())
        lines.append(
            f"    logged {np.median(late):+.4f} s after its stamp, in the median; {int((stamp == 0).sum())} without "
            f"stamp, {disordered} out of order"
        )
    lines += [f"    {detail}" for detail in one.details]
    return [*lines, *([f"    joints: {', '.join(one.names)}"] if one.names else [])]


def _propose(log: Log, seen: dict[str, Seen], plain: bool) -> list[str]:
    """The lines of a proposed ``robot.yaml``."""
    wheels, camera, pose = _find_wheels(seen), _find_camera(seen), _find_pose(seen)
    lines = ["wheels:"]
    left, right = (plain_folder.JOINTS if plain else _find_joints(seen[wheels])) if wheels else TURTLEBOT3
    lines += [f"  topic: {wheels or '/joint_states  # no JointState or Odometry is in the log'}"]
    if wheels is None or seen[wheels].kind == JOINT_STATE:
        lines += [f"  left: {left}", f"  right: {right}"]
    known = "TurtleBot3 Burger; measure your robot's"
    lines += [f"  radius_m: {BURGER['radius_m']}  # {known}", f"  track_m: {BURGER['track_m']}  # {known}"]
    lines += ["  lag_s: estimate  # or a number, such as 0.05 for TurtleBot3", "camera:"]
    lines += [f"  topic: {camera or '/camera/image_raw  # no Image or CompressedImage is in the log'}"]
    info = _find_info(seen, camera)
    if info:
        lines += [f"  info: {info}"]
    else:
        radius = min(seen[camera].size) // 2 if camera and seen[camera].size else 240
        lines += [f"  circle_px: {radius}  # no calibration is in the log: radius of the round picture"]
        lines += ["  field_of_view_deg: 185  # of the lens; or give file or intrinsics for both"]
    lines += ["  height_m: 0.35  # of the lens above the floor", "  forward_deg: 0  # the robot's front in the image"]
    if pose:
        lines += ["pose:", f"  topic: {pose}", "  use: truth"]
    return lines


def _find_wheels(seen: dict[str, Seen]) -> str | None:
    """The topic with most messages on two joints or more, otherwise an odometry."""
    some = [topic for topic, one in seen.items() if one.kind == JOINT_STATE and one.log_ns]
    best = sorted(some, key=lambda topic: (_has_wheels(seen[topic]), len(seen[topic].log_ns)))
    odometry = [topic for topic, one in seen.items() if one.kind == ODOMETRY and one.log_ns]
    return next(iter([*best[::-1], *odometry]), None)


def _has_wheels(one: Seen) -> bool:
    return any("wheel" in name for name in one.names)


def _find_joints(one: Seen) -> tuple[str, str]:
    """Names of the wheels' joints, without a prefix."""
    names = sorted(one.names, key=lambda name: "wheel" not in name)
    left = next((name for name in names if "left" in name), TURTLEBOT3[0])
    right = next((name for name in names if "right" in name), TURTLEBOT3[1])
    return left.rpartition("/")[2], right.rpartition("/")[2]


def _find_camera(seen: dict[str, Seen]) -> str | None:
    """The topic with most images that are no depths."""
    images = [topic for topic, one in seen.items() if one.kind in {RAW_IMAGE, COMPRESSED_IMAGE} and one.log_ns]
    some = [topic for topic in images if "depth" not in topic.lower()]
    return max(some, key=lambda topic: len(seen[topic].log_ns), default=None)


def _find_info(seen: dict[str, Seen], camera: str | None) -> str | None:
    """The calibrated CameraInfo that shares most of its name with the camera."""
    some = [topic for topic, one in seen.items() if one.kind == CAMERA_INFO and one.calibrated]

    def share(topic: str) -> int:
        same = [a == b for a, b in zip(topic.split("/"), (camera or "").split("/"), strict=False)]
        return (same + [False]).index(False)

    return max(some, key=share, default=None)


def _find_pose(seen: dict[str, Seen]) -> str | None:
    """A topic of poses that does not come from the wheels."""
    times = {topic: np.sort(one.log_ns) for topic, one in seen.items() if one.kind in POSE_KINDS[:3]}
    often = [topic for topic, ns in times.items() if len(ns) > 1 and np.median(np.diff(ns)) <= GAP_S * 1e9]
    return max(often, key=lambda topic: len(times[topic]), default=None)  # a goal is sent seldom


def _judge_clocks(seen: dict[str, Seen]) -> tuple[str, str]:
    """The verdict on the clocks of wheels, camera and poses, in words, and the setting that it asks for."""
    topics = [topic for topic in (_find_wheels(seen), _find_camera(seen), _find_pose(seen)) if topic]
    if not topics:
        return "no wheels and no camera", "checked"
    times, _, _ = take_times({topic: (seen[topic].log_ns, seen[topic].stamp_ns) for topic in topics})
    fault, unfit = find_fault(times), next(filter(None, (take_logged(one)[1] for one in times)), None)
    if fault is None:
        return f"one clock, without jumps, for {', '.join(topics)}", "checked"
    return (f"{fault}; {unfit}", "checked") if unfit else (f"{fault}; the times of logging advance evenly", "logged")
