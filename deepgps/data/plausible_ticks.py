"""Checks of ticks: every gap between two consecutive readings is compared with the wheels' usual top speed.

A robot may drive fast for a small part of its way, so the top speed is a high percentile. Many gaps may be wrong, so it
is one of the speeds near the median, which changes only if half of all gaps are wrong. The known noise of the encoders
is allowed for.

- A counter of 16 or 32 bits that wrapped around is unwrapped, each wheel for itself.
- A few readings that are off, while those before and after them fit each other, are left out ("jumps").
- Where the following readings never fit the previous ones, as after a counter reset, the gap is left out ("breaks"): a
  segment is divided there, and the dead-reckoned path continues from the same place.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from sim.errors import InputError
from sim.sensors.encoder import measure_tick

TOP = 95
"""Percentile of the speeds that counts as the usual top speed."""
MOST_APART = 6.0
"""Speeds that are larger multiples of the median have no part in the top speed."""
FASTER = 2.0
"""Largest speed of a wheel, as a multiple of the usual top speed."""
DEVIATIONS = 6.0
"""Standard deviations of known noise that a gap may be off by."""
ROUNDING = 3
"""Ticks that a gap of any length may be off by."""
TURNS = 1.0
"""Full turns in place that a robot may make between two segments, in any time."""
ONE_WAY = 0.9
"""Share of the gaps on segments that must have one direction before the other direction counts as a fault."""
SPIKE = 6
"""Most consecutive readings that are left out because those around them fit each other."""
WIDTHS = (16, 32)
"""Bits of counters that wrap around."""
APART = 0.1
"""Share of their usual speeds by which the wheels may differ on a segment where a counter is unwrapped."""
LARGEST = 2.0**63
"""Upper limit of a difference of ticks."""
FASTEST_MPS = 30.0
"""Highest credible median speed of a robot in a room [m/s]."""
ENOUGH = 100
"""If one wheel turns in so many gaps and the other in none, the other's counter counts as dead."""
MOST_WRONG = 0.1
"""Share of the readings that may be jumps and breaks; with more, all ticks are refused."""


@dataclass(frozen=True)
class CheckedTicks:
    """The plausible ticks.

    Attributes:
        ticks: Cumulative ticks (K, 2) int64 of the readings kept, unwrapped; the ticks do not change across a break.
        jumped: Mask of readings that are left out (n,) bool.
        broken: Mask of kept readings that follow a break (K,) bool.
        wrapped: Gaps at which a counter wrapped around.
    """

    ticks: np.ndarray
    jumped: np.ndarray
    broken: np.ndarray
    wrapped: int


def check_ticks(ticks: np.ndarray, time: np.ndarray, segment: np.ndarray, odometry: Mapping[str, Any]) -> CheckedTicks:
    """Unwrap ticks, and find jumps and breaks.

    Args:
        ticks: Cumulative ticks (n, 2) int64, in the order driven; at least one.
        time: Time of each reading (n,) [s], increasing.
        segment: Segment of each reading (n,).
        odometry: The manifest's odometry constants.

    Raises:
        InputError: A wheel's counter is dead, the wheels are faster than any robot, or too many gaps are impossible.
    """
    gap, seconds, inside = np.diff(ticks, axis=0), np.diff(time), np.diff(segment) == 0
    pace = measure_pace(gap, seconds, inside, odometry)
    _refuse_nonsense(gap[inside], pace, odometry)
    whole = unwrap(ticks, gap, seconds, inside, pace)
    wrapped = int((whole != gap).any(axis=1).sum())
    if wrapped:
        ticks = _add_up(ticks[0], whole)
    jumped, broken = find_jumps(ticks, time, segment, pace)
    if (wrong := int(jumped.sum() + broken.sum())) > max(1.0, MOST_WRONG * len(ticks)):
        raise InputError(
            f"reading.npy: at {wrong} of {len(ticks)} readings the ticks jump, so they are no counts of wheels"
        )
    ticks, broken = ticks[~jumped], broken[~jumped]
    if broken.any():
        gap = np.diff(ticks, axis=0)
        gap[broken[1:]] = 0
        ticks = _add_up(ticks[0], gap)
    return CheckedTicks(ticks, jumped, broken, wrapped)


@dataclass(frozen=True)
class Pace:
    """How fast the wheels usually turn.

    Attributes:
        median: Median speed on segments [ticks/s].
        each: Median speed of each wheel on segments (2,) [ticks/s].
        inside: Usual top speed on segments [ticks/s].
        between: Median speed between segments, or the top speed on segments if it is higher [ticks/s].
        forward: Direction of each wheel on segments (2,): 1, -1, or 0 if it turns in both.
        turn: Distance of a wheel in the turns that are allowed between segments [ticks].
        step_noise: Standard deviation of a gap, as a fraction of it.
        slip: Standard deviation of a distance [ticks] over the square root of the distance [ticks].
    """

    median: float
    each: np.ndarray
    inside: float
    between: float
    forward: np.ndarray
    turn: float
    step_noise: float
    slip: float

    def fits(self, gap: np.ndarray, seconds: np.ndarray, inside: np.ndarray) -> np.ndarray:
        """Whether gaps (n, 2) [ticks] are possible, given their durations (n,) [s] and whether each is on a segment.

        On a segment the robot drives straight on: no wheel turns backwards, and never one against the other.
        """
        speed, turn = np.where(inside, self.inside, self.between), np.where(inside, 0.0, self.turn)
        far = (FASTER * speed * seconds + turn)[:, None]
        noise = DEVIATIONS * (self.step_noise * far + self.slip * np.sqrt(far)) + ROUNDING
        one_way = inside[:, None] & (self.forward != 0)
        ahead = gap.astype(float) * np.where(self.forward == 0, 1, self.forward)
        turned = (inside & (np.abs(gap) > noise).all(axis=1) & (np.sign(gap).prod(axis=1) < 0))[:, None]
        return (ahead <= far + noise) & (ahead >= np.where(one_way, 0.0, -far) - noise) & ~turned

    def is_straight(self, gap: np.ndarray, seconds: np.ndarray) -> np.ndarray:
        """Whether the wheels agree in gaps (n, 2) [ticks]: both turn at about the same share of their usual speeds."""
        usual = self.each * seconds[:, None]
        slipped = DEVIATIONS * self.slip * np.sqrt(usual) + ROUNDING
        share = np.abs(gap) / usual
        return np.abs(share[:, 0] - share[:, 1]) <= APART + (slipped / usual).sum(axis=1)


