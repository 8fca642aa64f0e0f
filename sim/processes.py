"""Worker processes: how many, out of reach of Ctrl-C, and none that outlives the process that started it."""

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

ENDINGS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""The signals that end a command."""
OF_A_TERMINAL = (signal.SIGINT, signal.SIGHUP)
"""Those that a terminal sends to every process of a command, where only the first one is to answer."""


class Worker(SpawnProcess):
    """A process that ignores the signals of a terminal from its first instruction on."""

    def start(self) -> None:
        _start_tracker()
        with uninterrupted(), _blocked(OF_A_TERMINAL):  # a worker that was started by half would end with a traceback
            super().start()


class Workers(SpawnContext):
    """The context of multiprocessing that starts such processes."""

    Process = Worker

    def get_context(self, method: str | None = None) -> Any:
        """This context, as every lock and queue asks for it before it is made."""
        _start_tracker()
        return super().get_context(method)


WORKERS = Workers()
_PR_SET_PDEATHSIG = 1  # sys/prctl.h


def usable_cores() -> int:
    """Cores that this process may use: of a machine's many, a container or a batch system may give it a few."""
    return len(os.sched_getaffinity(0))


def end_with_parent() -> None:
    """In a worker of multiprocessing: end it when its parent is gone, also where it is stopped or hangs."""
    parent = parent_process()
    if parent is not None:
        end_with(parent.pid or 0)
        threading.Thread(target=_wait_and_end, daemon=True).start()  # where there is no such call


def end_with(parent: int) -> None:
    """Let Linux kill this process when the thread that started it ends, even if this one is stopped then.

    Args:
        parent: Number of the process that started this one; if it is gone already, so is this one.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
        if os.getppid() != parent:
            os._exit(1)


def start_process(code: str, words: Sequence[str], handles: Sequence[int]) -> subprocess.Popen[bytes]:
    """Start Python on a line of code in a process that ends with this one and ignores the signals of a terminal.

    A process of multiprocessing imports the main module first, and until then it may outlive its parent.

    Args:
        code: What it runs.
        words: What it finds in ``sys.argv[1:]``.
        handles: Open files that it gets.
    """
    first = (
        "import sys; n = int(sys.argv.pop(1)); sys.path[:] = sys.argv[1:1 + n]; del sys.argv[1:1 + n]; "
        f"from sim.processes import end_with; end_with({os.getpid()}); "
    )
    command = [sys.executable, "-c", first + code, str(len(sys.path)), *sys.path, *words]
    with uninterrupted(), _blocked(OF_A_TERMINAL):
        return subprocess.Popen(command, stdin=subprocess.DEVNULL, pass_fds=handles)


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Let signals that end a command wait until this is left."""
    if threading.current_thread() is not threading.main_thread():  # which no handler interrupts
        yield
        return
    came: list[int] = []
    before = {number: signal.signal(number, lambda number, _: came.append(number)) for number in ENDINGS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for number in came:
            signal.raise_signal(number)


def _start_tracker() -> None:
    """Start the process that multiprocessing has beside a command: it ignores all signals of a terminal but SIGHUP."""
    with uninterrupted(), _blocked((signal.SIGHUP,)):
        ensure_running()


@contextmanager
def _blocked(signals: Iterable[signal.Signals]) -> Iterator[None]:
    """Block signals in this thread, and for good in the processes that it starts meanwhile."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, signals)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _wait_and_end() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
