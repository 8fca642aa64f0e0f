"""Progress of long work: a function told (what, steps done, steps in all), and how to see what there is so far."""

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

if TYPE_CHECKING:
    from rich.console import Console

Look = Callable[[], Mapping[str, np.ndarray]]
"""Makes arrays of what there is so far; called by whoever wants to see it."""


class Report(Protocol):
    """Told what is done, its steps done and in all, and, by a training, how to see its history."""

    def __call__(self, label: str, done: int, total: int, look: Look | None = None, /) -> None: ...


def ignore(label: str, done: int, total: int, look: Look | None = None) -> None:
    """Say nothing."""


@contextmanager
def show_progress(console: "Console", quiet_s: float = 0.0) -> Iterator[Report]:
    """A bar with rate and time left for each label; plain lines where the console is no terminal.

    Args:
        console: Where to.
        quiet_s: How long a label goes on before a line tells of it; for work that is mostly done at once.
    """
    if console.is_terminal:
        with _show_bars(console) as report:
            yield report
    else:
        yield Lines(lambda line: console.print(line, markup=False, highlight=False, soft_wrap=True), quiet_s)


@dataclass
class _Stage:
    """What was said of a label: steps done at first and at last, and when [s]; none: nothing yet."""

    first: int
    begun: float
    said: int | None = None
    at: float = 0.0


class Lines:
    """Says how far each label is: at its first and last step, at every tenth, and once a minute in long work.

    Args:
        say: Told each line.
        quiet_s: How long a label goes on before anything is said of it.
        clock: Seconds since some moment.
    """

    PERIOD_S = 60.0

    def __init__(
        self, say: Callable[[str], object], quiet_s: float = 0.0, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._say, self._quiet_s, self._clock = say, quiet_s, clock
        self._stages: dict[str, _Stage] = {}

    def __call__(self, label: str, done: int, total: int, look: Look | None = None, /) -> None:
        """Tell what is done of a label."""
        now = self._clock()
        stage = self._stages.setdefault(label, _Stage(done, now))
        if now - stage.begun >= self._quiet_s and self._is_due(stage, now, done, total):
            self._say(
                f"{label}: {done:,} of {total:,}{_write_share(done, total)}{_write_speed(stage, now, done, total)}"
            )
            stage.said, stage.at = done, now

    def _is_due(self, stage: _Stage, now: float, done: int, total: int) -> bool:
        if stage.said is None:
            return True
        tenths = 10 * done // max(total, 1) - 10 * stage.said // max(total, 1)
        return done != stage.said and (done >= total or tenths > 0 or now - stage.at >= self.PERIOD_S)


def _write_share(done: int, total: int) -> str:
    return f" ({100 * done // total} %)" if total else ""


def _write_speed(stage: _Stage, now: float, done: int, total: int) -> str:
    """The rate and the time left, or at the end the time that it took."""
    seconds = now - stage.begun
    if seconds <= 0 or done <= stage.first:
        return ""
    rate = (done - stage.first) / seconds
    end = f"took {write_time(seconds)}" if done >= total else f"{write_time((total - done) / rate)} left"
    return f", {rate:,.0f}/s, {end}" if rate >= 10 else f", {rate:.2g}/s, {end}"


def write_time(seconds: float) -> str:
    """A duration as people write it: seconds, minutes, hours."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02} min"


@contextmanager
def _show_bars(console: "Console") -> Iterator[Report]:
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = [
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    ]
    with Progress(*columns, console=console) as bars:
        tasks = {}

        def report(label: str, done: int, total: int, look: Look | None = None) -> None:
            if label not in tasks:
                tasks[label] = bars.add_task(label, total=total, rate="")
            speed = bars.tasks[tasks[label]].speed
            bars.update(tasks[label], completed=done, total=total, rate=f"{speed:.0f}/s" if speed else "")

        yield report
