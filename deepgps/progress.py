"""Progress of long work: a function told (what, steps done, steps in all), and how to see what there is so far."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Protocol

import numpy as np

Look = Callable[[], Mapping[str, np.ndarray]]
"""Makes arrays of what there is so far; called by whoever wants to see it."""


class Report(Protocol):
    """Told what is done, its steps done and in all, and, by a training, how to see its history."""

    def __call__(self, label: str, done: int, total: int, look: Look | None = None, /) -> None: ...


def ignore(label: str, done: int, total: int, look: Look | None = None) -> None:
    """Say nothing."""


@contextmanager
def show_progress() -> Iterator[Report]:
    """A bar with rate and time left for each label; nothing where the output is no terminal."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    console = Console(stderr=True)
    columns = [
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    ]
    with Progress(*columns, console=console, disable=not console.is_terminal) as bars:
        tasks = {}

        def report(label: str, done: int, total: int, look: Look | None = None) -> None:
            if label not in tasks:
                tasks[label] = bars.add_task(label, total=total, rate="")
            speed = bars.tasks[tasks[label]].speed
            bars.update(tasks[label], completed=done, total=total, rate=f"{speed:.0f}/s" if speed else "")

        yield report
