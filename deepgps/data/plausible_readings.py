"""Checks of readings: impossible ones are found without the ground truth, left out or repaired, and counted.

Readings are in the order driven: time increases, the numbers of segments and images never decrease, and the wheels turn
about as fast as they usually do (``plausible_ticks``). Readings that violate this come from a fault of the clock, of a
counter, or of the transmission. If nothing is wrong, the readings stay unchanged.
"""

from bisect import bisect_left, bisect_right
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from deepgps.data.plausible_ticks import LARGEST, check_ticks
from sim.errors import InputError
from sim.recording.format import Recording
from sim.recording.turns import from_array, lose_turns
from sim.sensors.encoder import check_odometry

COLUMNS = 4
FAULTS = {
    "not_a_number": "hold no number",
    "out_of_range": "belong to no observation",
    "repeated": "are repeated",
    "disordered": "are out of order",
    "jumps": "jump",
}
"""Reasons for leaving readings out, and their wording in messages."""


@dataclass(frozen=True)
class CheckedReadings:
    """The plausible readings.

    Attributes:
        reading: int64 (K, 4), as in ``Recording``; ticks unwrapped, and segments divided where the ticks break.
        kept: Mask (R,) bool of these among all readings.
        broken: Whether the gap before each is left out, as its ticks break (K,) bool.
        counts: ``kept``; the number left out for each of ``FAULTS``; ``wrapped``, gaps at which a counter wrapped
            around; ``breaks``, gaps that are left out.
    """

    reading: np.ndarray
    kept: np.ndarray
    broken: np.ndarray
    counts: dict[str, int]


def keep_plausible(recording: Recording) -> Recording:
    """Return the recording with only its plausible readings, and their counts.

    One of a log is returned as it is: the import has checked the wheels at their own rate.

    Raises:
        InputError: The readings have the wrong shape, or most of them are impossible.
    """
    if recording.readings is not None or recording.manifest.source == "log":
        return recording
    try:
        odometry = check_odometry(recording.manifest.odometry)
        checked = check_readings(recording.reading, recording.time, len(recording.observation), odometry)
    except InputError as error:
        raise InputError(f"{recording.folder}: {error}") from None
    if checked.reading is recording.reading:
        return replace(recording, readings=checked.counts)
    turns = recording.turns and lose_turns(recording.turns, recording.reading[:, 0], checked.kept)
    if turns is not None:  # ticks that break at a turn do not say by how much the wheels turned
        turns = from_array(turns.array[~checked.broken[turns.after]])
    time = recording.time[checked.kept]
    breaks = np.flatnonzero(checked.broken)
    return replace(recording, readings=checked.counts, breaks=breaks, reading=checked.reading, time=time, turns=turns)


def count_readings(recording: Recording) -> dict[str, dict[str, int]]:
    """Entries on the readings for ``training.json`` and ``metrics.json``; empty if they were not checked."""
    return {} if recording.readings is None else {"readings": recording.readings}


def count_left_out(counts: Mapping[str, int]) -> int:
    """Number of readings that were left out, since they cannot be."""
    return sum(counts.get(fault, 0) for fault in FAULTS)


def describe_readings(counts: Mapping[str, int]) -> str | None:
    """Describe in a sentence what was left out or repaired; None if nothing was."""
    parts = []
    if left_out := count_left_out(counts):
        total = counts["kept"] + left_out
        parts.append(f"{left_out} of {total} readings cannot be and are left out ({_say_why(counts)})")
    if wrapped := counts.get("wrapped", 0):
        parts.append(f"the counters of the wheels wrap around at {wrapped} gaps, which are unwrapped")
    if breaks := counts.get("breaks", 0):
        parts.append(f"the ticks break at {breaks} gaps, which are left out")
    sentence = "; ".join(parts)
    return f"{sentence[0].upper()}{sentence[1:]}." if sentence else None


