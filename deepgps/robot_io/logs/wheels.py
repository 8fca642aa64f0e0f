"""The motion of the wheels: angles in the order of time, made continuous across wraps, divided at restarts and gaps.

While a coarse encoder counts nothing, its wheel turns on. Where it was is known when a count changes: half-way between
the two. Between such moments the angle is interpolated, and where no count comes for long, the wheel rests at its
last count. Without this, a robot that drives evenly seems to jump, stop and turn.
"""

from dataclasses import dataclass, replace

import numpy as np

from deepgps.data.segments import find_stretches
from sim.errors import InputError

COARSE_STEP_RATIO = 0.125  # An encoder is coarse from this smallest step of its angle over the usual one
MIN_STEP_PERCENTILE = 1.0  # Percentile of the steps that counts as the smallest; smaller ones may be repairs
WAIT_S, SETTLE_S = 0.3, 0.15
"""Time between two counts after which the wheel may have rested between them, and the time in which it comes to rest
after a count, or begins to turn before the next one [s]."""
MIN_TICKS_PER_REV = 12  # Below it, turns in place are not found reliably; 16 were enough in tests
GAP_S = 0.3  # Longest time between two messages across which angles are interpolated while the robot moves [s]
MAX_SILENCE_S = 1.0
"""Time without a message after which the way is unknown, if the robot moved: a counter may have restarted [s]."""
PAUSE_S = 5.0
"""Time without a message of the wheels or an image after which the robot may have been carried elsewhere [s]."""
REST_RAD = 0.05  # Angle up to which a wheel has not moved in a gap [rad]
JUMP_SPEED_RATIO = 3.0  # A step is a jump if the wheel would have been faster than this multiple of its usual top speed
MIN_TOP_SPEED_RADPS = 1.0  # Least top speed that is assumed [rad/s]
MAX_JUMP_SHARE = 0.02  # Share of jumps from which another program is assumed to publish the same joints
MAX_REVERSALS = 8  # Messages in a row after each of which a wheel turns back: no robot moves so
REVERSAL_SHARE = 0.1  # The same share of messages of which one wheel jumps there and back
MIN_RESTARTS = 2  # Restarts of a counter, all at one count, from which this is its range
MIN_MESSAGES = 20  # Fewest messages of wheels that a drive has
MAX_NOTES = 5  # Notes of one kind


@dataclass(frozen=True)
class Wheels:
    """The wheels' angles over time."""

    time_s: np.ndarray  # Times (n,) [s], increasing
    # Angles of the left and right wheel (n, 2) [rad]; continuous, as if a counter that restarts went on
    angle: np.ndarray
    # Whether the motion between a message and the next is unknown (n - 1,): the counter restarted, or nothing was
    # logged for long
    broken: np.ndarray
    gap: np.ndarray  # Whether there is a gap between them in which the robot moved (n - 1,)
    notes: tuple[str, ...] = ()  # What was repaired

    def at(self, time_s: np.ndarray) -> np.ndarray:
        """Angles (m, 2) [rad] at some times (m,) [s]; NaN outside the log and inside gaps."""
        angle = np.column_stack([np.interp(time_s, self.time_s, wheel) for wheel in self.angle.T])
        before = np.clip(np.searchsorted(self.time_s, time_s, side="right") - 1, 0, len(self.gap) - 1)
        outside = (time_s < self.time_s[0]) | (time_s > self.time_s[-1])
        angle[outside | self.broken[before] | self.gap[before]] = np.nan
        return angle

    def count_breaks(self, time_s: np.ndarray) -> np.ndarray:
        """How many unknown motions ended before some times (m,) [s]."""
        ends_s = self.time_s[1:][self.broken]
        return np.searchsorted(ends_s, time_s, side="right")


