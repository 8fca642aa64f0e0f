"""Renderers: worker processes that draw the parts of a recording; one that dies, hangs or errs is replaced.

Mesa's software renderer has crashed on a loaded machine, and a bug that corrupts the heap may also change an image or
deadlock a thread. Parts are files that are written completely or not at all: a lost worker's unfinished parts are drawn
again.
"""

import logging
import time
import traceback
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from multiprocessing import Pipe
from multiprocessing.connection import Connection, wait
from pathlib import Path
from subprocess import Popen
from typing import Self

import numpy as np

from sim.errors import WorkError
from sim.processes import start_process, usable_cores
from sim.settings import SimSettings

MAX_DEATHS = 3  # Number of times that renderers may die or hang
MAX_TRIES = 3  # Most attempts at a part whose images differ when they are drawn twice
MIN_SILENCE_S, SILENCE_FACTOR = 10.0, 8.0
"""A worker is hung once its silence exceeds MIN_SILENCE_S + SILENCE_FACTOR times the longest one that ended."""
HEARTBEAT_S = 0.5  # Interval between a worker's signs of life, unless an image takes longer
POLL_S = 1.0
WORKER_PARTS = 2  # With the next part queued, a worker need not wait for a parent that is driving
MAX_QUEUED_BYTES = 100_000
"""Largest part that is queued: sending what the pipe cannot hold would wait until the worker has drawn the last."""
IMAGES_PER_RENDERER = 500  # To draw so many takes as long as to start one more renderer
DOCTOR_HINT = "deepgps doctor checks the renderer"
log = logging.getLogger(__name__)


