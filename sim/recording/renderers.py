"""Renderers: worker processes that draw part after part of a recording, each replaced where it dies, hangs or errs.

Mesa's software renderer was seen to crash on a loaded machine, and what overwrites a heap may also change an image or
lock a thread for ever. Parts are files, written whole or not at all: what a lost worker had begun is drawn again.
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
from sim.processes import start_process
from sim.settings import SimSettings

DEATHS = 3
"""How often renderers may die or hang."""
TRIES = 3
"""How often a part is drawn, at most, whose images differ when they are drawn twice."""
FLOOR_S, PATIENCE = 10.0, 8.0
"""A worker hangs that is silent for the first and so many times the longest silence that ended."""
BEAT_S = 0.5
"""So often a worker gives a sign of life, unless an image takes longer."""
LOOK_S = 1.0
AHEAD = 2
"""Parts that a worker has at once: with the next one at hand it need not wait for a parent that drives."""
CURE = "deepgps doctor checks the renderer"
log = logging.getLogger(__name__)


class UnsteadyError(WorkError):
    """An image that was drawn twice came out different."""


@dataclass(frozen=True, eq=False)
class Part:
    """Images that are drawn into one file.

    Attributes:
        settings: The room and the sensors.
        states: Full positions of the simulation (n, nq).
        path: The file.
        leans: Of the camera at each state (n, 2) [rad]; none: it is upright.
        differed: How often these images were drawn twice with a difference.
    """

    settings: SimSettings
    states: np.ndarray
    path: Path
    leans: np.ndarray | None = None
    differed: int = 0

    def again(self) -> "Part":
        """The same part after one more difference."""
        return replace(self, differed=self.differed + 1)


Draw = Callable[[Part, Callable[[], None]], None]
"""Draws a part; calls the function after each image."""


@dataclass(eq=False)
class _Worker:
    process: Popen[bytes]
    pipe: Connection
    parts: deque[Part] = field(default_factory=deque)
    silent_s: float = 0.0


class Renderers:
    """Workers that draw the parts they are given, in any order.

    Attributes:
        deaths: How often some died or hung; those that are found at once count once.
        drawn: Parts that are finished.

    Args:
        draw: What a worker does with a part; it can be imported.
        count: Workers, at most.
        longest_s: How long it takes to build the room, which a worker does in silence [s].
    """

    def __init__(self, draw: Draw, count: int, longest_s: float) -> None:
        self.deaths = self.drawn = 0
        self._draw, self._count, self._longest_s = draw, count, longest_s
        self._waiting: deque[Part] = deque()
        self._workers: list[_Worker] = []

    def give(self, part: Part) -> None:
        """Take a part to draw, and look after the workers without waiting for them."""
        self._waiting.append(part)
        self._look(0.0)

    def finish(self, progress: Callable[[int], None]) -> None:
        """Wait until all parts are drawn, telling ``progress`` how many are.

        Raises:
            WorkError: Renderers die, hang or err too often, or a part cannot be written.
        """
        while self._waiting or any(worker.parts for worker in self._workers):
            self._look(LOOK_S)
            progress(self.drawn)

    def limit_s(self) -> float:
        """How long a worker may be silent [s]; twice as long after each death, for the machine may just be slow."""
        return (FLOOR_S + PATIENCE * self._longest_s) * 2**self.deaths

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for worker in self._workers:
            worker.process.kill()  # parts are whole files, and an idle worker has nothing else to lose
        for worker in self._workers:
            self._remove(worker)

    def _look(self, wait_s: float) -> None:
        """Hand out parts, hear what the workers say within a time, and replace those that say nothing any more."""
        self._hand_out()
        start = time.monotonic()
        ready = wait([worker.pipe for worker in self._workers], wait_s)
        # Were this process stopped or asleep, the time that passed would say nothing about its workers.
        waited = min(time.monotonic() - start, 2 * LOOK_S)
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
            free = [worker for worker in self._workers if len(worker.parts) < AHEAD]
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
            except OSError:  # it has died, as hearing it will show
                return

    def _hear(self, worker: _Worker) -> bool:
        """Take in what a worker says; returns whether it is alive."""
        self._longest_s = max(self._longest_s, worker.silent_s)
        worker.silent_s = 0.0
        while worker in self._workers:
            try:
                if not worker.pipe.poll():
                    break
                told = worker.pipe.recv()
            except (EOFError, OSError):
                return False
            self._take(worker, told)
        return True

    def _take(self, worker: _Worker, told: float | Exception | None) -> None:
        """A sign of life with its longest silence [s], a part that is finished, or why it could not be."""
        if isinstance(told, UnsteadyError):
            self._draw_again(worker, told)
        elif isinstance(told, Exception):
            raise told
        elif told is None:
            worker.parts.popleft()
            self.drawn += 1
        else:
            self._longest_s = max(self._longest_s, told)

    def _draw_again(self, worker: _Worker, error: UnsteadyError) -> None:
        """Give the part of a worker that draws one image in two ways to another one, that starts from nothing."""
        part = worker.parts.popleft().again()
        if part.differed >= TRIES:
            raise WorkError(f"{error}, {TRIES} times; {CURE}")
        log.warning("%s; the file is drawn again", error)
        self._waiting.extendleft(reversed([part, *worker.parts]))
        worker.parts.clear()
        worker.process.kill()
        self._remove(worker)

    def _replace(self, lost: list[_Worker], hung: list[_Worker]) -> None:
        """Remove workers that died or hang; others take their parts."""
        limit_s = self.limit_s()
        for worker in hung:
            worker.process.kill()
        if lost:
            time.sleep(0.2)  # what kills several at once counts once
            lost += [one for one in self._workers if one not in lost + hung and one.process.poll() is not None]
        self.deaths += 1
        why = "a rendering process died" if lost else f"a rendering process gave no sign of life for {limit_s:.0f} s"
        if self.deaths > DEATHS:
            raise WorkError(f"{why}; {CURE}")
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
    """In a process of its own: draw the parts that come through a pipe, and tell how it goes.

    Args:
        handle: The pipe's; first comes what draws, then one part after another.
    """
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
    """Tells now and then that a worker draws, and the longest silence between two images."""

    def __init__(self, pipe: Connection) -> None:
        self._pipe, self._longest_s = pipe, 0.0
        self.start()

    def start(self) -> None:
        self._last = self._told = time.monotonic()

    def beat(self) -> None:
        now = time.monotonic()
        self._longest_s, self._last = max(self._longest_s, now - self._last), now
        if now - self._told >= BEAT_S:
            self._pipe.send(self._longest_s)
            self._told = now
