"""Renderers: worker processes that draw the parts of a recording; one that dies, hangs or errs is replaced.

Mesa's software renderer has crashed on a loaded machine, and a bug that corrupts the heap may also change an image or
deadlock a thread. Parts are files that are written completely or not at all: the part of a lost worker is drawn again.
"""

import logging
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from queue import Empty, SimpleQueue
from subprocess import Popen
from threading import Lock, Thread
from typing import Self

import numpy as np

from sim.errors import WorkError
from sim.processes import start_process, usable_cores
from sim.settings import SimSettings

MAX_DEATHS = 3  # Number of times that renderers may die or hang
MAX_TRIES = 3  # Most attempts at a part whose images differ when they are drawn twice
MIN_SILENCE_S, SILENCE_FACTOR = 30.0, 8.0
"""A worker is hung once its silence exceeds MIN_SILENCE_S + SILENCE_FACTOR times the longest one that ended."""
HEARTBEAT_S = 0.5  # Interval between a worker's signs of life, unless an image takes longer
POLL_S = 1.0
SAME_EVENT_S = 0.2  # An event that kills several workers at once counts once
IMAGES_PER_RENDERER = 500  # To draw so many takes as long as to start one more renderer
DOCTOR_HINT = "deepgps doctor checks the renderer"
log = logging.getLogger(__name__)


def count_renderers(images: int) -> int:
    """Number of worker processes that pay for so many images."""
    return min(usable_cores(), 1 + images // IMAGES_PER_RENDERER)


class UnsteadyError(WorkError):
    """An image that was drawn twice came out different."""


class _LostError(WorkError):
    """A worker died or hung."""


@dataclass(frozen=True, eq=False)
class Part:
    """A set of images that are drawn into one file."""

    settings: SimSettings  # The room and the sensors
    states: np.ndarray  # Full positions of the simulation (n, nq)
    path: Path  # The file
    leans: np.ndarray | None = None  # Lean of the camera at each state (n, 2) [rad]; None: it is upright
    differed: int = 0  # How often an image of this part came out different when drawn twice


Draw = Callable[[Part, Callable[[], None]], None]  # Draws a part and calls the function after each image


class Renderers:
    """Worker processes, at most ``count``, that draw the parts they are given, in any order, by an importable function.

    A worker is silent while it builds the room, up to ``longest_s`` [s]. ``drawn`` is the number of finished parts, and
    ``deaths`` how often workers died or hung; those lost at the same time count once. A thread serves each worker.
    """

    def __init__(self, draw: Draw, count: int, longest_s: float) -> None:
        self.deaths = self.drawn = self._given = 0
        self._draw, self._count, self._longest_s = draw, count, longest_s
        self._parts, self._answers = SimpleQueue[Part | None](), SimpleQueue[tuple[Part, Exception | None]]()
        self._threads, self._processes = list[Thread](), list[Popen[bytes]]()
        self._closed, self._lock, self._lost_s = False, Lock(), -SAME_EVENT_S

    def give(self, part: Part) -> None:
        """Queue a part to draw, and hear of others without waiting for them."""
        self._parts.put(part)
        self._given += 1
        if len(self._threads) < min(self._count, self._given - self.drawn):
            self._threads.append(Thread(target=self._serve, daemon=True))
            self._threads[-1].start()
        self._hear(0.0)

    def finish(self, progress: Callable[[int], None]) -> None:
        """Wait until all parts are drawn, whose number ``progress`` is told.

        Raises WorkError if renderers die, hang or err too often, or a part cannot be written.
        """
        while self.drawn < self._given:
            self._hear(POLL_S)
            progress(self.drawn)

    def limit_s(self) -> float:
        """Longest allowed silence of a worker [s]; it doubles after each death, as the machine may just be slow."""
        return (MIN_SILENCE_S + SILENCE_FACTOR * self._longest_s) * 2**self.deaths

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._closed = True
        for _ in self._threads:
            self._parts.put(None)
        while any(thread.is_alive() for thread in self._threads):
            for process in self._processes:
                process.kill()  # finished parts are on disk, and an idle worker has nothing to lose
            time.sleep(0.01)

    def _hear(self, wait_s: float) -> None:
        """Take what became of parts, for up to ``wait_s`` [s]; those of lost workers are drawn again."""
        with suppress(Empty):
            while True:
                part, error = self._answers.get(timeout=wait_s) if wait_s else self._answers.get_nowait()
                wait_s = 0.0
                if error is None:
                    self.drawn += 1
                else:
                    self._parts.put(self._give_again(part, error))

    def _give_again(self, part: Part, error: Exception) -> Part:
        """The part as it is to be drawn again; raises the error if that would not help, or WorkError if it is one too
        many."""
        if not isinstance(error, UnsteadyError | _LostError):
            raise error
        if isinstance(error, UnsteadyError):
            part = replace(part, differed=part.differed + 1)
        if part.differed >= MAX_TRIES:
            raise WorkError(f"{error}, {MAX_TRIES} times; {DOCTOR_HINT}")
        if self.deaths > MAX_DEATHS:
            raise WorkError(f"{error}; {DOCTOR_HINT}")
        log.warning("%s; the file is drawn again", error)
        return part

    def _serve(self) -> None:
        """Run in a thread: let a worker process draw parts, and another one after an error."""
        while not self._closed:
            pipe, end = Pipe()
            code = "from sim.recording.renderers import work; work(int(sys.argv[1]))"
            process = start_process(code, [str(end.fileno())], [end.fileno()])
            self._processes.append(process)
            end.close()
            error = None
            while error is None and (part := self._parts.get()) is not None:
                error = self._ask(pipe, part)
                self._answers.put((part, error))
            process.kill()
            process.wait()
            pipe.close()
            if error is None:
                return

    def _ask(self, pipe: Connection, part: Part) -> Exception | None:
        """Have a worker draw a part; what went wrong, or None."""
        why = "a rendering process died"
        with suppress(EOFError, OSError):
            pipe.send((self._draw, part))
            while True:
                start, limit_s = time.monotonic(), self.limit_s()
                # If this process was stopped or asleep, the elapsed time says nothing about its worker.
                if not (pipe.poll(limit_s) or pipe.poll(POLL_S)):
                    why = f"a rendering process gave no sign of life for {limit_s:.0f} s"
                    break
                answer = pipe.recv()
                self._longest_s = max(self._longest_s, min(time.monotonic() - start, limit_s))
                if answer is not ALIVE:
                    return answer
        with self._lock:
            if (now := time.monotonic()) - self._lost_s > SAME_EVENT_S:
                self.deaths, self._lost_s = self.deaths + 1, now
        return _LostError(why)


ALIVE = True  # A worker's sign of life


def work(handle: int) -> None:
    """Run in a worker process: take parts, and the function that draws them, through a pipe, and report the results."""
    pipe, told = Connection(handle), time.monotonic()

    def beat() -> None:
        nonlocal told
        if time.monotonic() - told >= HEARTBEAT_S:
            pipe.send(ALIVE)
            told = time.monotonic()

    with suppress(EOFError, BrokenPipeError):  # the parent is gone
        while True:
            draw, part = pipe.recv()
            pipe.send(_try_to_draw(draw, part, beat))


def _try_to_draw(draw: Draw, part: Part, beat: Callable[[], None]) -> Exception | None:
    try:
        draw(part, beat)
    except Exception as error:
        error.add_note(traceback.format_exc())
        return error
    return None
