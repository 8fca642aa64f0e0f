"""Readings that cannot be: found in the readings themselves, without the truth, left out or repaired, and counted.

A robot reads its wheels in the order driven: time goes on, segments and images are numbered upwards, and no wheel turns
much faster than it usually does. What breaks this is a fault of the clock, of the counter or of what carried the
numbers. Every gap between two consecutive readings is judged by its time and by the median speed, which half of all gaps
would have to be wrong to change; encoders that are known to be noisy are given their noise.

- A counter of 16 or 32 bits that wrapped around is unwrapped, each wheel for itself.
- A few readings that lie off while those before and after them fit each other are left out ("jumps").
- Where what follows never fits what came before, as after a counter was reset, the gap is left out: a segment is
  divided there ("breaks").

Where nothing is wrong, the readings stay as they are.
"""

from bisect import bisect_left, bisect_right
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from deepgps.data import read_odometry
from sim.encoder import ticks_to_distance
from sim.errors import InputError
from sim.records import Recording

COLUMNS = 4
FASTER = 2.5
"""How many times the median speed a wheel may turn: a drive between short stops has a median far below its highest."""
DEVIATIONS = 6.0
"""Standard deviations of known noise that a gap may be off by."""
ROUNDING = 3
"""Ticks that a gap may be off by whatever its length."""
TURNS = 2.0
"""Full turns in place that a robot may make between two segments, whatever the time."""
ONE_WAY = 0.9
"""Share of the gaps in which a wheel must turn the same way before the other way counts as a fault."""
SPIKE = 6
"""Readings in a row, at most, that are left out because those around them fit each other."""
WIDTHS = (16, 32)
"""Bits of counters that wrap around."""
LARGEST = 2.0**63
"""No difference of ticks is larger."""

Fault = str
FAULTS: dict[Fault, str] = {
    "not_a_number": "hold no number",
    "out_of_range": "belong to no observation",
    "repeated": "are repeated",
    "disordered": "are out of order",
    "jumps": "jump",
}
"""Why a reading is left out, and what is said of it."""


@dataclass(frozen=True)
class CheckedReadings:
    """Readings that can be.

    Attributes:
        reading: int64 (K, 4), as in ``Recording``; ticks unwrapped, and segments divided where the ticks break.
        kept: Which of all readings these are (R,) bool.
        counts: ``kept``; of each of ``FAULTS`` how many are left out; ``wrapped``, gaps at which a counter wrapped
            around; ``breaks``, gaps that are left out.
    """

    reading: np.ndarray
    kept: np.ndarray
    counts: dict[str, int]


def keep_plausible(recording: Recording) -> Recording:
    """The recording with the readings that can be; ``manifest["readings_checked"]`` holds their counts.

    Raises:
        InputError: The readings are not of the right shape, or most of them cannot be.
    """
    if "readings_checked" in recording.manifest:
        return recording
    odometry = read_odometry(recording.manifest)
    try:
        checked = check_readings(recording.reading, recording.time, len(recording.observation), odometry)
    except InputError as error:
        raise InputError(f"{recording.folder}: {error}") from None
    manifest = {**recording.manifest, "readings_checked": checked.counts}
    if checked.reading is recording.reading:
        return replace(recording, manifest=manifest)
    return replace(recording, manifest=manifest, reading=checked.reading, time=recording.time[checked.kept])


def count_readings(recording: Recording) -> dict[str, dict[str, int]]:
    """What ``training.json`` and ``metrics.json`` say of the readings; nothing, where they were not checked."""
    counts = recording.manifest.get("readings_checked")
    return {} if counts is None else {"readings": counts}


