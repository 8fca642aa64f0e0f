"""The wheels' angles and the poses in a log: joint states, the path of an odometry, motion capture."""

import math
from array import array
from collections.abc import Sequence
from typing import Any

import numpy as np

from deepgps.robot_io.logs.containers import Log
from deepgps.robot_io.logs.robot_config import WheelConfig
from deepgps.robot_io.logs.sample import Heard, Part, Sample
from sim.errors import InputError, quote
from sim.geometry import wrap

JOINT_STATE, ODOMETRY = "sensor_msgs/msg/JointState", "nav_msgs/msg/Odometry"
WHEEL_KINDS = (JOINT_STATE, ODOMETRY)
MIN_LENGTH = 1e-6  # Length of a quaternion up to which it tells no orientation
MAX_SIDEWAYS_SHARE = 0.2  # Part of an odometry's path that may go sideways; more, and its orientation is wrong
UNUSABLE_NOTE = "the position or the quaternion is not finite, or the quaternion is 0"  # Why a pose is left out
POSE_KINDS = (
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/TransformStamped",
    "nav_msgs/msg/Odometry",
)
GAP_S = 0.5  # Longest time between two poses across which they are interpolated [s]


class WheelLog(Heard):
    """The wheels of a log; only positions are read, since TurtleBot3 writes m/s where the message promises rad/s."""

    def __init__(self, config: WheelConfig, from_odometry: bool) -> None:
        super().__init__(config.topic)
        self.config, self.from_odometry = config, from_odometry
        self.values = array("d")  # Angles of the left and of the right wheel [rad], in turn; NaN where one is missing
        self.without = 0  # Messages without any wheel
        self.names = set[str]()  # Names of all joints
        self.speeds_only = True  # Whether no message of joints holds a position
        self._path = OdometryPath(config.radius_m, config.track_m)

    @property
    def angle(self) -> np.ndarray:
        """Angles (n, 2) [rad]."""
        return np.array(self.values).reshape(-1, 2)

    def take(self, sample: Sample, part: Part) -> None:
        """Read a message; one without any wheel is only counted."""
        message = part.decode(sample)
        left, right = self._path.follow(message.pose.pose) if self.from_odometry else self._find(message)
        if math.isnan(left) and math.isnan(right):
            self.without += 1
            return
        super().take(sample, part)
        self.values.extend((left, right))

    def list_notes(self) -> list[str]:
        """What the user should know of the messages."""
        notes, path = [], self._path
        if self.without:
            why = f"are left out: {UNUSABLE_NOTE}" if self.from_odometry else "hold neither wheel"
            notes.append(f"{self.topic}: {self.without} messages {why}")
        if self.from_odometry:
            notes.append(f"{self.topic}: wheels are computed from the odometry, so they cannot be diagnosed")
        if path.sideways_m > MAX_SIDEWAYS_SHARE * path.distance_m:
            notes.append(f"{self.topic}: the odometry goes sideways, as no wheels can: is its orientation right?")
        return notes

    def check(self) -> None:
        """Raise InputError unless there are positions of both wheels."""
        if not self.names and not self.log_ns:
            why = f": in {self.without} messages {UNUSABLE_NOTE}" if self.without else ""
            raise InputError(f"{self.topic} holds no message of wheels{why}")
        if not self.from_odometry and self.speeds_only:
            raise InputError(f"{self.topic}: positions are empty in all messages, and the wheels' angles are needed")
        known = [bool(np.isfinite(wheel).any()) for wheel in self.angle.T]
        for name, has in zip((self.config.left, self.config.right), known, strict=True):
            if not has:
                there = ", ".join(sorted(self.names)[:12])
                raise InputError(f"{self.topic} has no position of a joint {quote(name)}; its joints are {there}")

    def _find(self, message: Any) -> tuple[float, float]:
        self.names.update(message.name)
        self.speeds_only &= not len(message.position)
        left, right = (self._take_angle(message, name) for name in (self.config.left, self.config.right))
        backward = self.config.backward
        return -left if backward in {"left", "both"} else left, -right if backward in {"right", "both"} else right

    def _take_angle(self, message: Any, wanted: str) -> float:
        """The position of a joint in a message, which may hold only some joints or no positions; NaN: not there."""
        index = find_joint(message.name, wanted, self.topic)
        value = float(message.position[index]) if index < len(message.position) else math.nan
        return value if math.isfinite(value) else math.nan


def open_wheels(log: Log, config: WheelConfig) -> WheelLog:
    """Prepare to read the wheels of a log; raises InputError if it lacks the topic, or an odometry is reversed."""
    from_odometry = log.check_topic(config.topic, "wheels.topic", WHEEL_KINDS) == ODOMETRY
    if from_odometry and config.backward != "none":
        raise InputError(f"wheels.backward {config.backward} must be none: {config.topic} is an odometry")
    return WheelLog(config, from_odometry)


