"""Worker processes of this machine, each of which does task after task."""

import logging
import multiprocessing
import traceback
from collections.abc import Callable, Iterator, Mapping, MutableSequence, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from typing import Protocol

from deepgps.terminal.console import warn_plainly
from deepgps.terminal.streams import open_streams
from sim.errors import InputError, WorkError, one_line
from sim.processes import WORKERS

log = logging.getLogger(__name__)
Failures = dict[str, str]  # Reasons why runs failed, by the hash of the run
Tell = Callable[[int], None]  # Called with how much of a task is done
PERIOD_S = 0.2  # Time between two looks at the progress of the workers [s]
NO_PROGRESS = -1
KILL_NOTE = "its process was killed, perhaps for lack of memory"
_SHARED_PROGRESS: list[MutableSequence[int]] = []
"""In a worker process, which an initializer can reach in no other way: how much of each task is done."""


class Task(Protocol):
    """Work that is sent to another process, so its type must be importable."""

    @property
    def size(self) -> int:
        """How much work it is."""
        ...

    def __call__(self, tell: Tell) -> str | None:
        """Do it; returns why it failed, or None. It may raise that as well."""
        ...


def do_all(tasks: Mapping[str, Task], most: int, progress: Tell) -> Failures:
    """Do tasks, each in one of at most ``most`` worker processes; a task whose process dies fails alone.

    Progress is the work done, summed over all tasks. Returns the reasons why tasks failed, by their names; raises
    WorkError if no worker process can be started.
    """
    names, results = list(tasks), dict[str, str | None]()
    done = WORKERS.RawArray("q", [NO_PROGRESS] * len(names))

    def do_some(some: Sequence[str], most: int) -> None:
        """Do these tasks; ends early if a process dies."""
        with _open_pool(most, done) as pool:
            running = {pool.submit(_do, tasks[name], names.index(name)): name for name in some}
            while running:
                for future in wait(running, PERIOD_S, FIRST_COMPLETED).done:
                    results[running.pop(future)] = future.result()
                shares = (task.size if name in results else done[names.index(name)] for name, task in tasks.items())
                progress(sum(min(max(share, 0), task.size) for share, task in zip(shares, tasks.values(), strict=True)))

    while left := [name for name in names if name not in results]:
        try:
            do_some(left, most)
        except BrokenProcessPool:
            begun = [name for name in left if name not in results and done[names.index(name)] != NO_PROGRESS]
            if not begun:
                raise WorkError("no worker process can be started here") from None
            for name in begun:  # alone, it shows whose process it was
                try:
                    do_some([name], 1)
                except BrokenProcessPool:
                    results[name] = KILL_NOTE
    return {name: reason for name, reason in results.items() if reason}


def attempt(do: Callable[[], str | None]) -> str | None:
    """Do something and return why it failed, or None; a bug is returned too, so that other tasks go on."""
    try:
        return do()
    except (InputError, WorkError, OSError) as error:
        return one_line(error)
    except Exception as error:
        log.warning("%s", traceback.format_exc())
        return f"{type(error).__name__}: {one_line(error)}"


@contextmanager
def _open_pool(most: int, done: MutableSequence[int]) -> Iterator[ProcessPoolExecutor]:
    """A pool whose processes end at once if the context is left by an exception, such as Ctrl-C."""
    before = set(multiprocessing.active_children())
    with ProcessPoolExecutor(most, WORKERS, _begin, (done,)) as pool:
        try:
            yield pool
        except BaseException:
            for child in set(multiprocessing.active_children()) - before:
                child.kill()  # safe: files are written atomically
            raise


def _begin(done: MutableSequence[int]) -> None:
    _SHARED_PROGRESS.append(done)
    open_streams()
    warn_plainly()


def _do(task: Task, number: int) -> str | None:
    (done,) = _SHARED_PROGRESS
    done[number] = 0
    return attempt(partial(task, partial(done.__setitem__, number)))
