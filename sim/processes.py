"""Worker processes: their number, protection from Ctrl-C, and their end with the process that started them."""

import ctypes
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from multiprocessing import parent_process
from multiprocessing.context import SpawnContext, SpawnProcess
from multiprocessing.resource_tracker import ensure_running
from typing import Any

END_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)  # The signals that end a command
TERMINAL_SIGNALS = (signal.SIGINT, signal.SIGHUP)
"""Signals that a terminal sends to every process of a command, although only the first should react."""


class Worker(SpawnProcess):
    """A process that ignores the terminal's signals from its first instruction on, and ends with its parent."""

    def start(self) -> None:
        _start_tracker()
        with uninterrupted(), _blocked(TERMINAL_SIGNALS):  # a half-started worker would end with a traceback
            super().start()

    def run(self) -> None:
        if parent := parent_process():
            end_with(parent.pid or 0)
        super().run()


class Workers(SpawnContext):
    """A multiprocessing context that starts processes of type ``Worker``."""

    Process = Worker

    def get_context(self, method: str | None = None) -> Any:
        """Return this context, with the resource tracker started; every new lock and queue calls this first."""
        _start_tracker()
        return super().get_context(method)


WORKERS = Workers()
_PR_SET_PDEATHSIG = 1  # sys/prctl.h


def usable_cores() -> int:
    """Number of cores that this process may use; containers and batch systems may restrict it to a few."""
    return len(os.sched_getaffinity(0))


def end_with(parent: int) -> None:
    """Let Linux kill this process when the thread of its parent that started it ends, even if it is stopped then.

    If the parent has already ended, this process exits.
    """
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    if os.getppid() != parent:
        os._exit(1)


def start_process(code: str, words: Sequence[str], handles: Sequence[int]) -> subprocess.Popen[bytes]:
    """Run a line of Python code, with words and file descriptors, in a process that ends with this one.

    It ignores the terminal's signals. A process of multiprocessing imports the main module first, and may outlive us
    then.
    """
    first = (
        "import sys; n = int(sys.argv.pop(1)); sys.path[:] = sys.argv[1:1 + n]; del sys.argv[1:1 + n]; "
        f"from sim.processes import end_with; end_with({os.getpid()}); "
    )
    command = [sys.executable, "-c", first + code, str(len(sys.path)), *sys.path, *words]
    with uninterrupted(), _blocked(TERMINAL_SIGNALS):
        return subprocess.Popen(command, stdin=subprocess.DEVNULL, pass_fds=handles)


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Defer signals that end a command until the context exits."""
    if threading.current_thread() is not threading.main_thread():  # handlers interrupt only the main thread
        yield
        return
    came: list[int] = []
    before = {number: signal.signal(number, lambda number, _: came.append(number)) for number in END_SIGNALS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for number in came:
            signal.raise_signal(number)


def _start_tracker() -> None:
    """Start multiprocessing's resource tracker, which by itself ignores all of a terminal's signals except SIGHUP."""
    with uninterrupted(), _blocked((signal.SIGHUP,)):
        ensure_running()


@contextmanager
def _blocked(signals: Iterable[signal.Signals]) -> Iterator[None]:
    """Block signals in this thread, and permanently in the processes that it starts meanwhile."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, signals)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