def find_joint(names: Sequence[str], wanted: str, topic: str) -> int:
    """Index of a joint by its name or the end of its name after a prefix such as ``tb3_0/``; beyond the last: none.

    Raises:
        InputError: Two joints of the topic have such names.
    """
    same = [index for index, name in enumerate(names) if name == wanted]
    like = same or [index for index, name in enumerate(names) if name.endswith((f"/{wanted}", f".{wanted}"))]
    if len(like) > 1:
        raise InputError(
            f"{topic}: {wanted}: several joints have this name, {', '.join(names[index] for index in like)}; give the "
            "complete name in wheels.left and wheels.right"
        )
    return like[0] if like else len(names)


class OdometryPath:
    """Angles of wheels that drive an odometry's path; each step is projected on the mean heading of its ends.

    Attributes:
        distance_m: Length of the path [m].
        sideways_m: What of it goes sideways, as no two wheels can drive [m].
    """

    def __init__(self, radius_m: float, track_m: float) -> None:
        self._radius_m, self._track_m = radius_m, track_m
        self._before: tuple[float, float, float] | None = None
        self._travelled = self._turned = 0.0
        self.distance_m = self.sideways_m = 0.0

    def follow(self, pose: Any) -> tuple[float, float]:
        """Angles of the left and of the right wheel [rad] at the next pose's message; NaN if it is not finite."""
        x, y, yaw = float(pose.position.x), float(pose.position.y), read_yaw(pose.orientation)
        if not all(map(math.isfinite, (x, y, yaw))):
            return math.nan, math.nan
        if self._before is not None:
            turn = float(wrap(yaw - self._before[2]))
            heading = self._before[2] + turn / 2
            step_x, step_y = x - self._before[0], y - self._before[1]
            self._travelled += step_x * math.cos(heading) + step_y * math.sin(heading)
            self._turned += turn
            self.distance_m += math.hypot(step_x, step_y)
            self.sideways_m += abs(step_y * math.cos(heading) - step_x * math.sin(heading))
        self._before = x, y, yaw
        ahead, apart = self._travelled / self._radius_m, self._turned * self._track_m / 2 / self._radius_m
        return ahead - apart, ahead + apart


def read_yaw(turn: Any) -> float:
    """Yaw of a quaternion message [rad], of any length; NaN if it is 0, which some drivers send for no orientation."""
    w, x, y, z = (float(getattr(turn, axis)) for axis in "wxyz")
    length = math.hypot(w, x, y, z)
    if not length > MIN_LENGTH:
        return math.nan
    w, x, y, z = w / length, x / length, y / length, z / length
    return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


class PoseLog(Heard):
    """The poses of a log."""

    def __init__(self, topic: str) -> None:
        super().__init__(topic)
        self.values = array("d")  # x, y [m] and yaw [rad] of each, one after the other
        self.without = 0  # Messages that tell no pose and are left out

    @property
    def pose(self) -> np.ndarray:
        """Poses (n, 3) x, y [m], yaw [rad]."""
        return np.array(self.values).reshape(-1, 3)

    def take(self, sample: Sample, part: Part) -> None:
        """Read a message of any of the types; one that tells no pose is only counted."""
        message = part.decode(sample)
        if hasattr(message, "transform"):
            place, turn = message.transform.translation, message.transform.rotation
        else:
            inner = message.pose.pose if hasattr(message.pose, "pose") else message.pose
            place, turn = inner.position, inner.orientation
        pose = float(place.x), float(place.y), read_yaw(turn)
        if not all(map(math.isfinite, pose)):
            self.without += 1
            return
        super().take(sample, part)
        self.values.extend(pose)

    def check(self) -> None:
        """Raise InputError if there is no pose."""
        if not self.log_ns:
            why = f": in {self.without} messages {UNUSABLE_NOTE}" if self.without else ""
            raise InputError(f"pose.topic {self.topic} holds no pose{why}")


def open_poses(log: Log, topic: str) -> PoseLog:
    """Prepare to read the poses of a topic; raises InputError if there is no such topic."""
    log.check_topic(topic, "pose.topic", POSE_KINDS)
    return PoseLog(topic)


def find_poses(time_s: np.ndarray, pose: np.ndarray, at_s: np.ndarray) -> np.ndarray:
    """Poses (m, 3) at some times (m,) [s], interpolated; NaN where none was measured within half a second.

    Args:
        time_s: Times of the poses (n,) [s]; NaN where they are not known.
        pose: Poses (n, 3) x, y [m], yaw [rad].
        at_s: The times.
    """
    order = np.argsort(time_s, kind="stable")
    order = order[np.isfinite(time_s[order])]
    time_s, pose = time_s[order], pose[order]
    if not len(time_s):
        return np.full((len(at_s), 3), np.nan)
    columns = [pose[:, 0], pose[:, 1], np.unwrap(pose[:, 2])]
    found = np.column_stack([np.interp(at_s, time_s, values) for values in columns])
    found[:, 2] = wrap(found[:, 2])
    after = np.searchsorted(time_s, at_s)
    inside = (after > 0) & (after < len(time_s))
    before, after = np.clip(after - 1, 0, None), np.clip(after, None, len(time_s) - 1)
    found[~(inside & (time_s[after] - time_s[before] <= GAP_S))] = np.nan
    return found