def check_readings(
    reading: np.ndarray, time: np.ndarray, observations: int, odometry: Mapping[str, Any]
) -> CheckedReadings:
    """Find the plausible readings.

    Args:
        reading: (R, 4): segment, observation, cumulative left and right ticks, in the order driven.
        time: Time of each reading (R,) [s].
        observations: Number of observations.
        odometry: The manifest's odometry constants.

    Raises:
        InputError: ``reading`` or ``time`` has the wrong shape or type, or most of the readings are impossible.
    """
    _check_shapes(reading, time)
    whole, clock = _as_integers(reading), np.asarray(time, float)
    counts, left = dict.fromkeys(FAULTS, 0), np.arange(len(reading))

    def leave_out(fault: str, good: np.ndarray) -> None:
        nonlocal left
        counts[fault] += int((~good).sum())
        left = left[good]

    leave_out("not_a_number", np.isfinite(clock) & (whole == reading).all(axis=1))
    leave_out("out_of_range", (whole[left, 1] >= 0) & (whole[left, 1] < observations))
    leave_out("repeated", _find_fresh(whole[left]))
    for numbers, strictly in ((clock, True), (whole[:, 0], False), (whole[:, 1], False)):
        leave_out("disordered", _find_rising(numbers[left], strictly))
    _refuse_few(left, reading, counts)
    checked = check_ticks(whole[left, 2:], clock[left], whole[left, 0], odometry)
    leave_out("jumps", ~checked.jumped)
    _refuse_few(left, reading, counts)
    kept = np.zeros(len(reading), bool)
    kept[left] = True
    counts = {"kept": len(left), **counts, "wrapped": checked.wrapped, "breaks": int(checked.broken.sum())}
    if reading.dtype == np.int64 and counts["kept"] == len(reading) and not (counts["wrapped"] or counts["breaks"]):
        return CheckedReadings(reading, kept, checked.broken, counts)
    segment = whole[left, 0]
    divided = checked.broken & np.append(False, np.diff(segment) == 0)
    table = np.column_stack([segment + np.cumsum(divided), whole[left, 1], checked.ticks])
    return CheckedReadings(table, kept, checked.broken, counts)


def _check_shapes(reading: np.ndarray, time: np.ndarray) -> None:
    if reading.ndim != 2 or reading.shape[1] != COLUMNS or not len(reading):
        raise InputError(f"reading.npy has the shape {reading.shape}, but must have rows of {COLUMNS} numbers")
    if time.shape != reading.shape[:1]:
        raise InputError(f"time.npy has the shape {time.shape}, but reading.npy has {len(reading)} readings")
    for name, array in (("reading.npy", reading), ("time.npy", time)):
        if array.dtype.kind not in "iuf":
            raise InputError(f"{name} holds {array.dtype}, but must hold numbers")


def _as_integers(reading: np.ndarray) -> np.ndarray:
    """Readings as int64; a value that is not an integer becomes a different number."""
    if reading.dtype.kind != "f":
        return reading.astype(np.int64, copy=False)
    return np.where(np.abs(reading) < LARGEST, reading, 0.0).astype(np.int64)


def _find_fresh(whole: np.ndarray) -> np.ndarray:
    """Mask of readings (n,) that differ in any column from the one before."""
    return np.append(np.ones(len(whole[:1]), bool), (np.diff(whole, axis=0) != 0).any(axis=1))


def _find_rising(numbers: np.ndarray, strictly: bool) -> np.ndarray:
    """Mask of the longest subsequence of the numbers (n,) that rises, or at least does not fall."""
    step = np.diff(numbers)
    if (step > 0 if strictly else step >= 0).all():
        return np.ones(len(numbers), bool)
    bisect = bisect_left if strictly else bisect_right
    ends, places = [], []  # smallest end of a subsequence of each length, and its index
    before = np.full(len(numbers), -1)
    for place, number in enumerate(numbers.tolist()):
        length = bisect(ends, number)
        before[place] = places[length - 1] if length else -1
        ends[length : length + 1], places[length : length + 1] = [number], [place]
    kept, place = np.zeros(len(numbers), bool), places[-1]
    while place >= 0:
        kept[place] = True
        place = before[place]
    return kept


def _refuse_few(left: np.ndarray, reading: np.ndarray, counts: Mapping[str, int]) -> None:
    if 2 * len(left) < len(reading) or not len(left):
        raise InputError(
            f"reading.npy, time.npy: more than half of {len(reading)} readings are impossible ({_say_why(counts)}), so "
            "the others are not believed"
        )


def _say_why(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{counts[fault]} {words}" for fault, words in FAULTS.items() if counts.get(fault))