def describe_readings(counts: Mapping[str, int]) -> str | None:
    """What was left out and repaired, in a sentence; None: nothing was."""
    left_out = {fault: counts.get(fault, 0) for fault in FAULTS}
    parts = []
    if any(left_out.values()):
        why = ", ".join(f"{count} {FAULTS[fault]}" for fault, count in left_out.items() if count)
        total = counts["kept"] + sum(left_out.values())
        parts.append(f"{sum(left_out.values())} of {total} readings cannot be and are left out ({why})")
    if wrapped := counts.get("wrapped", 0):
        parts.append(f"counters wrap around {wrapped} times and are unwrapped")
    if breaks := counts.get("breaks", 0):
        parts.append(f"{breaks} gaps between readings cannot be, and the segments are divided there")
    return "; ".join(parts)[:1].upper() + "; ".join(parts)[1:] + "." if parts else None


def check_readings(
    reading: np.ndarray, time: np.ndarray, observations: int, odometry: Mapping[str, Any]
) -> CheckedReadings:
    """Find the readings that can be.

    Args:
        reading: (R, 4): segment, observation, cumulative left and right ticks, in the order driven.
        time: Of each reading (R,) [s].
        observations: How many there are.
        odometry: Constants of the manifest.

    Raises:
        InputError: ``reading`` or ``time`` is no such array, or most of the readings cannot be.
    """
    _check_shapes(reading, time)
    counts, left = {}, np.arange(len(reading))
    whole, clock = _as_integers(reading), np.asarray(time, float)
    for fault, find in (("not_a_number", _find_numbers), ("out_of_range", _find_observed)):
        good = find(reading[left], whole[left], clock[left], observations)
        counts[fault], left = int((~good).sum()), left[good]
    fresh = _find_fresh(whole[left])
    counts["repeated"], left = int((~fresh).sum()), left[fresh]
    before = len(left)
    for numbers, strictly in ((clock, True), (whole[:, 0], False), (whole[:, 1], False)):
        left = left[_find_rising(numbers[left], strictly)]
    counts["disordered"] = before - len(left)
    table, jumped, counts["wrapped"], counts["breaks"] = _check_ticks(whole[left], clock[left], odometry)
    counts["jumps"], left = int(jumped.sum()), left[~jumped]
    if 2 * len(left) < len(reading):
        why = ", ".join(f"{counts[fault]} {words}" for fault, words in FAULTS.items() if counts[fault])
        raise InputError(f"reading.npy and time.npy: of {len(reading)} readings {why}; so the rest is not believed")
    kept = np.zeros(len(reading), bool)
    kept[left] = True
    counts = {"kept": len(left), **{fault: counts[fault] for fault in (*FAULTS, "wrapped", "breaks")}}
    as_it_was = np.array_equal(table, reading) and reading.dtype == np.int64
    return CheckedReadings(reading if as_it_was else table, kept, counts)


def _check_shapes(reading: np.ndarray, time: np.ndarray) -> None:
    for name, array, shape in (("reading.npy", reading, (len(reading), COLUMNS)), ("time.npy", time, (len(reading),))):
        if array.shape != shape:
            raise InputError(f"{name} has the shape {array.shape}, where {shape} is expected")
        if array.dtype.kind not in "iuf":
            raise InputError(f"{name} holds {array.dtype}, where numbers are expected")
    if not len(reading):
        raise InputError("reading.npy holds no reading")


def _as_integers(reading: np.ndarray) -> np.ndarray:
    if reading.dtype.kind != "f":
        return reading.astype(np.int64, copy=False)
    with np.errstate(invalid="ignore"):
        return np.where(np.abs(reading) < LARGEST, reading, 0.0).astype(np.int64)


def _find_numbers(reading: np.ndarray, whole: np.ndarray, clock: np.ndarray, observations: int) -> np.ndarray:
    good = np.isfinite(clock)
    return good if reading.dtype.kind != "f" else good & (whole == reading).all(axis=1)


def _find_observed(reading: np.ndarray, whole: np.ndarray, clock: np.ndarray, observations: int) -> np.ndarray:
    return (whole[:, 1] >= 0) & (whole[:, 1] < observations)