def clean_wheels(
    time_s: np.ndarray,
    angle: np.ndarray,
    ticks_per_rev: int,
    topic: str,
    image_s: np.ndarray | None = None,
    from_odometry: bool = False,
) -> Wheels:
    """Put the messages of the wheels in order.

    Args:
        time_s: Time of each message (n,) [s]; NaN where it is unknown.
        angle: Angles (n, 2) [rad]; NaN where a message lacks a wheel.
        ticks_per_rev: Ticks of a revolution, by which a counter of 16 or 32 bits wraps around.
        topic: Name for messages.
        image_s: Times of images [s]; None: none are known, and no pause of the log either.
        from_odometry: Whether the angles are computed from an odometry's path.

    Raises:
        InputError: There are too few messages, or the angles jump back and forth.
    """
    time_s, angle = _join_wheels(time_s, angle, ticks_per_rev)
    if len(time_s) < MIN_MESSAGES:
        raise InputError(f"{topic} has {len(time_s)} messages with both wheels; a drive has at least {MIN_MESSAGES}")
    row = _find_reversals(angle)
    unwrapped, full, repairs = _unwrap(angle, ticks_per_rev)
    jumps = _find_jumps(time_s, unwrapped)
    if row is None and jumps.sum() > max(MAX_JUMP_SHARE * len(time_s), 4):
        row = int(np.argmax(jumps))
    if row is not None:
        why = (
            "the odometry jumps, as one that is corrected by other sensors: give the wheels' own"
            if from_odometry
            else "the wheels' angles jump back and forth, as if more than one program published them (record only the "
            "one of the wheels), or as if the recorder's clock was set back"
        )
        raise InputError(f"{topic} at {time_s[row]:.2f} s: {why}")
    angle, notes = unwrapped, [f"{topic}: {one}" for one in repairs]
    back = np.abs(angle[2:] - angle[:-2]) < np.abs(angle[1:-1] - angle[:-2])
    spike = jumps[:-1] & jumps[1:] & back.any(axis=1)
    if spike.any():
        notes.append(f"{topic} at {time_s[np.argmax(jumps)]:.2f} s: {spike.sum()} messages jump and are left out")
        kept = np.concatenate([[True], ~spike, [True]])
        time_s, angle = time_s[kept], angle[kept]
        jumps = _find_jumps(time_s, angle)
    seconds = np.diff(time_s)
    silent = (seconds > GAP_S) & (np.abs(np.diff(angle, axis=0)).max(axis=1) > REST_RAD) & ~jumps
    unknown = (seconds > MAX_SILENCE_S) | (seconds[:, None] * _find_top_speed(time_s, angle) > full / 2).any(axis=1)
    paused = _find_pauses(time_s, image_s) & ~jumps
    gap, lost = silent & ~unknown & ~paused, silent & unknown & ~paused
    broken = jumps | lost | paused
    for row in np.flatnonzero(broken):
        angle[row + 1 :] += angle[row] - angle[row + 1]
    for kind, what in (
        (jumps, "the counter restarted, so the way between is unknown"),
        (gap, "no message for {:.1f} s while the robot moved"),
        (lost, "no message for {:.1f} s while the robot moved, so the way between is unknown"),
        (paused, "nothing was logged for {:.0f} s, so the robot may have been carried elsewhere"),
    ):
        rows = np.flatnonzero(kind)
        notes += [f"{topic} at {time_s[row]:.2f} s: {what.format(seconds[row])}" for row in rows[:MAX_NOTES]]
        if len(rows) > MAX_NOTES:
            notes.append(f"{topic}: the same at {len(rows) - MAX_NOTES} other times")
    return Wheels(time_s, angle, broken, gap, tuple(notes))


def _find_pauses(time_s: np.ndarray, image_s: np.ndarray | None) -> np.ndarray:
    """Mask (n - 1,) of the times between messages in which nothing was logged for long."""
    paused = np.zeros(len(time_s) - 1, bool)
    if image_s is not None:
        all_s = np.sort(np.concatenate([time_s, image_s[(image_s > time_s[0]) & (image_s < time_s[-1])]]))
        paused[np.searchsorted(time_s, all_s[:-1][np.diff(all_s) > PAUSE_S], side="right") - 1] = True
    return paused


def _find_reversals(angle: np.ndarray) -> int | None:
    """The message at which wheels begin to jump back and forth, as if two programs took turns; None: nowhere."""
    step = np.diff(angle, axis=0)
    size = np.abs(step)
    low, high = np.minimum(size[1:], size[:-1]), np.maximum(size[1:], size[:-1])
    back = np.asarray(((step[1:] * step[:-1] < 0) & (low > REST_RAD) & (low > high / 2)).any(axis=1))
    if back.mean() > REVERSAL_SHARE:
        return int(np.argmax(back))
    return next((first for first, last in find_stretches(back).tolist() if last - first >= MAX_REVERSALS), None)


