"""Worker processes of this machine, each of which does task after task, without a server."""

import logging
import traceback
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from multiprocessing import Pipe
from multiprocessing.connection import Connection, wait
from subprocess import Popen
from typing import NamedTuple, Protocol

from deepgps.studies.engine.worker import Failures
from deepgps.terminal.console import warn_plainly
from deepgps.terminal.streams import open_streams
from sim.errors import InputError, WorkError, one_line
from sim.processes import start_process

log = logging.getLogger(__name__)
Tell = Callable[[int], None]
"""Called with how much of a task is done."""


class Task(Protocol):
    """Work that is sent to another process, so its type must be importable."""

    @property
    def size(self) -> int:
        """How much work it is."""
        ...

    def __call__(self, tell: Tell) -> str | None:
        """Do it; returns why it failed, or None. It may raise that as well."""
        ...


class Update(NamedTuple):
    """Message of a worker process: how much of its task is done, whether the task has ended, and why it failed."""

    done: int
    ended: bool = False
    failure: str | None = None


def do_all(tasks: Mapping[str, Task], most: int, progress: Tell) -> Failures:
    """Do tasks, each in one of at most ``most`` worker processes.

    Args:
        tasks: The tasks, by a name.
        most: Most worker processes at once.
        progress: Called with the work done, summed over all tasks.

    Returns:
        Reasons why tasks failed, by their names.
    """
    failed, done, waiting = {}, dict.fromkeys(tasks, 0), list(tasks)
    active: dict[Connection, tuple[str, Popen[bytes]]] = {}
    try:
        while waiting or active:
            while waiting and len(active) < most:
                pipe, process = _start()
                active[pipe] = _give(pipe, tasks, waiting), process
            for pipe in wait(list(active)):
                assert isinstance(pipe, Connection)
                name, process = active[pipe]
                try:
                    update = pipe.recv()
                except (EOFError, OSError):  # the process has died, perhaps before it had read what it was given
                    failed[name] = f"its process ended with {process.wait()}"
                    update = Update(0, ended=True)
                if update.failure:
                    failed[name] = update.failure
                done[name] = tasks[name].size if update.ended else min(update.done, tasks[name].size)
                progress(sum(done.values()))
                if update.ended and waiting and process.poll() is None:
                    active[pipe] = _give(pipe, tasks, waiting), process
                elif update.ended:
                    pipe.close()  # which ends the process
                    process.wait()
                    del active[pipe]
    finally:
        for _, process in active.values():
            process.kill()  # safe: files are written atomically
        for _, process in active.values():
            process.wait()
    return failed


def attempt(do: Callable[[], str | None]) -> str | None:
    """Do something and return why it failed, or None; a bug is returned too, so that other tasks go on."""
    try:
        return do()
    except (InputError, WorkError, OSError) as error:
        return one_line(error)
    except Exception as error:
        log.warning("%s", traceback.format_exc())
        return f"{type(error).__name__}: {one_line(error)}"


def work(handle: int) -> None:
    """Do the tasks that arrive through a pipe until it is closed; this is the main function of a worker process.

    Args:
        handle: File descriptor of the pipe.
    """
    open_streams()
    warn_plainly()
    pipe = Connection(handle)
    while True:
        try:
            task: Task = pipe.recv()
        except EOFError:  # the parent needs no more, or is gone
            return
        try:
            failure = attempt(partial(task, lambda done: pipe.send(Update(done))))
            pipe.send(Update(task.size, ended=True, failure=failure))
        except BrokenPipeError:  # the parent is gone
            return


def _start() -> tuple[Connection, Popen[bytes]]:
    pipe, end = Pipe()
    code = "from deepgps.studies.engine.pool import work; work(int(sys.argv[1]))"
    process = start_process(code, [str(end.fileno())], [end.fileno()])
    end.close()
    return pipe, process


def _give(pipe: Connection, tasks: Mapping[str, Task], waiting: list[str]) -> str:
    name = waiting.pop(0)
    with suppress(BrokenPipeError):  # the process has died, as reading from it will show
        pipe.send(tasks[name])
    return name