def _find_fresh(whole: np.ndarray) -> np.ndarray:
    """Readings (n,) that are not of the observation and the segment of the one before."""
    return np.concatenate([np.ones(len(whole[:1]), bool), (np.diff(whole[:, :2], axis=0) != 0).any(axis=1)])


def _find_rising(numbers: np.ndarray, strictly: bool) -> np.ndarray:
    """The most numbers (n,), as a mask, that can be kept so that they rise, or at least do not fall."""
    steps = np.diff(numbers)
    if (steps > 0).all() if strictly else (steps >= 0).all():
        return np.ones(len(numbers), bool)
    bisect = bisect_left if strictly else bisect_right
    ends, at, before = [], [], np.full(len(numbers), -1)  # the smallest last number of each length, where it is
    for index, number in enumerate(numbers.tolist()):
        length = bisect(ends, number)
        before[index] = at[length - 1] if length else -1
        ends[length : length + 1], at[length : length + 1] = [number], [index]
    kept, index = np.zeros(len(numbers), bool), at[-1]
    while index >= 0:
        kept[index] = True
        index = before[index]
    return kept


@dataclass(frozen=True)
class Pace:
    """How fast the wheels usually turn.

    Attributes:
        inside: Median speed on segments [ticks/s].
        between: Median speed between segments, or that on them if it is higher [ticks/s].
        forward: Which way each wheel turns on segments (2,): 1, -1, or 0 where it turns both ways.
        turn: Way of a wheel in the turns that are allowed between segments [ticks].
        gap_noise: Of gaps, as a fraction of them.
        slip: Of ways [ticks] by the square root of the way [ticks].
    """

    inside: float
    between: float
    forward: np.ndarray
    turn: float
    gap_noise: float
    slip: float

    def fits(self, gap: np.ndarray, seconds: np.ndarray, inside: np.ndarray) -> np.ndarray:
        """Which gaps (n, 2) [ticks] can be, that take so many seconds (n,) and lie on a segment or not (n,)."""
        far = FASTER * np.where(inside, self.inside, self.between) * seconds + np.where(inside, 0.0, self.turn)
        back = np.where(inside[:, None] & (self.forward != 0), 0.0, far[:, None])
        ahead = gap.astype(float) * np.where(self.forward == 0, 1, self.forward)
        return (ahead <= (far + self._noise(far))[:, None]) & (ahead >= -back - self._noise(far)[:, None])

    def _noise(self, way: np.ndarray) -> np.ndarray:
        return DEVIATIONS * (self.gap_noise * way + self.slip * np.sqrt(way)) + ROUNDING


def _measure_pace(gap: np.ndarray, seconds: np.ndarray, inside: np.ndarray, odometry: Mapping[str, Any]) -> Pace:
    speed = np.abs(gap.astype(float)) / seconds[:, None]
    usual = _median(speed[inside], LARGEST)
    tick_m = float(ticks_to_distance(np.array(1), odometry["wheel_radius_m"], int(odometry["ticks_per_rev"])))
    ahead, back = (((sign * gap[inside]) > 0).sum(axis=0) for sign in (1, -1))
    most = ONE_WAY * (ahead + back)
    return Pace(
        inside=usual,
        between=max(usual, _median(speed[~inside], 0.0)),
        forward=(ahead > most).astype(int) - (back > most),
        turn=TURNS * np.pi * odometry["track_m"] / tick_m,
        gap_noise=odometry.get("gap_noise", 0.0),
        slip=odometry.get("slip_per_m", 0.0) / np.sqrt(tick_m),
    )


def _median(speed: np.ndarray, otherwise: float) -> float:
    """Median of the speeds of wheels that turned."""
    turned = speed[speed > 0]
    return float(np.median(turned)) if len(turned) else otherwise


