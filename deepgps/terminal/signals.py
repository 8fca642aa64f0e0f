"""Ending a command by a signal: one line, no process left behind, and an exit code of 128 plus the signal's number.

Python by default raises an exception anywhere and prints a traceback from each process. Here only the main process of a
command responds. Until its packages are imported it exits at once; after that, the handler raises ``Stopped``.
"""

import _thread
import os
import signal
import sys
import threading
import time
from collections.abc import Sequence
from multiprocessing import active_children
from types import FrameType

from sim.processes import ENDINGS

AGAIN_S = 0.2
"""Interval at which a signal is repeated until it is noticed: some packages continue after any exception in their
imports."""
PATIENCE_S = 10.0
"""Time for cleaning up after which a further signal ends the process at once."""
LIMIT_S = 20.0
"""Time limit for cleaning up: every file is intact at any time, and a package may wait for ever."""
CONTINUED = ("run", "collect", "train", "evaluate", "study")
WORDS = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated", signal.SIGHUP: "hung up"}


class Stopped(KeyboardInterrupt):
    """Raised when a signal ends the command; a package may turn it into a plain KeyboardInterrupt."""


def leave_at_signals() -> None:
    """From now on, end the process at once at a signal; a signal that is ignored, as under nohup, stays ignored."""
    for number in ENDINGS:
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, _leave)


def stop_at_signals() -> None:
    """From now on, raise ``Stopped`` in the main thread at a signal that ``leave_at_signals`` handled before."""
    stop = Stop()
    for number in ENDINGS:
        if signal.getsignal(number) == _leave:
            signal.signal(number, stop)
            sys.unraisablehook = _report_unraisable


def ignore_signals() -> int | None:
    """From now on, ignore signals that would end the process; return the number of the one received before, if any."""
    came = None
    for number in ENDINGS:
        stop = signal.getsignal(number)
        if isinstance(stop, Stop):
            signal.signal(number, signal.SIG_IGN)
            came = stop.number
    return came


def describe_signal(number: int, words: Sequence[str]) -> str:
    """The message when a signal ends the command line ``words``."""
    again = "; the same command continues where it stopped" if words and words[0] in CONTINUED else ""
    return WORDS[signal.Signals(number)] + again


class Stop:
    """The signal handler: kills the worker processes and raises ``Stopped``, repeatedly until it is noticed.

    Attributes:
        number: The first signal that was received.
    """

    def __init__(self) -> None:
        self.number: int | None = None
        self._first = 0.0

    def __call__(self, number: int, frame: FrameType | None) -> None:
        now = time.monotonic()
        if self.number is None:
            self.number, self._first = number, now
            threading.Thread(target=_repeat, args=(number,), daemon=True).start()
            threading.Thread(target=_end_late, args=(number,), daemon=True).start()
        if is_interrupt(sys.exception()):  # it was noticed, and cleaning up is in progress
            if now - self._first > PATIENCE_S:
                _leave(self.number, frame)
            return
        for worker in active_children():
            worker.kill()  # what they have written is intact, and waiting for the rest may take long
        raise Stopped(number)


def is_interrupt(error: BaseException | None) -> bool:
    """Whether a signal led to an exception, directly or through its chain of causes."""
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        if isinstance(error, KeyboardInterrupt):
            return True
        seen.add(id(error))
        error = error.__cause__ or error.__context__
    return False


def _repeat(number: int) -> None:
    while isinstance(signal.getsignal(number), Stop):
        time.sleep(AGAIN_S)
        _thread.interrupt_main(
            signal.Signals(number)
        )  # a real signal could reach a handler that a library has set meanwhile


def _end_late(number: int) -> None:
    """End the process if cleaning up takes too long; print the message unless it was printed before."""
    time.sleep(LIMIT_S)
    if isinstance(signal.getsignal(number), Stop):
        _leave(number, None)
    os._exit(128 + number)


def _report_unraisable(lost: "sys.UnraisableHookArgs") -> None:
    """Report exceptions in finalisers, except that of a signal, which is raised again."""
    if not isinstance(lost.exc_value, KeyboardInterrupt):
        sys.__unraisablehook__(lost)


def _leave(number: int, frame: FrameType | None) -> None:
    os.write(2, (describe_signal(number, sys.argv[1:]) + "\n").encode())
    os._exit(128 + number)
