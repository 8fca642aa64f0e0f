"""Progress of long work: a callback with (label, steps done, total steps) and a view of the results so far."""

import threading
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
        lines = Lines(lambda line: console.print(line, markup=False, highlight=False, soft_wrap=True), quiet_s)
        over = threading.Event()
        beat = threading.Thread(target=lines.beat_until, args=(over,), daemon=True)
        beat.start()
        try:
            yield lines
        finally:
            over.set()
            beat.join()


@dataclass
class _Stage:
    """What was reported of a label."""

    first: int  # Steps done at its first report
    begun: float  # Time of that [s]
    at: float  # Time of its last line, or of its first report [s]
    said: int | None = None  # Steps done in its last line; None: it had none
    done: int = 0  # Steps done at its last report
    total: int = 0
    heard: float = 0.0  # Time of that [s]


class Lines:
    """Reports each label's progress in lines: at its first and last step, at every tenth, and when nothing was said for
    4 s and 3 % of its time, at most a minute; the first after ``quiet_s`` [s] by a clock [s].

    A label that begins again, as for each run of a study, has its time counted again.
    """

    def __init__(
        self, say: Callable[[str], object], quiet_s: float = 0.0, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._say, self._quiet_s, self._clock = say, quiet_s, clock
        self._stages: dict[str, _Stage] = {}
        self._last = ""

    def __call__(self, label: str, done: int, total: int, look: Look | None = None, /) -> None:
        """Report the steps done of a label, if a line is due."""
        now = self._clock()
        stage = self._stages.get(label)
        if stage is None or done < (stage.said or 0):
            stage = self._stages[label] = _Stage(done, now, at=now)
        self._last, stage.done, stage.total, stage.heard = label, done, total, now
        if now - stage.begun >= self._quiet_s and _is_due(stage, now):
            self._say(f"{_write_stage(label, stage)}{_write_speed(stage, now)}")
            stage.said, stage.at = done, now

    def beat_until(self, over: threading.Event) -> None:
        """Say that work goes on when there was no report for long, until it is over."""
        while not over.wait(1.0):
            self.beat()

    def beat(self) -> None:
        """Say that work goes on if nothing was said of the label that was reported last for long."""
        now, stage = self._clock(), self._stages.get(self._last)
        if stage and _is_silent(stage, now):
            self._say(f"{_write_stage(self._last, stage)}, still at work after {write_time(now - _since(stage))}")
            stage.at = now


def _is_due(stage: _Stage, now: float) -> bool:
    if stage.said is None:
        return True
    tenths = 10 * stage.done // max(stage.total, 1) - 10 * stage.said // max(stage.total, 1)
    return stage.done != stage.said and (stage.done >= stage.total or tenths > 0 or _is_silent(stage, now))


def _is_silent(stage: _Stage, now: float) -> bool:
    return now - stage.at >= min(60.0, max(4.0, 0.03 * (now - _since(stage))))


def _since(stage: _Stage) -> float:
    """When the work began [s]: work that has no label follows a finished one."""
    return stage.begun if stage.done < stage.total else stage.heard


def _write_stage(label: str, stage: _Stage) -> str:
    share = f" ({100 * stage.done // stage.total} %)" if stage.total else ""
    return f"{label}: {stage.done:,} of {stage.total:,}{share}"


def _write_speed(stage: _Stage, now: float) -> str:
    """The rate and the time left, or, at the end, the time taken."""
    seconds, left = now - stage.begun, stage.total - stage.done
    if seconds <= 0 or stage.done <= stage.first:
        return ""
    rate = (stage.done - stage.first) / seconds
    end = f"took {write_time(seconds)}" if left <= 0 else f"{write_time(left / rate)} left"
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
