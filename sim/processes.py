"""Worker processes: how many, out of reach of Ctrl-C, and none that outlives the process that started it."""

import ctypes
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import parent_process
from multiprocessing.context import SpawnContext, SpawnProcess
from multiprocessing.resource_tracker import ensure_running

ENDINGS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""The signals that end a command."""
OF_A_TERMINAL = (signal.SIGINT, signal.SIGHUP)
"""Those that a terminal sends to every process of a command, where only the first one is to answer."""


class Worker(SpawnProcess):
    """A process that ignores the signals of a terminal from its first instruction on."""

    def start(self) -> None:
        ensure_running()  # its own start would unblock the signals
        with uninterrupted():  # a worker that was started by half would end with a traceback
            before = signal.pthread_sigmask(signal.SIG_BLOCK, OF_A_TERMINAL)  # which the new process inherits
            try:
                super().start()
            finally:
                signal.pthread_sigmask(signal.SIG_SETMASK, before)


class Workers(SpawnContext):
    """The context of multiprocessing that starts such processes."""

    Process = Worker


WORKERS = Workers()
_PR_SET_PDEATHSIG = 1  # sys/prctl.h


def usable_cores() -> int:
    """Cores that this process may use: of a machine's many, a container or a batch system may give it a few."""
    return len(os.sched_getaffinity(0))


def end_with_parent() -> None:
    """In a worker: end it when its parent is gone, also where the worker is stopped or hangs.

    Linux kills the worker when the thread that started it ends; elsewhere a thread of its own waits for the parent.
    """
    parent = parent_process()
    if parent is None:
        return
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
        if os.getppid() != parent.pid:  # it was gone before the kernel was asked
            os._exit(1)
    threading.Thread(target=_wait_and_end, daemon=True).start()


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


def _wait_and_end() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
