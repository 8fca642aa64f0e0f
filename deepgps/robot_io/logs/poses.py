"""Poses in a log, such as those of motion capture, and what they are at the times of images."""

import math
from array import array
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from deepgps.robot_io.logs.containers import Log
from deepgps.robot_io.logs.joints import UNUSABLE, read_yaw
from deepgps.robot_io.logs.sample import Part, Sample
from sim.errors import InputError
from sim.geometry import wrap

KINDS = (
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/TransformStamped",
    "nav_msgs/msg/Odometry",
)
GAP_S = 0.5
"""Longest time between two poses across which they are interpolated [s]."""


@dataclass
class PoseLog:
    """Poses in the order in which they were logged.

    Attributes:
        log_ns: When each was logged (n,) [ns].
        stamp_ns: Its stamp (n,) [ns]; 0: none.
        values: x, y [m] and yaw [rad] of each, one after the other.
        without: Messages that tell no pose and are left out.
    """

    log_ns: array = field(default_factory=lambda: array("q"))
    stamp_ns: array = field(default_factory=lambda: array("q"))
    values: array = field(default_factory=lambda: array("d"))
    without: int = 0

    @property
    def pose(self) -> np.ndarray:
        """Poses (n, 3) x, y [m], yaw [rad]."""
        return np.array(self.values).reshape(-1, 3)

    def take(self, sample: Sample, part: Part) -> None:
        """Read a message; one that tells no pose is only counted."""
        pose = _take(part.decode(sample))
        if not all(map(math.isfinite, pose)):
            self.without += 1
            return
        self.log_ns.append(sample.log_ns)
        self.stamp_ns.append(sample.stamp_ns)
        self.values.extend(pose)

    def check(self, topic: str) -> None:
        """Raise InputError if there is no pose."""
        if not self.log_ns:
            why = f": in {self.without} messages {UNUSABLE}" if self.without else ""
            raise InputError(f"pose.topic {topic} holds no pose{why}")


def open_poses(log: Log, topic: str) -> PoseLog:
    """Prepare to read the poses of a topic; raises InputError if there is no such topic."""
    log.check_topic(topic, "pose.topic", KINDS)
    return PoseLog()


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


def _take(message: Any) -> tuple[float, float, float]:
    """x, y [m] and yaw [rad] of a message of any of the types."""
    if hasattr(message, "transform"):
        place, turn = message.transform.translation, message.transform.rotation
    else:
        pose = message.pose.pose if hasattr(message.pose, "pose") else message.pose
        place, turn = pose.position, pose.orientation
    return float(place.x), float(place.y), read_yaw(turn)