def _check_ticks(
    table: np.ndarray, clock: np.ndarray, odometry: Mapping[str, Any]
) -> tuple[np.ndarray, np.ndarray, int, int]:
    """Unwrap ticks and find jumps and breaks; returns the table (K, 4), what is left out (n,), wraps and breaks."""
    ticks, segment = table[:, 2:], table[:, 0]
    gap, seconds, inside = np.diff(ticks, axis=0), np.diff(clock), np.diff(segment) == 0
    pace = _measure_pace(gap, seconds, inside, odometry)
    unwrapped = _unwrap(ticks, gap, pace, seconds, inside)
    wrapped = int((unwrapped != gap).any(axis=1).sum())
    if wrapped:
        ticks = ticks[0] + np.concatenate([np.zeros((1, 2), np.int64), np.cumsum(unwrapped, axis=0)])
    jumped, broken = _find_jumps(ticks, clock, segment, pace)
    if not (wrapped or jumped.any() or len(broken)):
        return table, jumped, 0, 0
    left = np.flatnonzero(~jumped)
    gap, divided = np.diff(ticks[left], axis=0), np.isin(left[1:], broken)
    gap[divided] = 0
    ticks = ticks[left[0]] + np.concatenate([np.zeros((1, 2), np.int64), np.cumsum(gap, axis=0)])
    number = segment[left] + np.concatenate([[0], np.cumsum(divided & (np.diff(segment[left]) == 0))])
    return np.column_stack([number, table[left, 1], ticks]), jumped, wrapped, len(broken)


def _unwrap(
    ticks: np.ndarray, gap: np.ndarray, pace: Pace, seconds: np.ndarray, inside: np.ndarray
) -> np.ndarray:
    """The gaps (n, 2) with those made whole at which a counter wrapped around.

    A gap is taken for a wrap if it cannot be and fits once it is made whole. Of a counter that never leaves the range of
    its width, a gap on a segment need only turn the other way than most; and if there is any such, then every gap that
    is longer than half of that range is a wrap.
    """
    found = gap.copy()
    most = np.sign(np.median(found[inside], axis=0)) if inside.any() else np.zeros(2)
    for width in WIDTHS:
        full = 1 << width
        short = (found + full // 2) % full - full // 2
        able = (short != found) & pace.fits(short, seconds, inside)
        wrap = able & ~pace.fits(found, seconds, inside)
        low, high = ticks.min(axis=0), ticks.max(axis=0)
        within = ((low >= 0) & (high < full)) | ((low >= -full // 2) & (high < full // 2))
        turns_back = inside[:, None] & (np.sign(found) * most < 0)
        narrow = within & (wrap | (able & turns_back)).any(axis=0)
        found = np.where(wrap | narrow, short, found)
    return found


def _find_jumps(
    ticks: np.ndarray, clock: np.ndarray, segment: np.ndarray, pace: Pace
) -> tuple[np.ndarray, np.ndarray]:
    """Which readings are left out (n,) bool, and the first reading (b,) after each gap that cannot be.

    Gaps that cannot be divide the readings into blocks. A few readings between two blocks that fit each other are left
    out, and so is a single one at either end.
    """

    def fits(first: np.ndarray, second: np.ndarray) -> np.ndarray:
        gap, seconds = ticks[second] - ticks[first], clock[second] - clock[first]
        return pace.fits(gap, seconds, segment[first] == segment[second]).all(axis=1)

    count = len(ticks)
    cut = np.flatnonzero(~fits(np.arange(count - 1), np.arange(1, count)))
    start, end = np.append(0, cut + 1), np.append(cut, count - 1)
    jumped, broken, block = np.zeros(count, bool), [], 0
    while block < len(cut):
        later = np.arange(block + 2, min(block + 2 + SPIKE, len(start)))
        later = later[start[later] - end[block] - 1 <= SPIKE]
        fitting = later[fits(np.full(len(later), end[block]), start[later])]
        if len(fitting):
            jumped[end[block] + 1 : start[fitting[0]]] = True
            block = int(fitting[0])
            continue
        if end[block] == 0:
            jumped[0] = True
        elif start[block + 1] == count - 1:
            jumped[-1] = True
        else:
            broken.append(start[block + 1])
        block += 1
    return jumped, np.array(broken, int)
