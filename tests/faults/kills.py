"""Kills: the parent, a worker or all of them are killed or stopped at any moment; given again come the same bytes."""

import os
import random
import shutil
import signal
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

from tests.faults.attack import Case, Test, Verdict
from tests.faults.command import Ended, Running, deepgps, find_marked, finish, has_ended, kill, start
from tests.faults.fingerprint import Print, differences, take
from tests.faults.material import Material
from tests.faults.moments import wait_for_moment

HANGS_S = 90.0
"""A command of some seconds, one worker of which was stopped, must have replaced it and ended by then."""
WORKERS = (b"renderers import work", b"engine.pool import work")
"""Part of the command line of a process that draws, or that drives or trains for a study."""
CHANCES = 3
"""How often a command is given until a worker could be hit: it may be done before."""


def list_tests(material: Material) -> list[Test]:
    """Kills of parents in runs and studies, and of workers while a room is drawn or a study's runs are trained."""
    room, marks, study = material.runs["room"], material.runs["landmarks"], material.study
    run_room = ["run", room.source, "--out", "out"]
    run_marks = ["run", marks.source, "--out", "out"]
    run_study = ["study", str(study.source), "--out", "out"]
    return [
        Test("kills", "kill -9 of a run in a room, given again", 4, _kill_parent(run_room, room.clean)),
        Test(
            "kills",
            "kill -9 of a run of landmarks, given again",
            2,
            _kill_parent(run_marks, marks.clean),
        ),
        Test("kills", "kill -9 of a study, given again", 2, _kill_parent(run_study, study.clean)),
        Test("kills", "kill -9 of a renderer", 2, _hit_workers(run_room, room.clean, signal.SIGKILL, 1)),
        Test("kills", "kill -9 of all renderers", 1, _hit_workers(run_room, room.clean, signal.SIGKILL, 99)),
        Test("kills", "kill -STOP of a renderer", 1, _hit_workers(run_room, room.clean, signal.SIGSTOP, 1)),
        Test("kills", "kill -STOP of a renderer, kill -9 of the parent", 1, _stop_and_kill(run_room)),
        Test(
            "kills",
            "kill -9 of a study's worker, given again",
            1,
            _hit_workers(run_study, study.clean, signal.SIGKILL, 1),
        ),
        Test("kills", "kill -STOP of a study's worker, kill -9 of the parent", 1, _stop_and_kill(run_study)),
    ]


def _kill_parent(words: Sequence[str], clean: Print) -> Callable[[Case], Verdict]:
    def attempt(case: Case) -> Verdict:
        running = start(words, cwd=case.folder)
        moment = wait_for_moment(running, case.folder, clean, case.rng)
        kill(running)
        first = finish(running)
        if first.left:
            return Verdict("process left behind", False, f"{first.left} after kill -9 {moment}: {first.show()}")
        return _judge(deepgps(*words, cwd=case.folder), case.folder / "out", clean, f"killed {moment}")

    return attempt


def _hit_workers(words: Sequence[str], clean: Print, how: signal.Signals, most: int) -> Callable[[Case], Verdict]:
    """Workers of a command get a signal once; the command, or the same again where it failed in one line, does all."""

    def attempt(case: Case) -> Verdict:
        running, hit = _start_and_hit(words, case, how, most)
        ended, told = finish(running, time_s=HANGS_S), f"{how.name} to {hit} workers"
        if not hit:
            return Verdict("no worker found", False, ended.show())
        if ended.code == 1 and not ended.fell and len(ended.problems) == 1:
            again = _judge(deepgps(*words, cwd=case.folder), case.folder / "out", clean, told)
            return Verdict(f"one line, then {again.kind}", again.held, again.detail)
        return _judge(ended, case.folder / "out", clean, told)

    return attempt


def _stop_and_kill(words: Sequence[str]) -> Callable[[Case], Verdict]:
    def attempt(case: Case) -> Verdict:
        running, hit = _start_and_hit(words, case, signal.SIGSTOP, 1)
        kill(running)
        ended = finish(running)
        if not hit:
            return Verdict("no worker found", False, ended.show())
        if ended.left:
            return Verdict(
                "process left behind", False, f"{ended.left} after SIGSTOP of {hit} and kill -9: {ended.show()}"
            )
        return Verdict("no orphan", True)

    return attempt


def _start_and_hit(words: Sequence[str], case: Case, how: signal.Signals, most: int) -> tuple[Running, int]:
    """Start a command and signal some of its workers; again where it was over before that; returns how many got it."""
    running = start(words, cwd=case.folder)
    for _ in range(CHANCES - 1):
        if hit := _hit(running, how, most, case.rng):
            return running, hit
        finish(running)
        shutil.rmtree(case.folder / "out", ignore_errors=True)
        running = start(words, cwd=case.folder)
    return running, _hit(running, how, most, case.rng)


def _hit(running: Running, how: signal.Signals, most: int, rng: random.Random) -> int:
    """Signal at most so many workers at a moment after the first was seen; returns how many got it."""
    while not find_workers(running) and not has_ended(running):
        time.sleep(0.01)
    time.sleep(rng.uniform(0.0, 1.5))
    workers, hit = find_workers(running), 0
    for pid in rng.sample(workers, min(most, len(workers))):
        with suppress(ProcessLookupError):
            os.kill(pid, how)
            hit += 1
    return hit


def find_workers(running: Running) -> list[int]:
    """Processes that draw, drive or train for a command."""
    found = []
    for pid in find_marked(running.mark):
        with suppress(OSError):
            line = Path(f"/proc/{pid}/cmdline").read_bytes()
            if pid != running.process.pid and any(worker in line for worker in WORKERS):
                found.append(pid)
    return found


def _judge(ended: Ended, folder: Path, clean: Print, told: str) -> Verdict:
    if ended.fell or ended.code:
        return Verdict(ended.fell or f"refused with {ended.code}", False, f"{told}: {ended.show()}")
    if wrong := differences(clean, take(folder)):
        return Verdict("another result", False, f"{told}; {', '.join(wrong[:5])}: {ended.show()}")
    if parts := list(folder.rglob("*.part")):
        return Verdict("left a .part file", False, f"{told}; {parts[0].name}")
    return Verdict("the same bytes", True)