def _join_wheels(time_s: np.ndarray, angle: np.ndarray, ticks_per_rev: int) -> tuple[np.ndarray, np.ndarray]:
    """Messages with both wheels in the order of time; wheels in messages of their own are interpolated."""
    known = np.isfinite(time_s)
    time_s, angle = time_s[known], angle[known]
    order = np.argsort(time_s, kind="stable")
    time_s, angle = time_s[order], angle[order]
    both = np.isfinite(angle).all(axis=1)
    if both.sum() < 0.5 * max(np.isfinite(angle).sum(axis=0).min(), 1):
        left, right = np.isfinite(angle).T
        if not (left.any() and right.any()):
            return np.empty(0), np.empty((0, 2))
        for wheel, there in enumerate((left, right)):  # between the angles before and after a wrap there is none
            angle[there, wheel] = _unwrap(angle[there, wheel : wheel + 1], ticks_per_rev)[0][:, 0]
        inside = left & (time_s >= time_s[right].min()) & (time_s <= time_s[right].max())
        angle = np.column_stack([angle[:, 0], np.interp(time_s, time_s[right], angle[right, 1])])
        both = inside
    time_s, angle = time_s[both], angle[both]
    fresh = np.diff(time_s, prepend=-np.inf) > 0
    return time_s[fresh], angle[fresh]


