"""The gaps between consecutive readings, and what they show without a model: stuck wheels, ticks, readings lost."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar, root_scalar

from deepgps.data.segments import fill_stretches, find_stretches, travel
from sim.recording.format import Recording
from sim.recording.turns import KINDS
from sim.sensors.encoder import measure_tick

STALL_TICKS, STALL_M = 6, 0.3
"""A wheel is stuck where it counts nothing while the other one counts this many ticks and travels this far [m]."""
MIN_TICKS = 2  # A gap with fewer ticks of the moving wheel may show none of the other one by rounding alone
Z95 = 1.96


@dataclass(frozen=True)
class Stretch:
    """A stretch in which a wheel is stuck."""

    wheel: int  # 0 left, 1 right
    first: int  # First gap of the stretch
    last: int  # Last gap, inclusive
    doubtful: int  # Gaps at its two ends that rounding alone may have emptied


@dataclass(frozen=True)
class Gaps:
    """The G = R - 1 gaps between consecutive readings."""

    distance: np.ndarray  # Distance by the left and the right wheel (G, 2) [m]
    seconds: np.ndarray  # Duration (G,) [s]
    made_of: np.ndarray  # Original gaps in each (G,); more than one where readings were lost
    inside: np.ndarray  # Whether the gap is on a segment (G,) bool; the others are turns
    stuck: tuple[Stretch, ...]  # Stretches in which a wheel is stuck
    good: np.ndarray  # Whether no wheel is stuck in the gap or beside it (G,) bool
    tick_m: float  # Distance that a wheel travels between two counts [m]


def read_gaps(recording: Recording) -> Gaps:
    """Read the gaps of a recording."""
    reading, odometry = recording.reading, recording.manifest.odometry
    ticks = np.diff(reading[:, 2:], axis=0)
    step = max(int(np.gcd.reduce(np.abs(ticks), axis=None)), 1)
    tick_m = step * measure_tick(odometry)
    distance, inside = np.diff(travel(reading[:, 2:], odometry), axis=0), np.diff(reading[:, 0]) == 0
    stuck = tuple(stretch for wheel in range(2) for stretch in find_stuck(distance, inside, wheel, tick_m))
    good = np.ones(len(distance), bool)
    for stretch in stuck:
        good[max(stretch.first - 1, 0) : stretch.last + 2] = False
    return Gaps(
        distance=distance,
        seconds=np.diff(recording.time),
        made_of=np.diff(reading[:, 1]).clip(1),
        inside=inside,
        stuck=stuck,
        good=good,
        tick_m=tick_m,
    )


def find_stuck(distance: np.ndarray, inside: np.ndarray, wheel: int, tick_m: float) -> list[Stretch]:
    """Find the stretches in which a wheel (0 left, 1 right) counts nothing while the other one travels.

    Ways of the left and the right wheel are those of each gap (G, 2) [m], of which some are inside segments (G,); in a
    turn one wheel may stand still. A tick is the distance between two counts [m].
    """
    other = np.abs(distance[:, 1 - wheel]) * inside
    found = []
    for first, last in find_stretches(distance[:, wheel] == 0.0).tolist():
        moved = other[first : last + 1]
        if moved.sum() >= max(STALL_TICKS * tick_m, STALL_M):
            clear = np.flatnonzero(moved >= MIN_TICKS * tick_m)
            inner = int(clear[-1] - clear[0]) + 1 if len(clear) else 0
            found.append(Stretch(wheel, first, last, last + 1 - first - inner))
    return found


def measure_stuck(gaps: Gaps) -> tuple[float, float, float]:
    """Part of the gaps in which a wheel is stuck, and a bound below and above it.

    A stretch is known to a gap at each end, and to those there that rounding or a robot at rest may have emptied.
    """
    total = max(int(gaps.made_of.sum()), 1)
    length = [int(gaps.made_of[one.first : one.last + 1].sum()) for one in gaps.stuck]
    beside = [
        int(gaps.made_of[max(one.first - 1, 0)] + gaps.made_of[min(one.last + 1, len(gaps.made_of) - 1)])
        for one in gaps.stuck
    ]
    low = sum(size - one.doubtful - 1 for size, one in zip(length, gaps.stuck, strict=True))
    return sum(length) / total, max(low, 0) / total, min((sum(length) + sum(beside)) / total, 1.0)


def measure_loss(recording: Recording) -> tuple[float, float, float]:
    """Part of the readings that never arrived, with its interval by Wilson's score (95 %).

    Every observation has a reading, and the place of a turn in place, of which there is a turn image, has two.
    """
    assert recording.turn_observation is not None
    arrived = len(recording.reading)
    total = max(len(recording.observation) + len(recording.turn_observation), arrived)
    lost = 1.0 - arrived / total
    shrunk = 1.0 + Z95**2 / total
    middle = (lost + Z95**2 / (2 * total)) / shrunk
    half = Z95 / shrunk * np.sqrt(lost * (1.0 - lost) / total + Z95**2 / (4 * total**2))
    return lost, max(float(middle - half), 0.0) if lost else 0.0, float(middle + half)


def mend_stuck(recording: Recording) -> Recording:
    """The recording with the gaps in which a wheel is stuck taken from the other wheel.

    On a segment both wheels travel alike, and in a turn in place in opposite directions. Other gaps stay as they are.
    """
    gaps = read_gaps(recording)
    if not gaps.stuck:
        return recording
    sign = gaps.inside.astype(np.int64)
    if recording.turns is not None:
        in_place = recording.turns.after[recording.turns.kind == KINDS.index("in_place")] - 1
        sign[in_place[~gaps.inside[in_place]]] = -1
    ticks = np.diff(recording.reading[:, 2:], axis=0)
    for stretch in gaps.stuck:
        part = slice(stretch.first, stretch.last + 1)
        ticks[part, stretch.wheel] = sign[part] * ticks[part, 1 - stretch.wheel]
    reading = recording.reading.copy()
    reading[1:, 2:] = reading[0, 2:] + np.cumsum(ticks, axis=0)
    return replace(recording, reading=reading)


FLOOR_M = 1e-5  # Error of a reading of the best encoder [m]: it keeps the likelihood finite where nothing is noisy
CREEP_PER_M = 3e-5  # Slip after a metre [m], and noise of a gap, of wheels without faults: they creep on the floor
ROUNDINGS = (0.03, 0.1, 0.3, 0.6, 1.0, 1.5, 2.0)
"""Variances of rounding that are tried, as multiples of that of independent wheels: both may round alike."""
FINE_TICK_M = 2e-4  # Ticks so short that their rounding need not be known well [m]
MAX_OUTSIDE_SHARE = 0.02  # Share of the runs that may leave what rounding alone can give: somebody touched the robot
CHI2_95 = 3.841
GATE = 4.0  # Standard deviations beyond which an innovation counts no more: a contact, or a wheel that was lifted
START_GAPS, END_GAPS = 1, 2  # Gaps at the beginning and the end of a segment in which the robot changes its speed


@dataclass(frozen=True)
class Runs:
    """Consecutive readings of S runs, padded to the longest (S, m); ``valid`` marks those that exist."""

    level: np.ndarray  # What is read, counted from the run's first reading (S, m) [m]
    drift: np.ndarray  # The quantity it drifts with, counted likewise (S, m)
    # Per gap before each reading: the quantities that its variance is made of, by name (S, m)
    size: dict[str, np.ndarray]
    valid: np.ndarray  # Mask (S, m) bool


class Fit(NamedTuple):
    """A maximum of the likelihood: a standard deviation with its 95 % interval, and the drift with its own."""

    value: float
    low: float
    high: float
    drift: float
    drift_std: float


def fit_slip(gaps: Gaps) -> Fit:
    """Slip of a wheel after a metre, from the difference of the wheels, right minus left.

    Slip adds 2 s^2 g to the difference over a gap ``g``, rounding t^2 / 6 to each reading of it. The drift is the
    difference of the wheels' readings over their mean.
    """
    apart, mean = gaps.distance[:, 1] - gaps.distance[:, 0], gaps.distance.mean(axis=1)
    runs = _collect(apart, mean, {"g": np.abs(mean)}, _list_runs(gaps, 0, 0))
    return _fit(runs, lambda s: 2.0 * s**2 * runs.size["g"], gaps.tick_m**2 / 6.0, 1.5 * gaps.tick_m)


def fit_step_noise(gaps: Gaps, slip_per_m: float) -> Fit:
    """Noise of a gap ``w`` as a part of it, from the mean of the wheels against a steady speed.

    The noise adds (w g)^2 / k to the mean over k original gaps of the length ``g`` in all, slip s^2 g / 2, rounding
    t^2 / 24 to each reading. The drift is the speed [m/s].
    """
    mean, inner = gaps.distance.mean(axis=1), _list_runs(gaps, START_GAPS, END_GAPS)
    used = np.concatenate([np.arange(first, end) for first, end in inner]) if inner else np.arange(0)
    speed = float(np.median(mean[used] / gaps.seconds[used])) if len(used) else 0.0
    g = np.abs(speed) * gaps.seconds
    runs = _collect(mean, gaps.seconds, {"g": g, "square": g**2 / gaps.made_of}, inner)
    slipped = slip_per_m**2 / 2.0 * runs.size["g"]
    return _fit(runs, lambda w: slipped + w**2 * runs.size["square"], gaps.tick_m**2 / 24.0, 1.2 * gaps.tick_m)


def _list_runs(gaps: Gaps, first: int, last: int) -> list[tuple[int, int]]:
    """Beginning and end of the runs of good gaps, without the first and last gaps of each segment."""
    shorter = (find_stretches(gaps.inside) + np.array([first, -last])).clip(min=-1)  # some end before they begin
    inner = fill_stretches(shorter.tolist(), len(gaps.inside))
    return [(begin, end + 1) for begin, end in find_stretches(inner & gaps.good).tolist()]


def _collect(step: np.ndarray, drift: np.ndarray, size: dict[str, np.ndarray], runs: list[tuple[int, int]]) -> Runs:
    longest = max((end - first for first, end in runs), default=0)
    shape = len(runs), longest + 1
    level, drifted, valid = np.zeros(shape), np.zeros(shape), np.zeros(shape, bool)
    sizes = {name: np.zeros(shape) for name in size}
    for row, (first, end) in enumerate(runs):
        count = end - first
        level[row, 1 : count + 1] = np.cumsum(step[first:end])
        drifted[row, 1 : count + 1] = np.cumsum(drift[first:end])
        valid[row, : count + 1] = True
        for name, values in size.items():
            sizes[name][row, 1 : count + 1] = values[first:end]
    return Runs(level, drifted, sizes, valid)


def _fit(runs: Runs, grow: Callable[[float], np.ndarray], rounding_m2: float, width_m: float) -> Fit:
    """Maximise the likelihood over a standard deviation, which ``grow`` turns into the variance of each gap.

    The rounding's variance is that of a reading, if the wheels round independently [m^2]; the width is how far rounding
    alone can move the readings of a run apart, with a fifth or more to spare for the error of the drift [m].
    """
    if runs.valid.sum() - len(runs.valid) < 10:
        return Fit(0.0, 0.0, 1.0, 0.0, 1.0)
    shares = ROUNDINGS if rounding_m2 > FINE_TICK_M**2 / 24.0 else (1.0,)

    def try_all(value: float) -> tuple[float, float, float]:
        growth = grow(float(np.hypot(value, CREEP_PER_M)))
        return min(_filter(runs, growth, share * rounding_m2 + FLOOR_M**2) for share in shares)

    def cost(value: float) -> float:
        return try_all(value)[0]

    logs = np.linspace(np.log(1e-5), 0.0, 24)
    costs = [cost(float(np.exp(log))) for log in logs]
    best = int(np.argmin(costs))
    low, high = float(logs[max(best - 1, 0)]), float(logs[min(best + 1, len(logs) - 1)])
    found = minimize_scalar(lambda log: cost(float(np.exp(log))), bounds=(low, high), method="bounded")
    value, least, none = float(np.exp(found.x)), float(found.fun), cost(0.0)
    if none <= least:
        value, least = 0.0, none

    def excess(log: float) -> float:
        return cost(float(np.exp(log))) - least - CHI2_95

    def cross(below: float, above: float) -> float:
        return float(np.exp(root_scalar(excess, bracket=(below, above)).root))

    top, bottom = float(logs[-1]) + 1.0, float(logs[0])
    middle = float(np.log(max(value, 1e-5)))
    upper = cross(middle, top) if excess(middle) < 0.0 < excess(top) else max(value, 1e-5)
    below = value > 0.0 and none - least > CHI2_95 and excess(bottom) > 0.0
    lower = cross(bottom, middle) if below else 0.0
    drift, drift_std = try_all(value)[1:]
    if value > 0.0 and _is_within(runs, drift, width_m):
        drift, drift_std = try_all(0.0)[1:]
        return Fit(0.0, 0.0, upper, drift, drift_std)
    return Fit(value, lower, upper, drift, drift_std)


def _is_within(runs: Runs, drift: float, width_m: float) -> bool:
    """Whether nearly all runs stay within a width of their drift [m]."""
    off = runs.level - drift * runs.drift
    apart = np.where(runs.valid, off, -np.inf).max(axis=1) - np.where(runs.valid, off, np.inf).min(axis=1)
    return float((apart > width_m).mean()) <= MAX_OUTSIDE_SHARE


def _filter(runs: Runs, growth: np.ndarray, noise: float) -> tuple[float, float, float]:
    """Minus twice the log-likelihood, with the drift that maximises it, and the drift's standard deviation.

    Level and drift are filtered with the same gains, so the innovations are linear in the drift.
    """
    count = runs.valid.shape[1]
    variance = np.full(len(runs.valid), noise)
    level, drift = runs.level[:, 0].copy(), runs.drift[:, 0].copy()
    parts = []
    for k in range(1, count):
        seen = runs.valid[:, k]
        variance = variance + growth[:, k]
        total = variance + noise
        off, along = runs.level[:, k] - level, runs.drift[:, k] - drift
        parts.append(np.stack([off, along, total])[:, seen])
        gain = np.where(seen, variance / total, 0.0)
        level, drift, variance = level + gain * off, drift + gain * along, variance * (1.0 - gain)
    off, along, total = np.concatenate(parts, axis=1)
    weight = np.ones(len(off))
    slope = 0.0
    for _ in range(4):
        slope = float((weight * along * off / total).sum() / max((weight * along**2 / total).sum(), 1e-300))
        weight = ((off - slope * along) ** 2 < GATE**2 * total).astype(float)
        if not weight.any():
            weight[:] = 1.0
    missed = np.minimum((off - slope * along) ** 2 / total, GATE**2)
    std = 1.0 / np.sqrt(max((weight * along**2 / total).sum(), 1e-300))
    return float((np.log(total) + missed).sum()), slope, float(std)
