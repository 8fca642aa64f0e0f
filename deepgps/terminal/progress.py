"""Progress of long work: a callback with (label, steps done, total steps) and a view of the results so far."""

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    import numpy as np
    from rich.console import Console

Look = Callable[[], "Mapping[str, np.ndarray]"]
"""Return the results so far as arrays; only a callback that shows them calls this."""


class Report(Protocol):
    """A callback with a label, the steps done, their number and, in a training, a function returning its history."""

    def __call__(self, label: str, done: int, total: int, look: Look | None = None, /) -> None: ...


def ignore(label: str, done: int, total: int, look: Look | None = None) -> None:
    """Report nothing."""


@contextmanager
def show_progress(console: "Console", quiet_s: float = 0.0) -> Iterator[Report]:
    """Show a bar with rate and time left for each label, or plain lines if the console is not a terminal.

    Work that is usually finished at once gets no line about a label for ``quiet_s`` [s].
    """
    if console.is_terminal:
        with _show_bars(console) as report:
            yield report
    else:
        yield Lines(lambda line: console.print(line, markup=False, highlight=False, soft_wrap=True), quiet_s)


@dataclass
class _Stage:
    """What was reported of a label: steps done at its start and in its last line, and when [s]; None: no line yet."""

    first: int
    begun: float
    said: int | None = None
    at: float = 0.0


class Lines:
    """Reports each label's progress in lines: at its first and last step, at every tenth, and when it has been silent
    for 5 s and a tenth of its time, at most a minute; the first after ``quiet_s`` [s] by a clock [s].

    A label that begins again, as for each run of a study, has its time counted again.
    """

    def __init__(
        self, say: Callable[[str], object], quiet_s: float = 0.0, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._say, self._quiet_s, self._clock = say, quiet_s, clock
        self._stages: dict[str, _Stage] = {}

    def __call__(self, label: str, done: int, total: int, look: Look | None = None, /) -> None:
        """Report the steps done of a label, if a line is due."""
        now = self._clock()
        stage = self._stages.get(label)
        if stage is None or done < (stage.said or 0):
            stage = self._stages[label] = _Stage(done, now)
        if now - stage.begun >= self._quiet_s and self._is_due(stage, now, done, total):
            share = f" ({100 * done // total} %)" if total else ""
            self._say(f"{label}: {done:,} of {total:,}{share}{_write_speed(stage, now, done, total)}")
            stage.said, stage.at = done, now

    def _is_due(self, stage: _Stage, now: float, done: int, total: int) -> bool:
        if stage.said is None:
            return True
        tenths = 10 * done // max(total, 1) - 10 * stage.said // max(total, 1)
        silent = now - stage.at >= min(60.0, max(5.0, 0.1 * (now - stage.begun)))
        return done != stage.said and (done >= total or tenths > 0 or silent)


def _write_speed(stage: _Stage, now: float, done: int, total: int) -> str:
    """The rate and the time left, or, at the end, the time taken."""
    seconds = now - stage.begun
    if seconds <= 0 or done <= stage.first:
        return ""
    rate = (done - stage.first) / seconds
    end = f"took {write_time(seconds)}" if done >= total else f"{write_time((total - done) / rate)} left"
    return f", {rate:,.0f}/s, {end}" if rate >= 10 else f", {rate:.2g}/s, {end}"


def write_time(seconds: float) -> str:
    """A duration in seconds, minutes or hours, such as ``3 min 05 s``."""
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
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    ]
    with Progress(*columns, console=console) as bars:
        whole = bars.add_task("in all", total=None, rate="")  # its clock shows that work goes on between two stages
        tasks = {}

        def report(label: str, done: int, total: int, look: Look | None = None) -> None:
            if label not in tasks:
                tasks[label] = bars.add_task(label, total=total, rate="")
            speed = bars.tasks[tasks[label]].speed
            bars.update(tasks[label], completed=done, total=total, rate=f"{speed:.0f}/s" if speed else "")

        yield report
        bars.update(whole, total=1, completed=1)