def measure_pace(gap: np.ndarray, seconds: np.ndarray, inside: np.ndarray, odometry: Mapping[str, Any]) -> Pace:
    """Measure the pace from gaps (n, 2) [ticks], their durations (n,) [s] and whether they are on a segment (n,)."""
    speed = np.abs(gap.astype(float)) / seconds[:, None]
    usual = _median(speed[inside], LARGEST)
    credible = speed[inside][(speed[inside] > 0) & (speed[inside] <= MOST_APART * usual)]
    top = float(np.percentile(credible, TOP)) if len(credible) else usual
    tick_m = measure_tick(odometry)
    ahead, back = (((sign * gap[inside]) > 0).sum(axis=0) for sign in (1, -1))
    most = ONE_WAY * (ahead + back)
    return Pace(
        median=usual,
        each=np.array([_median(speed[inside, wheel], usual) for wheel in range(2)]),
        inside=top,
        between=max(top, _median(speed[~inside], 0.0)),
        forward=(ahead > most).astype(int) - (back > most),
        turn=TURNS * np.pi * odometry["track_m"] / tick_m,
        step_noise=odometry.get("step_noise", 0.0),
        slip=odometry.get("slip_per_m", 0.0) / np.sqrt(tick_m),
    )


def unwrap(ticks: np.ndarray, gap: np.ndarray, seconds: np.ndarray, inside: np.ndarray, pace: Pace) -> np.ndarray:
    """Return the gaps (n, 2) with those unwrapped at which a counter wrapped around.

    A gap counts as a wrap if it is impossible and fits once it is unwrapped. For a counter that never leaves the range
    of its width, it is enough that a gap on a segment turns against the usual direction; and if there is any wrap, then
    every gap that is longer than half of that range is one.
    """
    found = gap.copy()
    most = np.sign(np.median(found[inside], axis=0)) if inside.any() else np.zeros(2)
    for width in WIDTHS:
        full = 1 << width
        short = (found + full // 2) % full - full // 2
        able = (np.abs(short.astype(float) - found) == full) & pace.fits(short, seconds, inside)
        able &= (~inside | pace.is_straight(np.where(able, short, found), seconds))[:, None]
        wrap = able & ~pace.fits(found, seconds, inside)
        low, high = ticks.min(axis=0), ticks.max(axis=0)
        within = ((low >= 0) & (high < full)) | ((low >= -full // 2) & (high < full // 2))
        turns_back = inside[:, None] & (np.sign(found) * most < 0)
        narrow = within & (wrap | (able & turns_back)).any(axis=0)
        found = np.where(wrap | narrow, short, found)
    return found


def find_jumps(ticks: np.ndarray, time: np.ndarray, segment: np.ndarray, pace: Pace) -> tuple[np.ndarray, np.ndarray]:
    """Masks (n,) bool of the readings that are left out and of those that follow an impossible gap.

    Impossible gaps divide the readings into blocks. A few readings between two blocks that fit each other are left out,
    and so is a single one at either end.
    """

    def fits(first: np.ndarray, second: np.ndarray) -> np.ndarray:
        gap, seconds = ticks[second] - ticks[first], time[second] - time[first]
        return np.asarray(pace.fits(gap, seconds, segment[first] == segment[second]).all(axis=1))

    count = len(ticks)
    jumped, broken, block = np.zeros(count, bool), np.zeros(count, bool), 0
    cut = np.flatnonzero(~fits(np.arange(count - 1), np.arange(1, count)))
    start, end = np.append(0, cut + 1), np.append(cut, count - 1)
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
            broken[start[block + 1]] = True
        block += 1
    return jumped, broken


def _refuse_nonsense(gap: np.ndarray, pace: Pace, odometry: Mapping[str, Any]) -> None:
    turned = (gap != 0).sum(axis=0)
    for name, own, other in (("left", *turned), ("right", *turned[::-1])):
        if own == 0 and other >= ENOUGH:
            raise InputError(
                f"reading.npy: the {name} wheel never counts on a segment, while the other does {other} times"
            )
    speed_mps = pace.median * measure_tick(odometry)
    if turned.any() and speed_mps > FASTEST_MPS:
        raise InputError(
            f"reading.npy, time.npy: the wheels drive {speed_mps:.3g} m/s in the median, and more than "
            f"{FASTEST_MPS:g} m/s is not believed; ticks, times or the manifest's odometry are wrong"
        )


def _median(speed: np.ndarray, otherwise: float) -> float:
    """Median of the positive speeds; ``otherwise`` if there are none."""
    turned = speed[speed > 0]
    return float(np.median(turned)) if len(turned) else otherwise


def _add_up(first: np.ndarray, gap: np.ndarray) -> np.ndarray:
    """Cumulative ticks (n + 1, 2) from the first ones (2,) and the gaps (n, 2)."""
    return first + np.concatenate([np.zeros((1, 2), np.int64), np.cumsum(gap, axis=0)])
