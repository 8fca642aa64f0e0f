"""What a log holds, as comments of a ``robot.yaml`` whose values come from the log or are left open."""

import re
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from deepgps.robot_io.logs.camera import CAMERA_INFO, read_info
from deepgps.robot_io.logs.clocks import choose_times
from deepgps.robot_io.logs.containers import open_log
from deepgps.robot_io.logs.drive import POSE_GAP_S
from deepgps.robot_io.logs.messages import JOINT_STATE, ODOMETRY, POSE_KINDS
from deepgps.robot_io.logs.pictures import KINDS as IMAGES
from deepgps.robot_io.logs.pictures import decode_image
from deepgps.robot_io.logs.sample import Heard, Sample
from deepgps.terminal.progress import Report
from sim.errors import InputError, shorten

FIRST_MESSAGES = 50  # Messages of a topic that are decoded
DECODED_TYPES = (JOINT_STATE, CAMERA_INFO, *IMAGES)
SIDES = {"left": "right", "l": "r", "lh": "rh", "fl": "fr", "rl": "rr"}
"""What names a left wheel, and the right one beside it."""
OTHER_ODOMETRY = re.compile(
    r"cam|t265|realsense|zed|vi(o|sual)|rf2o|icp|laser|lidar|lio|loam|kiss|scan|slam|map|filter|[eu]kf|fus|combin|local|global|gps|imu",
    re.I,
)
"""Names of odometries that are not of the wheels alone."""
COUNTS = re.compile(r"Encoder|Ticks?\b|/U?Int(16|32|64)")


class Seen(Heard):
    """What was seen of a topic."""

    def __init__(self, topic: str, kind: str) -> None:
        super().__init__(topic)
        self.kind = kind  # Its type
        self.details = dict[str, None]()  # What its first messages say
        self.names = dict[str, None]()  # Names of joints whose positions are there
        self.calibrated = False  # Whether there is a calibration that can be used
        self.size: tuple[int, ...] = ()  # Width and height of the first image [px]; empty: there is none

    def read(self, sample: Sample) -> tuple[float, ...] | None:
        if len(self.log_ns) < FIRST_MESSAGES and self.kind in DECODED_TYPES:
            try:
                if said := self._describe(sample.decode()):
                    self.details[said] = None
            except InputError as error:
                self.details[f"cannot be used: {error}"] = None
        return ()

    def _describe(self, message: Any) -> str | None:
        if self.kind == JOINT_STATE:
            there = [name for name, one in zip(message.name, message.position, strict=False) if np.isfinite(one)]
            self.names.update(dict.fromkeys(there))
            return f"joints{'' if there else ' without positions'}: {', '.join(message.name)}"
        if self.kind == CAMERA_INFO:
            if (camera := read_info(message)) is None:
                return "not calibrated: K is 0"
            self.calibrated = True
            numbers = ", ".join(f"{value:.6g}" for value in (*camera.focal, *camera.centre))
            return f"{camera.model}, {camera.size[0]} x {camera.size[1]} px, fx fy cx cy {numbers}"
        if self.size:
            return None
        height, width = decode_image(message).shape[:2]
        self.size = width, height
        said = getattr(message, "encoding", None) or f"format {message.format!r}"
        return f"{said}, {width} x {height} px"

    @property
    def period_s(self) -> float:
        """Usual time between messages [s]."""
        return float(np.median(np.diff(sorted(self.log_ns)))) * 1e-9 if len(self.log_ns) > 1 else np.inf

    def describe(self) -> list[str]:
        """Lines on the topic: its type, number of messages, rate, gaps, order, clock, and what they hold."""
        lines = [f"{self.topic}  {self.kind}  {len(self.log_ns)} messages"]
        if self.kind not in (*DECODED_TYPES, *POSE_KINDS) or not self.log_ns:
            return lines
        log, stamp = np.array(self.log_ns), np.array(self.stamp_ns)
        if len(log) > 1:
            rate = f"{1 / self.period_s:.1f} Hz" if self.period_s > 0 else "all at once"
            gap_s = np.diff(np.sort(log)).max() * 1e-9
            lines.append(f"    {rate}, {np.ptp(log) * 1e-9:.1f} s, longest gap {gap_s:.2f} s")
        if (known := stamp != 0).any():
            late_s, disordered = np.median((log - stamp)[known]) * 1e-9, int((np.diff(stamp[known]) < 0).sum())
            others = f"{int((~known).sum())} without stamp, {disordered} out of order"
            lines.append(f"    logged {late_s:+.4f} s after its stamp, in the median; {others}")
        return [*lines, *(f"    {detail}" for detail in self.details)]


