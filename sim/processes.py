"""Worker processes: how many, out of reach of Ctrl-C, and none that outlives the process that started it."""

import os
import signal
import threading
from collections.abc import Iterable, Iterator
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


def usable_cores() -> int:
    """Cores that this process may use: of a machine's many, a container or a batch system may give it a few."""
    return len(os.sched_getaffinity(0))


def end_with_parent() -> None:
    """In a worker: end it when its parent is gone, be that killed before the first job came."""
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
