"""The gaps between consecutive readings, and what they show without a model: stuck wheels, ticks, readings lost."""

from dataclasses import dataclass, replace

import numpy as np

from deepgps.data.segments import find_stretches, travel
from sim.recording.format import Recording
from sim.recording.turns import KINDS
from sim.sensors.encoder import measure_tick

STUCK_TICKS, STUCK_M = 6, 0.3
"""A wheel is stuck where it counts nothing while the other one counts this many ticks and travels this far [m]."""
LEAST_TICKS = 2
"""A gap with fewer ticks of the moving wheel may show none of the other one by rounding alone."""
Z95 = 1.96


@dataclass(frozen=True)
class Stretch:
    """A stretch in which a wheel is stuck.

    Attributes:
        wheel: 0 left, 1 right.
        first: First gap of the stretch.
        last: Last gap, inclusive.
        doubtful: Gaps at its two ends that rounding alone may have emptied.
    """

    wheel: int
    first: int
    last: int
    doubtful: int


@dataclass(frozen=True)
class Gaps:
    """The G = R - 1 gaps between consecutive readings.

    Attributes:
        way: Distance by the left and the right wheel (G, 2) [m].
        seconds: Duration (G,) [s].
        made_of: Original gaps in each (G,); more than one where readings were lost.
        inside: Whether the gap is on a segment (G,) bool; the others are turns.
        stuck: Stretches in which a wheel is stuck.
        good: Whether no wheel is stuck in the gap or beside it (G,) bool.
        tick_m: Distance that a wheel travels between two counts [m].
    """

    way: np.ndarray
    seconds: np.ndarray
    made_of: np.ndarray
    inside: np.ndarray
    stuck: tuple[Stretch, ...]
    good: np.ndarray
    tick_m: float


def read_gaps(recording: Recording) -> Gaps:
    """Read the gaps of a recording."""
    reading, odometry = recording.reading, recording.manifest.odometry
    ticks = np.diff(reading[:, 2:], axis=0)
    step = max(int(np.gcd.reduce(np.abs(ticks), axis=None)), 1)
    tick_m = step * measure_tick(odometry)
    way, inside = np.diff(travel(reading[:, 2:], odometry), axis=0), np.diff(reading[:, 0]) == 0
    stuck = tuple(stretch for wheel in range(2) for stretch in find_stuck(way, inside, wheel, tick_m))
    good = np.ones(len(way), bool)
    for stretch in stuck:
        good[max(stretch.first - 1, 0) : stretch.last + 2] = False
    return Gaps(
        way=way,
        seconds=np.diff(recording.time),
        made_of=np.diff(reading[:, 1]).clip(1),
        inside=inside,
        stuck=stuck,
        good=good,
        tick_m=tick_m,
    )


def find_stuck(way: np.ndarray, inside: np.ndarray, wheel: int, tick_m: float) -> list[Stretch]:
    """Find the stretches in which a wheel counts nothing while the other one travels.

    Args:
        way: Distance by the left and the right wheel in each gap (G, 2) [m].
        inside: Whether the gap is on a segment (G,); in a turn one wheel may stand still.
        wheel: 0 left, 1 right.
        tick_m: Distance that a wheel travels between two counts [m].
    """
    other = np.abs(way[:, 1 - wheel]) * inside
    found = []
    for first, last in find_stretches(way[:, wheel] == 0.0).tolist():
        moved = other[first : last + 1]
        if moved.sum() >= max(STUCK_TICKS * tick_m, STUCK_M):
            clear = np.flatnonzero(moved >= LEAST_TICKS * tick_m)
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