def look(path: Path, progress: Report) -> str:
    """A ``robot.yaml`` for a log, with what the log holds as comments; raises InputError if it is none."""
    with open_log(path) as log:
        seen = [Seen(topic, kind) for topic, kind in sorted(log.types.items())]
        log.feed(seen, progress, "look")
        lines = [f"{shorten(str(path), 300)}", *(f"note: {note}" for note in log.notes), ""]
        lines += [line for one in seen for line in one.describe()]
    some = [one for one in seen if one.log_ns]
    wheels = _find_wheels(some)
    camera = _find_most(one for one in some if one.kind in IMAGES and "depth" not in one.topic.lower())
    pose = _find_most(
        one for one in some if one.kind in POSE_KINDS[:3] and one.period_s <= POSE_GAP_S
    )  # goals are rare
    verdict, clocks = _judge_clocks([one for one in (wheels, camera, pose) if one])
    proposed = [*_write_wheels(some, wheels), *_write_camera(some, camera)]
    proposed += ["pose:", f"  topic: {pose.topic}", "  use: truth"] if pose else []
    return "\n".join([*(f"# {line}".rstrip() for line in [*lines, "", *verdict, ""]), *proposed, f"clocks: {clocks}"])


def _find_wheels(seen: Sequence[Seen]) -> Seen | None:
    """The joints with a left and a right one, of wheels, with most messages; otherwise the wheels' odometry."""
    joints = [one for one in seen if one.kind == JOINT_STATE and len(one.names) > 1]
    if joints:
        return max(joints, key=lambda one: (bool(_pair_joints(one)), "wheel" in str(one.names), len(one.log_ns)))
    # a camera's or another sensor's, by its name or its neighbours, is not of the wheels
    cameras = {one.topic.rpartition("/")[0] for one in seen if one.kind in (*IMAGES, CAMERA_INFO)} - {""}
    own = [one for one in seen if one.kind == ODOMETRY and one.topic.rpartition("/")[0] not in cameras]
    own = [one for one in own if not OTHER_ODOMETRY.search(one.topic)]
    return max(own, key=lambda one: (one.topic == "/odom", len(one.log_ns)), default=None)


def _pair_joints(one: Seen) -> list[tuple[str, str]]:
    """Left and right joints whose names are alike but for the side, wheels first."""
    pairs = []
    for name in one.names:
        words = re.split(r"([^a-zA-Z]+)", name)
        for place, word in enumerate(words):
            if side := SIDES.get(word.lower()):
                other = "".join([*words[:place], side, *words[place + 1 :]]).lower()
                pairs += [(name, match) for match in one.names if match.lower() == other]
    return sorted(pairs, key=lambda pair: "wh" not in pair[0].lower())


def _write_wheels(seen: Sequence[Seen], wheels: Seen | None) -> list[str]:
    """The lines on the wheels."""
    lines, others = ["wheels:"], [one.topic for one in seen if one.kind == ODOMETRY and one is not wheels]
    if wheels is None:
        lines.append("  topic:  # no positions of joints and no odometry of wheels are in the log")
        for one in (one for one in seen if COUNTS.search(one.kind)):
            lines.append(f"  # {one.topic} may be an encoder's counts: write wheels.csv of a folder of plain files")
        lines += [f"  # {topic} is no odometry of wheels alone" for topic in others]
    elif wheels.kind == ODOMETRY:
        other = f", not {', '.join(others)}" if others else ""
        lines.append(f"  topic: {wheels.topic}  # it must be of the wheels alone{other}")
    else:
        pairs, names = _pair_joints(wheels), ", ".join(wheels.names)
        more = f"  # or {', '.join(left for left, _ in pairs[1:])}" if len(pairs) > 1 else ""
        sides = (f" {pairs[0][0]}{more}", f" {pairs[0][1]}") if pairs else (f"  # one of {names}",) * 2
        lines += [f"  topic: {wheels.topic}", f"  left:{sides[0]}", f"  right:{sides[1]}"]
    return [
        *lines,
        "  radius_m:  # of the wheels: measure it (TurtleBot3: 0.033)",
        "  track_m:  # between the wheels: measure it (TurtleBot3 Burger: 0.16)",
        "  lag_s: estimate",
    ]


def _write_camera(seen: Sequence[Seen], camera: Seen | None) -> list[str]:
    """The lines on the camera."""
    topic = camera.topic if camera else " # no Image or CompressedImage is in the log"
    lines, infos = ["camera:", f"  topic: {topic}"], [one.topic for one in seen if one.calibrated]
    if infos:
        lines.append(f"  info: {max(infos, key=lambda info: len({*info.split('/')} & {*topic.split('/')}))}")
    else:
        most = f", at most {min(camera.size) // 2}" if camera and camera.size else ""
        lines.append(f"  circle_px:  # no calibration can be used: radius of the round picture{most}, or give file")
        lines.append("  field_of_view_deg:  # of the lens, in this circle")
    return [*lines, "  height_m:  # of the lens above the floor", "  forward_deg:  # the robot's front in the image"]


def _find_most(seen: Iterable[Seen]) -> Seen | None:
    return max(seen, key=lambda one: len(one.log_ns), default=None)


def _judge_clocks(heard: Sequence[Seen]) -> tuple[list[str], str]:
    """The verdict on the clocks of some topics, in words, and the setting that it asks for."""
    if not heard:
        return [], "checked"
    times = {one.topic: (one.log_ns, one.stamp_ns) for one in heard}
    try:
        choose_times(times, False)
    except InputError as fault:
        with suppress(InputError):
            choose_times(times, True)
            return [str(fault)], "logged"
        return [f"{fault}: the log will be refused"], "checked"
    return [f"one clock: {', '.join(times)}"], "checked"