def _find_jumps(time_s: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Mask (n - 1,) of the steps in which a wheel would have been too fast."""
    step, seconds = np.abs(np.diff(angle, axis=0)), _find_seconds(time_s)
    return np.asarray((step > JUMP_SPEED_RATIO * _find_top_speed(time_s, angle) * seconds + REST_RAD).any(axis=1))


def _find_top_speed(time_s: np.ndarray, angle: np.ndarray) -> float:
    """Usual top speed of the wheels where they turn [rad/s]."""
    speed = np.abs(np.diff(angle, axis=0)) / _find_seconds(time_s)
    return max(_find_usual_top(speed[_is_turning(time_s, angle)]), MIN_TOP_SPEED_RADPS)


def _find_seconds(time_s: np.ndarray) -> np.ndarray:
    """Times of the steps (n - 1, 1) [s], at least the usual: a message that came late is soon followed by the next."""
    seconds = np.diff(time_s)
    return np.maximum(seconds, np.median(seconds))[:, None]


def _is_turning(time_s: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Mask (n - 1, 2) of the steps around which a wheel turns on within a second; at rest, it may tremble for hours."""
    middle = (time_s[1:] + time_s[:-1]) / 2
    before = np.searchsorted(time_s, middle - 0.5).clip(0, len(time_s) - 1)
    after = (np.searchsorted(time_s, middle + 0.5, side="right") - 1).clip(0)
    return np.abs(angle[after] - angle[before]) > REST_RAD


def _find_usual_top(size: np.ndarray) -> float:
    """Largest of some sizes but for one in twenty, of those that are not zero; 0: all are."""
    moving = size[size > 1e-9]
    return float(np.percentile(moving, 95)) if len(moving) else 0.0


def _unwrap(angle: np.ndarray, ticks_per_rev: int) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Angles without the jumps of a counter that wraps around at a turn of the wheel, at 16 or 32 bits, or where else
    it always does.

    Returns:
        The angles (n, 2) [rad], the angle at which each wheel's counter wraps (2,), infinite if it does not, and notes.
    """
    step, wraps, wrapped, notes = np.diff(angle, axis=0), np.full(angle.shape[1], np.inf), 0, list[str]()
    for full in (2 * np.pi, *(2 * np.pi * 2**bits / ticks_per_rev for bits in (16, 32))):
        turns = np.rint(step / full)
        short = step - turns * full
        usual = np.array([_find_usual_top(one) for one in np.abs(short).T])
        small = np.minimum(JUMP_SPEED_RATIO * usual + REST_RAD, full / 4)  # beyond, another program or a restart
        fits = (np.ptp(angle, axis=0) <= full * 1.001) & (turns != 0) & (np.abs(short) < small)
        step = np.where(fits, short, step)
        wraps = np.where(fits.any(axis=0), np.minimum(wraps, full), wraps)
        wrapped += int(fits.any(axis=1).sum())
    if wrapped:
        notes.append(f"a counter wrapped around {wrapped} times")
    rows, wheel, full = _find_range(step, 2 * np.pi / ticks_per_rev)
    if len(rows):
        step[rows, wheel] -= full * np.sign(step[rows, wheel])
        wraps[wheel] = full
        ticks = full * ticks_per_rev / (2 * np.pi)
        notes.append(f"counters restart {len(rows)} times after {ticks:.0f} ticks, which is taken as their range")
    return angle[:1] + np.concatenate([np.zeros((1, angle.shape[1])), np.cumsum(step, axis=0)]), wraps, notes


def _find_range(step: np.ndarray, tick: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Where in steps (n - 1, 2) [rad] which counter restarts, if both always do so at one count, and their range [rad].

    There, a counter jumps against the motion, always by the same angle; both at once at one time only is a restart.
    """
    top = np.array([_find_usual_top(one) for one in np.abs(step).T])
    jumps = np.abs(step) > JUMP_SPEED_RATIO * top + REST_RAD
    jumps[[0, -1]] = False
    rows, wheel = np.nonzero(jumps)
    if len(np.unique(rows)) < MIN_RESTARTS or (jumps[1:] & jumps[:-1]).any():
        return rows[:0], wheel[:0], 0.0
    around = (step[rows - 1, wheel] + step[rows + 1, wheel]) / 2
    jump = step[rows, wheel] - around
    if (jump * around >= 0).any() or np.ptp(np.abs(jump)) > REST_RAD + top.max() / 2:
        return rows[:0], wheel[:0], 0.0
    return rows, wheel, float(np.rint(np.abs(jump).mean() / tick) * tick)


def fill_counts(wheels: Wheels, topic: str) -> Wheels:
    """The wheels with the angles of coarse encoders interpolated between their counts; others stay as they are.

    Args:
        wheels: The wheels.
        topic: Name for a note on encoders that are too coarse.
    """
    coarse = [is_coarse(one) for one in wheels.angle.T]
    angle = [_fill(wheels.time_s, one) if has else one for one, has in zip(wheels.angle.T, coarse, strict=True)]
    ticks = [2 * np.pi / _find_tick(one) for one, has in zip(wheels.angle.T, coarse, strict=True) if has]
    notes = list(wheels.notes)
    if ticks and (least := min(ticks)) < MIN_TICKS_PER_REV:
        notes.append(f"{topic}: an encoder counts {least:.0f} ticks a turn of its wheel: turns in place may be missed")
    return replace(wheels, angle=np.column_stack(angle), notes=tuple(notes))


def is_coarse(angle: np.ndarray) -> bool:
    """Whether angles (n,) [rad] change by few counts of the encoder between two messages."""
    step = np.abs(np.diff(angle))
    return bool(step.any()) and _find_tick(angle) > COARSE_STEP_RATIO * float(np.median(step[step > 0.0]))


def _find_tick(angle: np.ndarray) -> float:
    """The smallest step of angles (n,) [rad], but for repairs."""
    step = np.abs(np.diff(angle))
    return float(np.percentile(step[step > 0.0], MIN_STEP_PERCENTILE))


def _fill(time_s: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Angles (n,) [rad] of one wheel, interpolated between the changes of its counts."""
    row = np.flatnonzero(np.diff(angle))
    change_s, middle = (time_s[row] + time_s[row + 1]) / 2, (angle[row] + angle[row + 1]) / 2
    begins, ends = np.r_[time_s[0], change_s], np.r_[change_s, time_s[-1]]
    rests = ends - begins > WAIT_S
    count = angle[np.r_[0, row + 1]][rests]  # at which the wheel rests in each of these intervals
    knots_s = np.concatenate([change_s, begins[rests] + SETTLE_S, ends[rests] - SETTLE_S])
    order = np.argsort(knots_s, kind="stable")
    return np.interp(time_s, knots_s[order], np.concatenate([middle, count, count])[order])
