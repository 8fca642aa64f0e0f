"""The motion of the wheels: angles in the order of time, continuous across wraps, divided where the way is unknown.

While a coarse encoder counts nothing, its wheel turns on. Where it was is known when a count changes: half-way between
the two. Between such moments the angle is interpolated, and where no count comes for long, the wheel rests at its
last count. Without this, a robot that drives evenly seems to jump, stop and turn.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import maximum_filter1d, median_filter

from deepgps.data.segments import find_stretches
from sim.errors import InputError

COARSE_STEP_RATIO = 0.125  # An encoder is coarse from this smallest step of its angle over the usual one
MIN_STEP_PERCENTILE = 1.0  # Percentile of the steps that counts as the smallest; smaller ones may be repairs
WAIT_S, SETTLE_S = 0.3, 0.15
"""Time between two counts after which the wheel may have rested between them, and the time in which it comes to rest
after a count, or begins to turn before the next one [s]."""
MIN_TICKS_PER_REV = 12  # Below it, turns in place are not found reliably; 16 were enough in tests
GAP_S = 0.3  # Longest time between two messages in which the robot may move: a counter may restart or wrap [s]
PAUSE_S = 5.0  # Time without any message after which the robot may have been carried elsewhere [s]
REST_RAD = 0.05  # Angle up to which a wheel has not moved [rad]
JUMP_SPEED_RATIO = 3.0  # A step is a jump if the wheel would have been faster than this multiple of its usual top speed
MIN_TOP_SPEED_RADPS = 1.0  # Least top speed that is assumed [rad/s]
MAX_JUMP_SHARE = 0.02  # Share of jumps from which another program is assumed to publish the same joints
MAX_REVERSALS = 8  # Messages in a row after each of which a wheel turns back: no robot moves so
REVERSAL_SHARE = 0.1  # The same share of messages of which one wheel jumps there and back
MIN_RESTARTS = 2  # Restarts of a counter, all at one count, from which this is its range
MIN_MESSAGES = 20  # Fewest messages of wheels that a drive has
MAX_TIMES = 5  # Times in a note
JUMPING_ODOMETRY = "the odometry jumps, as one that is corrected by other sensors: give the wheels' own"
JUMPING_WHEELS = (
    "the wheels' angles jump back and forth, as if more than one program published them (record only the one of the "
    "wheels), a counter restarted within a turn, or the recorder's clock was set back"
)


@dataclass(frozen=True)
class Wheels:
    """The wheels' angles over time."""

    time_s: np.ndarray  # Times (n,) [s], increasing
    # Angles of the left and right wheel (n, 2) [rad]; continuous, as if a counter that restarts went on
    angle: np.ndarray
    broken: np.ndarray  # Whether the motion between a message and the next is unknown (n - 1,)
    notes: tuple[str, ...] = ()  # What was repaired

    def at(self, time_s: np.ndarray) -> np.ndarray:
        """Angles (m, 2) [rad] at some times (m,) [s]; NaN outside the log and where the motion is unknown."""
        return interpolate(time_s, self.time_s, self.angle, self.broken)

    def count_breaks(self, time_s: np.ndarray) -> np.ndarray:
        """How many unknown motions ended before some times (m,) [s]."""
        return np.searchsorted(self.time_s[1:][self.broken], time_s, side="right")


def interpolate(at_s: np.ndarray, time_s: np.ndarray, values: np.ndarray, broken: np.ndarray) -> np.ndarray:
    """Values (m, k) at some times (m,) [s] of values (n, k) at times (n,) [s]; NaN outside, and where it is broken
    (n - 1,)."""
    found = np.column_stack([np.interp(at_s, time_s, one) for one in values.T])
    before = np.clip(np.searchsorted(time_s, at_s, side="right") - 1, 0, len(broken) - 1)
    found[~((at_s >= time_s[0]) & (at_s <= time_s[-1])) | broken[before]] = np.nan
    return found


