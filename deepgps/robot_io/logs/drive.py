"""The drive of a log: everything by one clock, and what the robot did by its wheels.

A message has two times: its header's stamp, by the clock of who sent it, and when it was logged, by the recorder's.
The stamps are used as they are if the clocks of both topics agree: the shortest delays, logged minus stamped, in
stretches of some seconds, differ by at most 50 ms. Otherwise they are refused, or aligned with the recorder's clock by
these delays. The shortest ones count, since messages may arrive in bursts, most of them late.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from deepgps.robot_io.logs.messages import UNUSABLE_NOTE, PoseLog, WheelLog, find_poses
from deepgps.robot_io.logs.pictures import ImageList
from deepgps.robot_io.logs.robot_config import RobotConfig
from deepgps.robot_io.logs.segmentation import Motion, Path, find_motions, find_path
from deepgps.robot_io.logs.wheels import Wheels, clean_wheels, fill_counts
from sim.errors import InputError

MAX_CLOCK_ERROR_S = 0.05  # Largest difference between clocks, and largest jump of one, that goes unnoticed [s]
STRETCH_S = 10.0  # Length of the stretches in which the shortest delays are found [s]
DELAY_PERCENTILE = 5  # Percentile of the delays in a stretch that counts as the shortest
MIN_JUMP_MESSAGES, MAX_JUMP_MESSAGES = 10, 60  # Fewest and most messages on each side of a jump that must show it
NS = 1e-9
MIN_CLOCK_RATE = 0.01
"""Stamps that advance by less than this part of the time of logging are none: constant, or in another unit."""


@dataclass(frozen=True)
class Times:
    """Times of a topic's messages, in the order in which they were logged."""

    topic: str  # The topic
    log_s: np.ndarray  # When each was logged (n,) [s], from the first message of the log
    stamp_s: np.ndarray  # Its stamp (n,) [s], from the first stamp of the log; NaN where it is missing

    @property
    def late_s(self) -> np.ndarray:
        """Logged minus stamped (n,) [s], but for a constant of the log."""
        return self.log_s - self.stamp_s

    @property
    def is_stamped(self) -> bool:
        """Whether most messages have a stamp, and stamps advance."""
        known = np.isfinite(self.stamp_s)
        if 2 * known.sum() <= len(known):
            return False
        stamped_s, logged_s = (np.ptp(np.percentile(values[known], (10, 90))) for values in (self.stamp_s, self.log_s))
        return bool(stamped_s >= MIN_CLOCK_RATE * logged_s)


@dataclass(frozen=True)
class Starts:
    """From when the times of a log count [ns since 1970]: those of logging, and the stamps."""

    log_ns: int
    stamp_ns: int


class Aligned(NamedTuple):
    """Times of all topics by one clock."""

    # Time of each message by topic (n,) [s], in the order in which they were logged; NaN: not known
    time_s: dict[str, np.ndarray]
    by_log: bool  # Whether it is the recorder's clock; otherwise, the clock of the stamps
    notes: list[str]  # What was done


def find_starts(logs: Sequence[Sequence[int]], stamps: Sequence[Sequence[int]]) -> Starts:
    """The first times of several topics, of logging and of stamps; without stamps, both are those of logging."""
    first = min(min(log) for log in logs)
    stamped = [min(filter(None, stamp), default=None) for stamp in stamps]
    return Starts(first, min((one for one in stamped if one is not None), default=first))


def take_times(topic: str, log_ns: Sequence[int], stamp_ns: Sequence[int], starts: Starts) -> Times:
    """Times of messages that were logged and stamped at these times, where 0 is no stamp."""
    logged, stamped = np.asarray(log_ns, np.int64), np.asarray(stamp_ns, np.int64)
    stamp_s = np.where(stamped == 0, np.nan, (stamped - starts.stamp_ns) * NS)
    return Times(topic, (logged - starts.log_ns) * NS, stamp_s)


def align(topics: Sequence[Times], may_align: bool) -> Aligned:
    """Times of all topics by one clock.

    Args:
        topics: Their times; the first is compared with each other one.
        may_align: Whether clocks that differ are aligned; otherwise they are refused.

    Raises:
        InputError: Clocks differ by more than ``MAX_CLOCK_ERROR_S`` or jump, and may not be aligned.
    """
    problem = next(filter(None, (*map(find_jump, topics), *(compare(topics[0], other) for other in topics[1:]))), None)
    unstamped = [one.topic for one in topics if not one.is_stamped]
    if problem and not may_align:
        raise InputError(f"{problem}; clocks: align in the robot's file aligns them by the times of logging")
    notes = [f"{topic}: most messages have no stamp, so the times of logging count" for topic in unstamped]
    if not problem and not unstamped:
        return Aligned({one.topic: _fill(one) for one in topics}, False, notes)
    if problem:
        notes.append(f"{problem}: aligned by the times of logging")
    return Aligned({one.topic: _by_recorder(one) for one in topics}, True, notes)


