"""Signals that end a command: one line, exit code 128 plus the signal's number, and no process that is left."""

import os
import signal
import sys
import threading
import time
from collections.abc import Sequence
from multiprocessing import active_children
from types import FrameType

from sim.processes import END_SIGNALS

PATIENCE_S, LIMIT_S = 2.0, 20.0
"""Times for cleaning up after which a further signal, or none, ends the process at once; every file is intact always.

An exception that is raised in a handler may be lost: a package swallows it, or it comes in a finaliser.
"""
RESUMABLE_COMMANDS = ("run", "collect", "train", "evaluate", "study")
WORDS = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated", signal.SIGHUP: "hung up"}


class Stopped(KeyboardInterrupt):
    """Raised when a signal ends the command; a package may turn it into a plain KeyboardInterrupt."""


def leave_at_signals() -> None:
    """From now on, end the process at once at a signal; a signal that is ignored, as under nohup, stays ignored."""
    for number in END_SIGNALS:
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, _leave)


def stop_at_signals() -> None:
    """From now on, raise ``Stopped`` in the main thread at a signal that ``leave_at_signals`` handled before."""
    stop = Stop()
    for number in END_SIGNALS:
        if signal.getsignal(number) == _leave:
            signal.signal(number, stop)
            sys.unraisablehook = _report_unraisable


def ignore_signals() -> int | None:
    """From now on, ignore signals that would end the process; return the number of the one received before, if any."""
    came = None
    for number in END_SIGNALS:
        stop = signal.getsignal(number)
        if isinstance(stop, Stop):
            signal.signal(number, signal.SIG_IGN)
            came = stop.number
    return came


def describe_signal(number: int, words: Sequence[str]) -> str:
    """The message when a signal ends the command line ``words``."""
    again = "; the same command continues where it stopped" if words and words[0] in RESUMABLE_COMMANDS else ""
    return WORDS[signal.Signals(number)] + again


class Stop:
    """The signal handler: kills the worker processes and raises ``Stopped``; a late second signal ends the process.

    ``number`` is the first signal that was received.
    """

    def __init__(self) -> None:
        self.number: int | None = None
        self._first_s = 0.0

    def __call__(self, number: int, frame: FrameType | None) -> None:
        if self.number is not None:  # cleaning up is in progress, unless a package has swallowed the exception
            if time.monotonic() - self._first_s > PATIENCE_S:
                _leave(self.number, frame)
            return
        self.number, self._first_s = number, time.monotonic()
        for worker in active_children():
            worker.kill()  # what they have written is intact, and waiting for the rest may take long
        last = threading.Timer(LIMIT_S, _leave, (number, frame))
        last.daemon = True
        last.start()
        raise Stopped(number)


def _report_unraisable(lost: "sys.UnraisableHookArgs") -> None:
    """Report exceptions in finalisers, except that of a signal."""
    if not isinstance(lost.exc_value, KeyboardInterrupt):
        sys.__unraisablehook__(lost)


def _leave(number: int, frame: FrameType | None) -> None:
    os.write(2, (describe_signal(number, sys.argv[1:]) + "\n").encode())
    os._exit(128 + number)
