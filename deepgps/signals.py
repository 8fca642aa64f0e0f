"""How a signal ends a command: one line, no process left behind, and an exit code of 128 and the signal's number.

Python's own way is an exception anywhere, and a traceback from each process. Here only the first process of a command
answers. Until its packages are imported nothing has begun, and it leaves at once; after that ``Stopped`` is raised.
"""

import os
import signal
import sys
import time
from collections.abc import Sequence
from multiprocessing import active_children
from threading import Timer
from types import FrameType

from sim.processes import ENDINGS

PAUSE_S = 2.0
"""Signals that follow the first one this fast are the same wish, and must not interrupt the clearing up."""
CONTINUED = ("run", "collect", "train", "evaluate", "study")
WORDS = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated", signal.SIGHUP: "terminated by a hang-up"}


class Stopped(KeyboardInterrupt):
    """A signal ends the command."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


def leave_at_signals() -> None:
    """From now on, end the process at once; a signal that is ignored, as by nohup, stays ignored."""
    for number in ENDINGS:
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, _leave)


def stop_at_signals() -> None:
    """From now on, raise ``Stopped`` in the main thread; only where ``leave_at_signals`` was called before."""
    stop = Stop()
    for number in ENDINGS:
        if signal.getsignal(number) == _leave:
            signal.signal(number, stop)
            sys.unraisablehook = stop.catch


def ignore_signals() -> None:
    """From now on, let no signal disturb the end of the process."""
    for number in ENDINGS:
        if isinstance(signal.getsignal(number), Stop):
            signal.signal(number, signal.SIG_IGN)


def describe_signal(number: int, words: Sequence[str]) -> str:
    """What is said when a signal ends the command line ``words``."""
    again = "; the same command continues where it stopped" if words and words[0] in CONTINUED else ""
    return WORDS[signal.Signals(number)] + again


class Stop:
    """The handler of signals: ends the workers and raises ``Stopped``."""

    def __init__(self) -> None:
        self.last = -PAUSE_S

    def __call__(self, number: int, frame: FrameType | None) -> None:
        if time.monotonic() - self.last < PAUSE_S:
            return
        self.last = time.monotonic()
        for worker in active_children():
            worker.kill()  # what they have written is whole, and waiting for the rest may take long
        raise Stopped(number)

    def catch(self, lost: "sys.UnraisableHookArgs") -> None:
        """Send the signal again where its exception was raised in a finaliser, which swallows it."""
        if not isinstance(lost.exc_value, Stopped):
            sys.__unraisablehook__(lost)
            return
        self.last = -PAUSE_S
        again = Timer(0.05, os.kill, (os.getpid(), lost.exc_value.number))
        again.daemon = True
        again.start()


def _leave(number: int, frame: FrameType | None) -> None:
    os.write(2, (describe_signal(number, sys.argv[1:]) + "\n").encode())
    os._exit(128 + number)