def compare(first: Times, second: Times) -> str | None:
    """What is wrong between the clocks of two topics; None: they agree, or have no stamps to compare."""
    if not (first.is_stamped and second.is_stamped):
        return None
    begin_s = float(first.log_s.min())
    (number, delay), (other_number, other_delay) = (_find_delays(topic, begin_s) for topic in (first, second))
    both, rows, other_rows = np.intersect1d(number, other_number, assume_unique=True, return_indices=True)
    apart = other_delay[other_rows] - delay[rows]
    if not len(apart) or np.abs(apart).max() <= MAX_CLOCK_ERROR_S:
        return None
    worst = int(np.argmax(np.abs(apart)))
    return (
        f"the clock of {second.topic} differs from that of {first.topic} by {-apart[worst]:+.3f} s at "
        f"{begin_s + STRETCH_S * both[worst]:.1f} s"
    )


def find_jump(times: Times) -> str | None:
    """Where a topic's clock was set back; None: nowhere. Messages that only arrive out of order are no jump."""
    known = np.flatnonzero(np.isfinite(times.stamp_s))
    stamp, late = times.stamp_s[known], times.late_s[known]
    for row in np.flatnonzero(np.diff(stamp) < -MAX_CLOCK_ERROR_S).tolist():
        before, after = _beside(late, row)
        step = float(np.median(after) - np.median(before))
        lasting = min(len(before), len(after)) >= MIN_JUMP_MESSAGES and np.percentile(after, 10) > np.percentile(
            before, 90
        )
        if lasting and step > 0.5 * (stamp[row] - stamp[row + 1]):
            return f"the clock of {times.topic} is set back by {step:.3f} s at {times.log_s[known[row]]:.1f} s"
    return None


def _is_set_ahead(times: Times) -> bool:
    """Whether a topic's clock was set ahead: from a message on, all are logged less long after their stamps."""
    late = times.late_s[np.isfinite(times.stamp_s)]
    for row in np.flatnonzero(np.diff(late) < -MAX_CLOCK_ERROR_S).tolist():
        before, after = _beside(late, row)
        if (
            min(len(before), len(after)) >= MIN_JUMP_MESSAGES
            and np.percentile(after, 90) < np.percentile(before, 10) - MAX_CLOCK_ERROR_S
        ):
            return True
    return False


def _beside(late: np.ndarray, row: int) -> tuple[np.ndarray, np.ndarray]:
    """The values before and after the step from a row to the next, at most ``MAX_JUMP_MESSAGES`` on each side."""
    return late[max(row + 1 - MAX_JUMP_MESSAGES, 0) : row + 1], late[row + 1 : row + 1 + MAX_JUMP_MESSAGES]


def list_offsets(topics: Sequence[Times], starts: Starts) -> Mapping[str, float]:
    """Median of logged minus stamped, by topic [s]; NaN without stamps."""
    apart_s = (starts.log_ns - starts.stamp_ns) * NS
    return {one.topic: float(np.nanmedian(one.late_s)) + apart_s if one.is_stamped else np.nan for one in topics}