def clean_wheels(
    time_s: np.ndarray,
    angle: np.ndarray,
    ticks_per_rev: int,
    topic: str,
    image_s: np.ndarray | None = None,
    from_odometry: bool = False,
) -> Wheels:
    """Put the messages of the wheels in order: times (n,) [s] and angles (n, 2) [rad], NaN where they are unknown.

    By the times of images [s], pauses of the whole log are known. Raises InputError, which names the topic, if there
    are too few messages, or the angles jump back and forth.
    """
    time_s, angle = _join_wheels(time_s, angle, ticks_per_rev)
    if len(time_s) < MIN_MESSAGES:
        raise InputError(f"{topic} has {len(time_s)} messages with both wheels; a drive has at least {MIN_MESSAGES}")
    angle, notes = unwrap(angle, ticks_per_rev)
    jumps, apart = _find_jumps(time_s, angle)
    in_row = max((last - first for first, last in find_stretches(apart).tolist()), default=0)
    if jumps.sum() > max(MAX_JUMP_SHARE * len(time_s), 4) or apart.mean() > REVERSAL_SHARE or in_row >= MAX_REVERSALS:
        why = JUMPING_ODOMETRY if from_odometry else JUMPING_WHEELS
        raise InputError(f"{topic} at {time_s[np.argmax(jumps if jumps.any() else apart)]:.2f} s: {why}")
    spike = apart & np.append(jumps, False) & np.append(False, jumps)
    if spike.any():
        notes.append(f"at {time_s[np.argmax(spike)]:.2f} s: {spike.sum()} messages jump and are left out")
        time_s, angle = time_s[~spike], angle[~spike]
        jumps, _ = _find_jumps(time_s, angle)
    seconds = np.diff(time_s)
    moved = maximum_filter1d(np.abs(np.diff(angle, axis=0)).max(axis=1), 3)  # in a gap, it may be a turn and seem none
    silent, paused = (seconds > GAP_S) & (moved > REST_RAD) & ~jumps, np.zeros(len(seconds), bool)
    if image_s is not None:
        heard_s = np.sort(np.concatenate([time_s, image_s[(image_s > time_s[0]) & (image_s < time_s[-1])]]))
        paused[np.searchsorted(time_s, heard_s[:-1][np.diff(heard_s) > PAUSE_S], side="right") - 1] = True
    broken = jumps | silent | paused
    for row in np.flatnonzero(broken):
        angle[row + 1 :] += angle[row] - angle[row + 1]
    for kind, what in (
        (jumps, "the counter restarted, so the way between is unknown"),
        (silent & ~paused, "no message for up to {:.1f} s while the robot moved, so the way between is unknown"),
        (paused & ~jumps, "nothing was logged for up to {:.0f} s, so the robot may have been carried elsewhere"),
    ):
        if kind.any():
            times = ", ".join(f"{at_s:.2f}" for at_s in time_s[:-1][kind][:MAX_TIMES])
            more = f" and {kind.sum() - MAX_TIMES} other times" if kind.sum() > MAX_TIMES else ""
            notes.append(f"at {times} s{more}: {what.format(seconds[kind].max())}")
    return Wheels(time_s, angle, broken, tuple(f"{topic}: {note}" for note in notes))


def _join_wheels(time_s: np.ndarray, angle: np.ndarray, ticks_per_rev: int) -> tuple[np.ndarray, np.ndarray]:
    """Messages with both wheels in the order of time; wheels in messages of their own are interpolated."""
    order = np.argsort(time_s, kind="stable")
    order = order[np.isfinite(time_s[order])]
    time_s, angle = time_s[order], angle[order]
    known = np.isfinite(angle)
    both, (left, right) = known.all(axis=1), known.T
    if left.any() and right.any() and both.sum() < 0.5 * known.sum(axis=0).min():
        for wheel, there in enumerate((left, right)):  # between the angles before and after a wrap there is none
            angle[there, wheel] = unwrap(angle[there, wheel : wheel + 1], ticks_per_rev)[0][:, 0]
        angle = np.column_stack([angle[:, 0], np.interp(time_s, time_s[right], angle[right, 1], np.nan, np.nan)])
        both = np.isfinite(angle).all(axis=1)
    time_s, angle = time_s[both], angle[both]
    fresh = np.diff(time_s, prepend=-np.inf) > 0
    return time_s[fresh], angle[fresh]