def count_renderers(images: int) -> int:
    """Number of worker processes that pay for so many images."""
    return min(usable_cores(), 1 + images // IMAGES_PER_RENDERER)


class UnsteadyError(WorkError):
    """An image that was drawn twice came out different."""


@dataclass(frozen=True, eq=False)
class Part:
    """A set of images that are drawn into one file."""

    settings: SimSettings  # The room and the sensors
    states: np.ndarray  # Full positions of the simulation (n, nq)
    path: Path  # The file
    leans: np.ndarray | None = None  # Lean of the camera at each state (n, 2) [rad]; None: it is upright
    differed: int = 0  # How often an image of this part came out different when drawn twice


Draw = Callable[[Part, Callable[[], None]], None]  # Draws a part and calls the function after each image


@dataclass(eq=False)
class _Worker:
    process: Popen[bytes]
    pipe: Connection
    parts: deque[Part] = field(default_factory=deque)
    silent_s: float = 0.0


class Renderers:
    """Worker processes, at most ``count``, that draw the parts they are given, in any order, by an importable function.

    A worker is silent while it builds the room, up to ``longest_s`` [s]. ``drawn`` is the number of finished parts, and
    ``deaths`` how often workers died or hung; those found at the same time count once.
    """

    def __init__(self, draw: Draw, count: int, longest_s: float) -> None:
        self.deaths = self.drawn = 0
        self._draw, self._count, self._longest_s = draw, count, longest_s
        self._waiting: deque[Part] = deque()
        self._workers: list[_Worker] = []

    def give(self, part: Part) -> None:
        """Queue a part to draw and check on the worker processes without waiting for them."""
        self._waiting.append(part)
        self._look(0.0)

    def finish(self, progress: Callable[[int], None]) -> None:
        """Wait until all parts are drawn, whose number ``progress`` is told.

        Raises WorkError if renderers die, hang or err too often, or a part cannot be written.
        """
        while self._waiting or any(worker.parts for worker in self._workers):
            self._look(POLL_S)
            progress(self.drawn)

    def limit_s(self) -> float:
        """Longest allowed silence of a worker [s]; it doubles after each death, as the machine may just be slow."""
        return (MIN_SILENCE_S + SILENCE_FACTOR * self._longest_s) * 2**self.deaths

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for worker in self._workers:
            worker.process.kill()  # finished parts are on disk, and an idle worker has nothing to lose
        for worker in self._workers:
            self._remove(worker)

    def _look(self, wait_s: float) -> None:
        """Hand out parts, receive messages for up to ``wait_s``, and replace worker processes that are dead or hung."""
        self._hand_out()
        start = time.monotonic()
        ready = wait([worker.pipe for worker in self._workers], wait_s)
        # If this process was stopped or asleep, the elapsed time says nothing about its worker processes.
        waited = min(time.monotonic() - start, 2 * POLL_S)
        lost = []
        for worker in list(self._workers):
            if worker.pipe not in ready:
                worker.silent_s += waited if worker.parts else 0.0
            elif not self._hear(worker):
                lost.append(worker)
        hung = [worker for worker in self._workers if worker not in lost and worker.silent_s > self.limit_s()]
        if lost or hung:
            self._replace(lost, hung)
        self._hand_out()

    def _hand_out(self) -> None:
        while self._waiting:
            ahead = WORKER_PARTS if self._waiting[0].states.nbytes <= MAX_QUEUED_BYTES else 1
            free = [worker for worker in self._workers if len(worker.parts) < ahead]
            if len(self._workers) < self._count and all(worker.parts for worker in free):
                free.append(self._start())
            if not free:
                return
            worker = min(free, key=lambda one: len(one.parts))
            worker.silent_s = worker.silent_s if worker.parts else 0.0
            part = self._waiting.popleft()
            worker.parts.append(part)
            try:
                worker.pipe.send(part)
            except OSError:  # the worker has died, which reading from its pipe will show
                return

    def _hear(self, worker: _Worker) -> bool:
        """Receive a worker's messages; returns whether it is alive."""
        self._longest_s = max(self._longest_s, worker.silent_s)
        worker.silent_s = 0.0
        while worker in self._workers:
            try:
                if not worker.pipe.poll():
                    break
                answer = worker.pipe.recv()
            except (EOFError, OSError):
                return False
            self._take(worker, answer)
        return True

    def _take(self, worker: _Worker, answer: float | Exception | None) -> None:
        """Handle a message: a sign of life with the longest silence [s], None for a finished part, or an exception."""
        if isinstance(answer, UnsteadyError):
            self._draw_again(worker, answer)
        elif isinstance(answer, Exception):
            raise answer
        elif answer is None:
            worker.parts.popleft()
            self.drawn += 1
        else:
            self._longest_s = max(self._longest_s, answer)

    def _draw_again(self, worker: _Worker, error: UnsteadyError) -> None:
        """Replace a worker that drew one image differently twice, and queue its parts again."""
        part = worker.parts.popleft()
        part = replace(part, differed=part.differed + 1)
        if part.differed >= MAX_TRIES:
            raise WorkError(f"{error}, {MAX_TRIES} times; {DOCTOR_HINT}")
        log.warning("%s; the file is drawn again", error)
        self._waiting.extendleft(reversed([part, *worker.parts]))
        worker.parts.clear()
        worker.process.kill()
        self._remove(worker)

    def _replace(self, lost: list[_Worker], hung: list[_Worker]) -> None:
        """Remove worker processes that died or hang; others take their parts."""
        limit_s = self.limit_s()
        for worker in hung:
            worker.process.kill()
        if lost:
            time.sleep(0.2)  # an event that kills several at once counts once
            lost += [one for one in self._workers if one not in lost + hung and one.process.poll() is not None]
        self.deaths += 1
        why = "a rendering process died" if lost else f"a rendering process gave no sign of life for {limit_s:.0f} s"
        if self.deaths > MAX_DEATHS:
            raise WorkError(f"{why}; {DOCTOR_HINT}")
        log.warning("%s; %d of %d workers are replaced", why, len(lost + hung), len(self._workers))
        for worker in lost + hung:
            self._waiting.extendleft(reversed(worker.parts))
            self._remove(worker)

    def _start(self) -> _Worker:
        pipe, end = Pipe()
        code = "from sim.recording.renderers import work; work(int(sys.argv[1]))"
        process = start_process(code, [str(end.fileno())], [end.fileno()])
        end.close()
        pipe.send(self._draw)
        self._workers.append(_Worker(process, pipe))
        return self._workers[-1]

    def _remove(self, worker: _Worker) -> None:
        worker.process.wait()
        worker.pipe.close()
        self._workers = [one for one in self._workers if one is not worker]


def work(handle: int) -> None:
    """Run in a worker process: take the function that draws through a pipe, then parts, and report the results."""
    pipe = Connection(handle)
    with suppress(EOFError, BrokenPipeError):  # the parent is gone
        draw: Draw = pipe.recv()
        pulse = _Pulse(pipe)
        while True:
            part: Part = pipe.recv()
            pulse.start()
            pipe.send(_try_to_draw(draw, part, pulse.beat))


def _try_to_draw(draw: Draw, part: Part, beat: Callable[[], None]) -> Exception | None:
    try:
        draw(part, beat)
    except Exception as error:
        error.add_note(traceback.format_exc())
        return error
    return None


class _Pulse:
    """Reports at intervals that a worker is drawing, with the longest silence between two images."""

    def __init__(self, pipe: Connection) -> None:
        self._pipe, self._longest_s = pipe, 0.0
        self.start()

    def start(self) -> None:
        self._last = self._told = time.monotonic()

    def beat(self) -> None:
        now = time.monotonic()
        self._longest_s, self._last = max(self._longest_s, now - self._last), now
        if now - self._told >= HEARTBEAT_S:
            self._pipe.send(self._longest_s)
            self._told = now
