"""Kills: the parent or its renderers are killed at any moment; given again come the same bytes."""

import os
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

RENDERER = b"renderers import work"
"""Part of the command line of a process that draws."""


def list_tests(material: Material) -> list[Test]:
    """Kills of parents in runs and a study, and of workers while a room is drawn."""
    room, marks, study = material.runs["room"], material.runs["landmarks"], material.study
    run_room = ["run", room.source, "--out", "out"]
    run_marks = ["run", marks.source, "--out", "out"]
    run_study = ["study", str(study.source), "--out", "out"]
    return [
        Test("kills", "kill -9 of a run in a room, given again", 4, _kill_parent(run_room, room.clean)),
        Test("kills", "kill -9 of a run of landmarks, given again", 2, _kill_parent(run_marks, marks.clean)),
        Test("kills", "kill -9 of a study, given again", 2, _kill_parent(run_study, study.clean)),
        Test("kills", "kill -9 of a renderer", 2, _hit_renderers(run_room, room.clean, 1)),
        Test("kills", "kill -9 of all renderers", 1, _hit_renderers(run_room, room.clean, 99)),
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


def _hit_renderers(words: Sequence[str], clean: Print, most: int) -> Callable[[Case], Verdict]:
    """Renderers of a command are killed once; the command, or the same again where it failed in a line, does all."""

    def attempt(case: Case) -> Verdict:
        running = start(words, cwd=case.folder)
        while not find_renderers(running) and not has_ended(running):
            time.sleep(0.01)
        time.sleep(case.rng.uniform(0.0, 1.5))
        hit = find_renderers(running)[:most]
        for pid in hit:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        ended, told = finish(running), f"killed {len(hit)} renderers"
        if ended.code == 1 and not ended.fell and len(ended.problems) == 1:
            again = _judge(deepgps(*words, cwd=case.folder), case.folder / "out", clean, told)
            return Verdict(f"one line, then {again.kind}", again.held, again.detail)
        return _judge(ended, case.folder / "out", clean, told)

    return attempt


def find_renderers(running: Running) -> list[int]:
    """Processes that draw for a command."""
    found = []
    for pid in find_marked(running.mark):
        with suppress(OSError):
            if RENDERER in Path(f"/proc/{pid}/cmdline").read_bytes() and pid != running.process.pid:
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