def _find_delays(times: Times, begin_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of the stretches with stamped messages (S,), counted from a time on, and the shortest delay in each (S,).

    Others are not listed: one wrong time of logging may lie decades before the others.
    """
    late = times.late_s
    good = np.isfinite(late)
    place = np.floor((times.log_s[good] - begin_s) / STRETCH_S).astype(np.int64)
    order = np.argsort(place, kind="stable")
    numbers, starts = np.unique(place[order], return_index=True)
    parts = np.split(late[good][order], starts[1:]) if len(numbers) else []
    return numbers, np.array([np.percentile(values, DELAY_PERCENTILE) for values in parts])


def _fill(times: Times) -> np.ndarray:
    """The stamps, and for messages without one the time of logging less the median delay."""
    return np.where(np.isfinite(times.stamp_s), times.stamp_s, times.log_s - np.nanmedian(times.late_s))


def _by_recorder(times: Times) -> np.ndarray:
    """Times by the recorder's clock: stamps plus the shortest delay of their stretch, which follows drift and jumps.

    A message whose time then differs by more than ``MAX_CLOCK_ERROR_S`` from the usual delay is next to a jump: NaN.
    """
    if not times.is_stamped:
        return times.log_s
    begin_s = float(times.log_s.min())
    number, delay = _find_delays(times, begin_s)
    edge = begin_s + STRETCH_S * number
    offset = np.interp(times.log_s, edge + STRETCH_S / 2, delay)
    if (jumps := np.abs(np.diff(delay)) > MAX_CLOCK_ERROR_S).any() and (find_jump(times) or _is_set_ahead(times)):
        nearest = np.clip(np.searchsorted(edge, times.log_s, side="right") - 1, 0, len(edge) - 1)
        offset = delay[nearest]
        at_jump = jumps[np.clip(nearest - 1, 0, len(jumps) - 1)] | jumps[np.clip(nearest, 0, len(jumps) - 1)]
        found = np.where(np.isfinite(times.stamp_s), times.stamp_s + offset, times.log_s)
        return np.where(at_jump & ~(np.abs(times.late_s - offset) <= MAX_CLOCK_ERROR_S), np.nan, found)
    return np.where(np.isfinite(times.stamp_s), times.stamp_s + offset, times.log_s)


@dataclass(frozen=True)
class LoggedDrive:
    """A log's drive, by its wheels and the times of its images."""

    wheels: Wheels  # The wheels
    path: Path  # Distance and heading by them
    motions: list[Motion]  # What the robot did
    image_s: np.ndarray  # Time of each image (m,) [s]; NaN where it is not known
    pose: np.ndarray | None  # Poses at the images (m, 3), NaN where there is none; None: they are not known
    notes: tuple[str, ...]  # What the user should know
    offset_s: Mapping[str, float]  # Median of logged minus stamped, by topic [s]
    start_ns: int  # From when times count [ns since 1970]
    from_odometry: bool  # Whether the wheels are computed from an odometry


def find_drive(config: RobotConfig, wheel_log: WheelLog, listed: ImageList, pose_log: PoseLog | None) -> LoggedDrive:
    """Bring everything to one clock and find what the robot did; raises InputError like ``import_log``."""
    logs: list[tuple[str, Any]] = [(config.wheels.topic, wheel_log), (listed.topic, listed)]
    if config.pose and pose_log is not None:
        logs.append((config.pose.topic, pose_log))
    starts = find_starts([one.log_ns for _, one in logs], [one.stamp_ns for _, one in logs])
    times = [take_times(topic, one.log_ns, one.stamp_ns, starts) for topic, one in logs]
    time_s, by_log, notes = align(times, config.clocks == "align")
    start_ns = starts.log_ns if by_log else starts.stamp_ns
    image_s, pose = time_s[listed.topic], None
    wheels = clean_wheels(
        time_s[config.wheels.topic], wheel_log.angle, config.wheels.ticks_per_rev, config.wheels.topic, image_s
    )
    wheels = fill_counts(wheels, config.wheels.topic)
    path = find_path(wheels.angle, config.wheels.radius_m, config.wheels.track_m)
    motions = find_motions(wheels, path, config.wheels.track_m)
    if config.pose and pose_log is not None:
        if pose_log.without:
            notes.append(f"{config.pose.topic}: {pose_log.without} messages are left out: {UNUSABLE_NOTE}")
        pose = find_poses(time_s[config.pose.topic], pose_log.pose, np.nan_to_num(image_s, nan=-np.inf))
        if config.pose.use == "truth" and (lacking := int(np.isnan(pose[:, 0]).sum())):
            notes.append(f"{config.pose.topic}: {lacking} images have no pose within half a second and are left out")
    if wheel_log.without:
        why = f"are left out: {UNUSABLE_NOTE}" if wheel_log.from_odometry else "hold neither wheel"
        notes.append(f"{config.wheels.topic}: {wheel_log.without} messages {why}")
    if wheel_log.from_odometry:
        notes.append(f"{config.wheels.topic}: wheels are computed from the odometry, so they cannot be diagnosed")
    if wheel_log.goes_sideways:
        notes.append(f"{config.wheels.topic}: the odometry goes sideways, as no wheels can: is its orientation right?")
    notes += [*wheels.notes, *_doubt_direction(config.wheels.topic, motions, path)]
    offsets = list_offsets(times, starts)
    return LoggedDrive(wheels, path, motions, image_s, pose, tuple(notes), offsets, start_ns, wheel_log.from_odometry)


def _doubt_direction(topic: str, motions: list[Motion], path: Path) -> list[str]:
    """A note if the robot drove backward more than forward, as it seems if both wheels count backward."""
    ahead_m, back_m = (sum(path.measure(one) for one in motions if one.kind == kind) for kind in ("straight", "back"))
    if back_m <= ahead_m:
        return []
    return [
        f"{topic}: the robot drove {back_m:.1f} m backward and {ahead_m:.1f} m forward: do both wheels count forward?"
    ]
