"""Endings: interrupted, terminated, piped into what closes, without locale, home or terminal: lines, exit codes."""

import os
import signal
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress

from tests.faults.attack import Case, Test, Verdict
from tests.faults.command import Ended, deepgps, finish, start
from tests.faults.fingerprint import Print, differences, take
from tests.faults.material import Material, Run, copy
from tests.faults.moments import wait_for_moment

CODES = {signal.SIGINT: {130}, signal.SIGTERM: {130, 143}, signal.SIGHUP: {129, 130}}
PIPES = {
    "| head -1": '"$@" | head -1',
    "| true": '"$@" | true',
    "stdout closed": '"$@" >&-',
    "stderr closed": '"$@" 2>&-',
    "all closed": '"$@" <&- >&- 2>&-',
    "stdout full": '"$@" > /dev/full',
}
BARE: Mapping[str, Mapping[str, str]] = {
    "ASCII": {"PYTHONIOENCODING": "ascii", "LC_ALL": "C", "LANG": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
    "latin-1": {"PYTHONIOENCODING": "latin-1"},
    "no locale": {"LC_ALL": "nonsense", "LANG": "xx_YY.UTF-99"},
    "no HOME": {"HOME": ""},
    "HOME that is not": {"HOME": "/nonexistent/home", "XDG_CACHE_HOME": "/nonexistent/cache"},
    "no PATH": {"PATH": "/nonexistent"},
    "dumb terminal": {"TERM": "dumb", "NO_COLOR": "1", "COLUMNS": "20"},
    "no user": {"USER": "", "LOGNAME": "", "HOME": "/proc"},
}


def list_tests(material: Material) -> list[Test]:
    """Signals in a run, a collection and a study; pipes; bare environments; signs of life."""
    room, marks, study = material.runs["room"], material.runs["landmarks"], material.study
    run = (["run", room.source, "--out", "out"], room.clean)
    whole = (["study", str(study.source), "--out", "out"], study.clean)
    return [
        Test("endings", "SIGINT to all, run", 3, _interrupt(*run, signal.SIGINT)),
        Test("endings", "SIGINT to all, while it starts", 2, _interrupt(*run, signal.SIGINT, early=1.0)),
        Test("endings", "SIGINT twice, run", 2, _interrupt(*run, signal.SIGINT, 2)),
        Test("endings", "SIGTERM, run", 3, _interrupt(*run, signal.SIGTERM)),
        Test("endings", "SIGHUP, run", 1, _interrupt(*run, signal.SIGHUP)),
        Test("endings", "SIGINT to all, study", 1, _interrupt(*whole, signal.SIGINT)),
        Test("endings", "SIGTERM, study", 1, _interrupt(*whole, signal.SIGTERM)),
        Test("endings", "closed pipes and a full device", len(PIPES), _pipe(room), of=len(PIPES)),
        Test("endings", "ASCII, no locale, no HOME, no PATH", len(BARE), _lay_bare(marks), of=len(BARE)),
        Test("endings", "signs of life without a terminal", 1, _watch(marks)),
    ]


def _interrupt(
    words: Sequence[str], clean: Print, how: signal.Signals, times: int = 1, early: float = 0.0
) -> Callable[[Case], Verdict]:
    def attempt(case: Case) -> Verdict:
        running = start(words, cwd=case.folder)
        moment = wait_for_moment(running, case.folder, clean, case.rng, early)
        for _ in range(times):
            with suppress(ProcessLookupError):
                if how is signal.SIGINT:  # as a terminal does
                    os.killpg(running.process.pid, how)
                else:
                    os.kill(running.process.pid, how)
            time.sleep(case.rng.uniform(0.05, 0.5))
        ended = finish(running, time_s=30.0)
        detail = f"{moment}: {ended.show()}"
        if ended.left or ended.over or "Traceback" in ended.text:
            kind = "process left behind" if ended.left else ended.over or "traceback"
            return Verdict(kind, False, detail)
        if ended.code == 0:
            return Verdict("over before", True)
        if ended.code not in CODES[how]:
            return Verdict(f"ended with {ended.code}", False, detail)
        lines = ended.complaints
        return Verdict("one line" if len(lines) == 1 else f"{len(lines)} lines", len(lines) == 1, detail)

    return attempt


def _pipe(run: Run) -> Callable[[Case], Verdict]:
    def attempt(case: Case) -> Verdict:
        name = list(PIPES)[case.number % len(PIPES)]
        folder = copy(run.stages["evaluated" if case.rng.random() < 0.5 else "finished"], case.folder / "out")
        before = ["bash", "-c", f"set -o pipefail; {PIPES[name]}", "bash"]
        ended = deepgps("run", run.source, "--out", "out", cwd=case.folder, before=before)
        detail = f"{name}: {ended.show()}"
        if ended.left or ended.over or "Traceback" in ended.text or "Exception ignored" in ended.text:
            return Verdict(ended.over or "traceback", False, detail)
        if len(ended.complaints) > (1 if name == "stdout full" else 0):
            return Verdict(f"{len(ended.complaints)} lines", False, detail)
        if name != "stdout full" and ended.code not in {0, 1, 141}:
            return Verdict(f"ended with {ended.code}", False, detail)
        wrong = differences(run.clean, take(folder))
        return Verdict("quiet, all work done" if not wrong else "work not done", not wrong, detail)

    return attempt


def _lay_bare(run: Run) -> Callable[[Case], Verdict]:
    def attempt(case: Case) -> Verdict:
        name = list(BARE)[case.number % len(BARE)]
        out = case.folder / "é 空"
        ended = deepgps("run", run.source, "--out", str(out), cwd=case.folder, env=BARE[name])
        detail = f"{name}: {ended.show()}"
        if ended.fell or ended.code:
            return Verdict(ended.fell or f"ended with {ended.code}", False, detail)
        wrong = differences(run.clean, take(out))
        return Verdict("other bytes" if wrong else "the same bytes", not wrong, f"{', '.join(wrong[:4])}; {detail}")

    return attempt


def _watch(run: Run) -> Callable[[Case], Verdict]:
    def attempt(case: Case) -> Verdict:
        ended: Ended = deepgps("run", run.source, "--out", "out", cwd=case.folder)
        lines = len(ended.progress)
        return Verdict("lines of progress" if lines >= 10 else f"{lines} lines of progress", lines >= 10, ended.show())

    return attempt
