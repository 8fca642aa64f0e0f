"""The wheels' angles and the poses in a log: joint states, the path of an odometry, motion capture."""

import math
from typing import Any

import numpy as np

from deepgps.robot_io.logs.containers import Log
from deepgps.robot_io.logs.robot_config import WheelConfig
from deepgps.robot_io.logs.sample import Heard, Sample
from sim.errors import InputError, quote
from sim.geometry import wrap

JOINT_STATE, ODOMETRY = "sensor_msgs/msg/JointState", "nav_msgs/msg/Odometry"
MIN_LENGTH = 1e-6  # Length of a quaternion up to which it tells no orientation
MAX_ASIDE_M = (
    0.004  # Way aside between two messages of an odometry from which it jumps, if it is half of that ahead [m]
)
MAX_SIDEWAYS_SHARE = 0.2  # Part of an odometry's path that may go sideways; more, and its orientation is wrong
POSE_KINDS = (
    *(f"geometry_msgs/msg/{name}" for name in ("PoseStamped", "PoseWithCovarianceStamped", "TransformStamped")),
    ODOMETRY,
)


class PoseLog(Heard):
    """The poses of a log."""

    LEFT_OUT = "the position or the quaternion is not finite, or the quaternion is 0"

    @property
    def pose(self) -> np.ndarray:
        """Poses (n, 3) x, y [m], yaw [rad]."""
        return np.array(self._values).reshape(-1, 3)

    def read(self, sample: Sample) -> tuple[float, ...] | None:
        """The pose in a message of any of the types; None: it tells none."""
        message = sample.decode()
        if hasattr(message, "transform"):
            place, turn = message.transform.translation, message.transform.rotation
        else:
            inner = message.pose.pose if hasattr(message.pose, "pose") else message.pose
            place, turn = inner.position, inner.orientation
        pose = float(place.x), float(place.y), read_yaw(turn)
        return pose if all(map(math.isfinite, pose)) else None


def read_yaw(turn: Any) -> float:
    """Yaw of a quaternion message [rad], of any length; NaN if it is 0, which some drivers send for no orientation."""
    w, x, y, z = (float(getattr(turn, axis)) for axis in "wxyz")
    length = math.hypot(w, x, y, z)
    if not length > MIN_LENGTH:
        return math.nan
    w, x, y, z = w / length, x / length, y / length, z / length
    return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


class OdometryLog(PoseLog):
    """Wheels that drive an odometry's path."""

    def __init__(self, config: WheelConfig) -> None:
        super().__init__(config.topic)
        self.config = config

    def follow(self) -> tuple[np.ndarray, np.ndarray]:
        """How far the robot went from each pose to the next, ahead and to the left as complex numbers (n - 1,) [m] in
        the mean heading of both, and its turns (n - 1,) [rad]."""
        x, y, yaw = self.pose.T
        turn = wrap(np.diff(yaw))
        return np.diff(x + 1j * y) * np.exp(-1j * (yaw[:-1] + turn / 2)), turn

    @property
    def angle(self) -> np.ndarray:
        """Angles of the wheels (n, 2) [rad]."""
        step, turn = self.follow()
        apart = turn * self.config.track_m / 2
        rim = np.cumsum(np.column_stack([step.real - apart, step.real + apart]), axis=0)
        return np.concatenate([np.zeros((min(len(self.pose), 1), 2)), rim / self.config.radius_m])

    def list_notes(self) -> list[str]:
        """What the user should know of the messages."""
        notes = [f"{self.topic}: wheels are computed from the odometry, so they cannot be diagnosed"]
        step, _ = self.follow()
        aside_m = np.abs(step.imag)
        jumps = aside_m > np.maximum(MAX_ASIDE_M, np.abs(step.real) / 2)
        if jumps.any() or aside_m.sum() > MAX_SIDEWAYS_SHARE * np.abs(step).sum():
            how = f"{jumps.sum()} times, by up to {100 * aside_m.max():.1f} cm, as no wheels can"
            why = "is its orientation right, or is it corrected by other sensors?"
            notes.append(f"{self.topic}: the odometry jumps aside {how}: {why}")
        return [*super().list_notes(), *notes]


class JointLog(Heard):
    """The wheels of joint states; only positions are read, since TurtleBot3 writes m/s where the message promises
    rad/s."""

    LEFT_OUT = "they hold neither wheel"

    def __init__(self, config: WheelConfig) -> None:
        super().__init__(config.topic)
        self.config = config
        self._names = set[str]()  # Of all joints with positions

    @property
    def angle(self) -> np.ndarray:
        """Angles of the left and of the right wheel (n, 2) [rad]; NaN where a message lacks one."""
        sign = [-1.0 if self.config.backward in {side, "both"} else 1.0 for side in ("left", "right")]
        return np.array(self._values).reshape(-1, 2) * sign

    def read(self, sample: Sample) -> tuple[float, ...] | None:
        """The positions of both wheels in a message, NaN where it lacks one; None: it holds neither."""
        message = sample.decode()
        angle = {name: one for name, one in zip(message.name, message.position, strict=False) if math.isfinite(one)}
        self._names.update(angle)
        found = tuple(float(angle.get(name, math.nan)) for name in (self.config.left, self.config.right))
        return None if all(map(math.isnan, found)) else found

    def check(self) -> None:
        """Raise InputError unless there are positions of both wheels."""
        if self.without and not self._names:
            why = "positions are empty or nan in all messages, and the wheels' angles are needed"
            raise InputError(f"{self.topic}: {why}")
        names, angle = (self.config.left, self.config.right), self.angle
        for name, one in zip(names, angle.T, strict=True):
            if self._names and np.isnan(one).all():
                there = ", ".join(sorted(self._names)[:12])
                raise InputError(f"{self.topic} has no position of a joint {quote(name)}; its joints are {there}")
        super().check()
        turns = np.nanmax(angle, axis=0) > np.nanmin(angle, axis=0)
        if turns[0] != turns[1]:
            raise InputError(
                f"{self.topic}: the joint {quote(names[int(turns[0])])} never turns, and the other one does"
            )


def open_wheels(log: Log, config: WheelConfig) -> JointLog | OdometryLog:
    """Prepare to read the wheels of a log; raises InputError if it lacks the topic, or an odometry is reversed."""
    if log.check_topic(config.topic, "wheels.topic", (JOINT_STATE, ODOMETRY)) == JOINT_STATE:
        return JointLog(config)
    if config.backward != "none":
        raise InputError(f"wheels.backward {config.backward} must be none: {config.topic} is an odometry")
    return OdometryLog(config)