def _find_jumps(time_s: np.ndarray, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Masks of the steps (n - 1,) in which a wheel would be too fast for its usual top speed, and of messages (n,) that
    differ from both neighbours."""
    smooth = median_filter(angle, (3, 1))
    # a message that came late is soon followed by the next
    seconds = np.maximum(np.diff(time_s), np.median(np.diff(time_s)))[:, None]
    middle = (time_s[1:] + time_s[:-1]) / 2
    before, after = (np.searchsorted(time_s, middle + half).clip(0, len(time_s) - 1) for half in (-0.5, 0.5))
    turns_on = np.abs(smooth[after] - smooth[before]) > REST_RAD  # at rest, a wheel may tremble for hours
    top = max(_find_usual_top((np.abs(np.diff(smooth, axis=0)) / seconds)[turns_on]), MIN_TOP_SPEED_RADPS)
    jumps = np.abs(np.diff(angle, axis=0)) > JUMP_SPEED_RATIO * top * seconds + REST_RAD
    apart = np.abs(angle - smooth) > REST_RAD + np.array([_find_tick(wheel) for wheel in angle.T])
    return jumps[:, 0] | jumps[:, 1], apart[:, 0] | apart[:, 1]


def _find_usual_top(size: np.ndarray, percentile: float = 95) -> float:
    """Largest of some sizes but for one in twenty, of those that are not zero; 0: all are."""
    moving = size[size > 1e-9]
    return float(np.percentile(moving, percentile)) if len(moving) else 0.0


def unwrap(angle: np.ndarray, ticks_per_rev: int) -> tuple[np.ndarray, list[str]]:
    """Angles (n, 2) [rad] without the jumps of counters that wrap around at a turn of the wheel, at 16 or 32 bits, or
    where else they always do, and notes."""
    step, tick, notes = np.diff(angle, axis=0), 2 * np.pi / ticks_per_rev, list[str]()
    for full in filter(None, (2 * np.pi, 2**16 * tick, 2**32 * tick, _find_range(step, tick))):
        turns = np.rint(step / full)
        short = step - turns * full
        usual = np.array([_find_usual_top(one) for one in np.abs(short).T])
        small = np.minimum(JUMP_SPEED_RATIO * usual + REST_RAD, full / 4)  # beyond, another program or a restart
        # some counters go from 0 to their range in both directions
        fits = (np.ptp(angle, axis=0) <= 2.001 * full) & (turns != 0) & (np.abs(short) < small)
        step = np.where(fits, short, step)
        if fits.any():
            notes.append(f"counters restart {fits.sum()} times after {full / tick:.0f} ticks, taken as their range")
    return angle[:1] + np.concatenate([np.zeros((1, angle.shape[1])), np.cumsum(step, axis=0)]), notes


def _find_range(step: np.ndarray, tick: float) -> float | None:
    """The range [rad] of counters with such steps (n - 1, 2) [rad], if they always restart at one count.

    There, a counter jumps against the motion, always by the same angle; both at once at one time only is a restart.
    """
    top = np.array([2 * _find_usual_top(one, 50) for one in np.abs(step).T])  # some jump at every few messages
    jumps = np.abs(step) > JUMP_SPEED_RATIO * top + REST_RAD
    jumps[[0, -1]] = False
    rows, wheel = np.nonzero(jumps)
    if len(np.unique(rows)) < MIN_RESTARTS or (jumps[1:] & jumps[:-1]).any():
        return None
    around = (step[rows - 1, wheel] + step[rows + 1, wheel]) / 2
    jump = step[rows, wheel] - around
    if (jump * around >= 0).any() or np.ptp(np.abs(jump)) > REST_RAD + top.max() / 4:
        return None
    return float(np.rint(np.abs(jump).mean() / tick) * tick)


def fill_counts(wheels: Wheels, topic: str) -> Wheels:
    """The wheels with the angles of coarse encoders interpolated between their counts; others stay as they are."""
    angle, ticks = wheels.angle.copy(), list[float]()
    for wheel in angle.T:
        step, tick = np.abs(np.diff(wheel)), _find_tick(wheel)
        if tick > 0.0 and tick > COARSE_STEP_RATIO * np.median(step[step > 0.0]):
            wheel[:] = _fill(wheels.time_s, wheel)
            ticks.append(2 * np.pi / tick)
    notes = [
        f"{topic}: an encoder counts {least:.0f} ticks a turn of its wheel: turns in place may be missed"
        for least in sorted(ticks)[:1]
        if least < MIN_TICKS_PER_REV
    ]
    return replace(wheels, angle=angle, notes=(*wheels.notes, *notes))


def _find_tick(angle: np.ndarray) -> float:
    """The smallest step of angles (n,) [rad], but for repairs; 0: there is none."""
    step = np.abs(np.diff(angle))
    return float(np.percentile(step[step > 0.0], MIN_STEP_PERCENTILE)) if step.any() else 0.0


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
