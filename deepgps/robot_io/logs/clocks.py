"""One time for all topics of a log, by the stamps of their messages.

A message's delay is when it was logged minus its stamp. Messages that were logged together were held up on their way,
and only the one with the least delay tells the clock; of the others, stamps must lie between it and the one before. A
delay that changes while stamps advance evenly, as when a simulation halts, is no fault of the clock.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from scipy.ndimage import median_filter, minimum_filter

from sim.errors import InputError

MAX_STEP_S = 0.05  # Largest change of a delay, and difference between clocks, that goes unnoticed [s]
MAX_OUTLIER_SHARE = 0.01
TREND_MESSAGES = 21  # Messages whose median slope is the delay's local trend
GROUP_SHARE = 0.25  # Of the usual time between messages; those that are logged sooner after another were held up
NS = 1e-9
MIN_CLOCK_RATE = 0.01
"""Stamps that advance by less than this part of the time of logging are none: constant, or in another unit."""


@dataclass(frozen=True)
class Times:
    """Times of a topic's messages, in the order of the files."""

    topic: str
    log_s: np.ndarray  # When each was logged (n,) [s], from the first message of the log
    stamp_s: np.ndarray  # Its stamp (n,) [s], from the first stamp of the log; NaN where it is missing

    @cached_property
    def late_s(self) -> np.ndarray:
        """Delays (n,) [s], but for a constant of the log."""
        return self.log_s - self.stamp_s

    @cached_property
    def is_stamped(self) -> bool:
        """Whether most messages have a stamp, and stamps advance."""
        known = np.isfinite(self.stamp_s)
        if 2 * known.sum() <= len(known):
            return False
        stamped_s, logged_s = (np.ptp(np.percentile(values[known], (10, 90))) for values in (self.stamp_s, self.log_s))
        return bool(stamped_s >= MIN_CLOCK_RATE * logged_s)

    @cached_property
    def period_s(self) -> float:
        """Usual time between messages [s]."""
        return float(np.ptp(np.percentile(self.log_s, (5, 95)))) / max(0.9 * len(self.log_s), 1)

    @cached_property
    def groups(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Numbers of the stamped messages that were not held up, in the order of logging (k,), how many came up to each
        (n,), and a mask (n,) of those without a stamp, or that were held up and whose stamp cannot be right."""
        order = np.argsort(self.log_s, kind="stable")
        known = order[np.isfinite(self.stamp_s[order])]
        begins = np.diff(self.log_s[known], prepend=-np.inf) > GROUP_SHARE * self.period_s
        group = np.cumsum(begins) - 1
        prompt = known[np.lexsort((self.late_s[known], group))[begins]]
        stamp, after = self.stamp_s[known], self.stamp_s[prompt]
        before = np.concatenate([[-np.inf], after])[:-1]
        wrong, passed = np.ones(len(self.log_s), bool), np.zeros(len(self.log_s), int)
        passed[prompt] = np.append(np.flatnonzero(begins)[1:], len(known))
        wrong[known] = (stamp < before[group] - MAX_STEP_S) | (stamp > after[group] + MAX_STEP_S)
        wrong[prompt] = False
        return prompt, passed, wrong

    def find_changes(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Changes of the delay from one of some messages (k,) to the next, without its local trend, and of the stamp,
        without the usual one (k - 1,), (k - 1,) [s]."""
        given = self.late_s, self.log_s, self.stamp_s, self.groups[1]
        change, seconds, stamped, count = (np.diff(values[rows]) for values in given)
        if not len(change):
            return change, stamped
        change -= median_filter(change / seconds, TREND_MESSAGES) * seconds
        return change, stamped - np.median(stamped / count) * count

    @cached_property
    def outlier(self) -> np.ndarray:
        """Mask (n,) of the messages whose delay and stamp differ from those of both neighbours."""
        rows, _, wrong = self.groups
        found, (change, stamped) = wrong.copy(), self.find_changes(rows)
        if len(change):
            around = [(np.r_[-one[0], one], np.r_[one, -one[-1]]) for one in (change, stamped)]
            apart = np.min([np.abs(before - after) for before, after in around], axis=0) > 2 * MAX_STEP_S
            found[rows] = apart & (np.abs(np.add(*around[0])) <= MAX_STEP_S)
        return found

    @cached_property
    def plausible(self) -> np.ndarray:
        """Numbers of the messages that were not held up and are no outliers (k,)."""
        return self.groups[0][~self.outlier[self.groups[0]]]

    def find_fault(self) -> str | None:
        """What is wrong with the stamps, in words; None: nothing but a few outliers."""
        if not self.is_stamped:
            return f"{self.topic}: most messages have no stamp, or stamps do not advance"
        count, rows = int(self.outlier.sum()), self.plausible
        if count > max(MAX_OUTLIER_SHARE * len(self.log_s), 1):
            return (
                f"{self.topic}: {count} of {len(self.log_s)} messages are stamped otherwise than their neighbours, "
                f"first at {self.log_s[self.outlier].min():.1f} s"
            )
        change, stamped = self.find_changes(rows)
        steps = np.flatnonzero(np.minimum(np.abs(change), np.abs(stamped)) > MAX_STEP_S)
        if not len(steps):
            return None
        size, at_s = change[steps[0]], self.log_s[rows[steps[0] + 1]]
        how = f"{'back' if size > 0 else 'ahead'} by {abs(size):.3f} s at {at_s:.1f} s"
        return f"the clock of {self.topic} is set {how}" + (f", one of {len(steps)} times" if len(steps) > 1 else "")

    def compare(self, other: "Times") -> str | None:
        """How another topic's delays differ at the same instants, in words; None: both share a clock."""
        log_s, other_s = self.log_s[self.plausible], other.log_s[other.plausible]
        if not len(other_s) or not (inside := (log_s >= other_s[0]) & (log_s <= other_s[-1])).any():
            return None
        log_s, late_s = log_s[inside], self.late_s[self.plausible][inside]
        apart = late_s - np.interp(log_s, other_s, other.late_s[other.plausible])
        apart = median_filter(apart, TREND_MESSAGES)
        worst = int(np.argmax(np.abs(apart)))
        if abs(apart[worst]) < MAX_STEP_S + self.period_s + other.period_s:
            return None
        difference = f"differs from that of {self.topic} by {apart[worst]:+.3f} s at {log_s[worst]:.1f} s"
        return f"the clock of {other.topic} {difference}"

    def take_logged(self) -> tuple[np.ndarray, str | None]:
        """Times by the recorder's clock (n,) [s], and what is wrong with them: stamps advance otherwise.

        They are stamps plus the least delay around them, or where a stamp does not fit, when the message was logged.
        """
        log_s = self.log_s
        if not self.is_stamped:
            together = np.count_nonzero(np.diff(np.sort(log_s)) <= GROUP_SHARE * self.period_s)
            fault = f"{self.topic}: messages without stamps were logged in bursts"
            return log_s, fault if 2 * together > len(log_s) else None
        rows, _, wrong = self.groups
        least = minimum_filter(self.late_s[rows], TREND_MESSAGES)
        found = np.where(wrong, np.nan, self.stamp_s + np.interp(log_s, log_s[rows], least))
        found[rows] = np.where(self.late_s[rows] - least > MAX_STEP_S, log_s[rows], found[rows])
        uneven = int((np.abs(np.diff(found[rows]) - np.diff(self.stamp_s[rows])) > MAX_STEP_S).sum())
        fault = f"{self.topic}: times of logging and stamps advance differently at {uneven} of {len(log_s)} messages"
        return found, fault if uneven > max(MAX_OUTLIER_SHARE * len(log_s), 2) else None


class Clocked(NamedTuple):
    """Times of all topics by one clock."""

    time_s: dict[str, np.ndarray]  # Time of each message by topic (n,) [s]; NaN: not known
    notes: list[str]  # What was left out
    start_ns: int  # From when times count [ns since 1970]
    offset_s: Mapping[str, float]  # Median of logged minus stamped, by topic with stamps [s]


def choose_times(logs: Mapping[str, tuple[Any, Any]], logged: bool) -> Clocked:
    """Times of all topics by one clock: that of the stamps, or if ``logged`` the recorder's; from when messages were
    logged and their stamps [ns since 1970], where 0 is none.

    Raises InputError if clocks differ or jump, too many messages are outliers, or the times of logging are no better.
    """
    both = {topic: [np.asarray(one, np.int64) for one in two] for topic, two in logs.items()}
    log_ns = min(int(log.min()) for log, _ in both.values())
    stamp_ns = min((int(stamp[stamp != 0].min()) for _, stamp in both.values() if stamp.any()), default=log_ns)
    topics = [
        Times(topic, (log - log_ns) * NS, np.where(stamp == 0, np.nan, (stamp - stamp_ns) * NS))
        for topic, (log, stamp) in both.items()
    ]
    apart_s = (log_ns - stamp_ns) * NS
    offset_s = {one.topic: float(np.nanmedian(one.late_s)) + apart_s for one in topics if one.is_stamped}
    by_recorder = {one.topic: one.take_logged() for one in topics}
    unfit = next((why for _, why in by_recorder.values() if why), None)
    if logged and unfit:
        raise InputError(f"clocks: logged: {unfit}")
    if logged:
        return Clocked({topic: time_s for topic, (time_s, _) in by_recorder.items()}, [], log_ns, offset_s)
    faults = list(filter(None, [one.find_fault() for one in topics]))
    if not faults:
        faults = list(filter(None, [topics[0].compare(other) for other in topics[1:]]))
    if faults:
        way_out = f"nor do the times of logging help: {unfit}" if unfit else "clocks: logged takes the times of logging"
        raise InputError(f"{faults[0]}; {way_out}")
    notes = [
        f"{one.topic}: {one.outlier.sum()} messages are left out: their stamps are {MAX_STEP_S:g} s or more off"
        for one in topics
        if one.outlier.any()
    ]
    found = {one.topic: np.where(one.outlier, np.nan, one.stamp_s) for one in topics}
    return Clocked(found, notes, stamp_ns, offset_s)
