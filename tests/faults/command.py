"""A command of the product in a process of its own: watched, limited in time and memory, and never left behind."""

import os
import re
import resource
import shlex
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import gettempdir

from tests.faults.attack import REPOSITORY

MARK = "DEEPGPS_FAULTS"
"""In the environment of each command and so of all that it starts: by it they are found again."""
TIME_S = 300.0
MEMORY_MB = 6000.0
LEAVE_S = 5.0
"""How long a command's processes may take to go after it has ended."""
MAX_OUTPUT_LETTERS = 200_000
TICK_S = 0.01
PROGRESS = re.compile(r"[^:]{1,80}: [\d,]+ of [\d,]+ \(\d+ %\)")


@dataclass(frozen=True)
class Ended:
    """A command that has ended.

    Attributes:
        line: The command as one types it.
        code: Its exit code, or the negative signal that ended it.
        out: What it said, at most MAX_OUTPUT_LETTERS characters.
        err: What it complained about, at most as many.
        said: Characters of both, all of them.
        over: The limit that it broke and was ended for; empty: none.
        left: Processes that were still there some seconds after it.
    """

    line: str
    code: int
    out: str
    err: str
    said: int
    over: str
    left: int

    @property
    def problems(self) -> list[str]:
        """The lines that say why it failed."""
        return [line for line in self.err.splitlines() if line.startswith(("error:", "failed:"))]

    @property
    def complaints(self) -> list[str]:
        """All that it complained about, without progress and warnings."""
        lines = [line for line in self.err.splitlines() if line.strip() and not PROGRESS.match(line)]
        return [line for line in lines if not line.startswith("warning:")]

    @property
    def fell(self) -> str:
        """What no command may do, whatever is wrong: empty, or one of traceback, signal, too long, too large."""
        if self.over:
            return self.over
        if "Traceback (most recent call last)" in self.out + self.err:
            return "traceback"
        if self.code < 0 or self.code > 2:
            return f"ended with {self.code}"
        return "process left behind" if self.left else ""

    def show(self) -> str:
        """The command and how it ended."""
        last = " / ".join((self.err or self.out).strip().splitlines()[-3:])
        return f"`{self.line}` -> {self.code}: {last[:500]}"


@dataclass(frozen=True)
class Running:
    """A command under way: its process, its mark, and where its words go."""

    process: subprocess.Popen[bytes]
    mark: str
    line: str
    started: float
    out: Path
    err: Path


def start(words: Sequence[str], cwd: Path) -> Running:
    """Start ``deepgps`` with these words in a folder; those that start with ``-c`` are given to Python itself."""
    own = words[0] != "-c"
    program = [sys.executable, *(["-m", "deepgps.commands.main"] if own else [])]
    mark = f"{os.getpid()}-{uuid.uuid4().hex}"
    path = os.pathsep.join(filter(None, [str(REPOSITORY), os.environ.get("PYTHONPATH", "")]))
    environment = {**os.environ, "PYTHONPATH": path, "COLUMNS": "200", MARK: mark}
    out, err = (Path(gettempdir()) / f"{mark}.{name}" for name in ("out", "err"))
    with out.open("wb") as to_out, err.open("wb") as to_err:
        process = subprocess.Popen(
            [*program, *words],
            cwd=cwd,
            env={name: value for name, value in environment.items() if name not in {"DISPLAY", "WAYLAND_DISPLAY"}},
            stdin=subprocess.DEVNULL,
            stdout=to_out,
            stderr=to_err,
            start_new_session=True,
        )
    line = shlex.join(["deepgps", *words]) if own else shlex.join(["read-it-in-python", *words[2:]])
    return Running(process, mark, line, time.monotonic(), out, err)


def finish(running: Running, time_s: float = TIME_S, memory_mb: float = MEMORY_MB) -> Ended:
    """Wait for a command; end it, and all that it started, where it breaks a limit."""
    process, over = running.process, ""
    while process.poll() is None:
        if time.monotonic() - running.started > time_s:
            over = f"longer than {time_s:.0f} s"
        elif memory_of(process.pid) > memory_mb:
            over = f"more than {memory_mb:.0f} MB"
        if over:
            kill_all(running)
        time.sleep(TICK_S)
    left = [] if over else wait_gone(running.mark, LEAVE_S)
    kill_all(running)
    out, err = running.out.read_bytes(), running.err.read_bytes()
    for path in (running.out, running.err):
        path.unlink()
    return Ended(
        line=running.line,
        code=process.returncode,
        out=out[:MAX_OUTPUT_LETTERS].decode(errors="replace"),
        err=err[:MAX_OUTPUT_LETTERS].decode(errors="replace"),
        said=len(out) + len(err),
        over=over,
        left=len(left),
    )


def deepgps(*words: str, cwd: Path, time_s: float = TIME_S, memory_mb: float = MEMORY_MB) -> Ended:
    """Run a command from start to end; arguments are those of ``start`` and ``finish``."""
    return finish(start(words, cwd), time_s, memory_mb)


def has_ended(running: Running) -> bool:
    """Whether a command has ended by itself; ``finish`` tells how."""
    return running.process.poll() is not None


def kill(running: Running) -> None:
    """Kill -9 of the command alone: what it started is not told."""
    with suppress(ProcessLookupError):
        os.kill(running.process.pid, signal.SIGKILL)


def kill_all(running: Running) -> None:
    """Kill -9 of the command and of all that it started."""
    _kill_marked(running.mark)


def end_all() -> None:
    """Kill -9 of all commands of this process, and of all that they started."""
    _kill_marked(f"{os.getpid()}-")


def _kill_marked(mark: str) -> None:
    for pid in find_marked(mark):
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)


def find_marked(mark: str) -> list[int]:
    """Processes that have a mark in their environment that starts like this."""
    wanted, found = f"{MARK}={mark}".encode(), []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            with suppress(OSError):  # it has gone
                if wanted in (entry / "environ").read_bytes():
                    found.append(int(entry.name))
    return found


def wait_gone(mark: str, seconds: float) -> list[int]:
    """Wait until no process has this mark; returns those that still have it after so many seconds."""
    end = time.monotonic() + seconds
    while (there := find_marked(mark)) and time.monotonic() < end:
        time.sleep(0.05)
    return there


def memory_of(pid: int) -> float:
    """Resident memory of a process and all below it [MB]."""
    total, waiting = 0, [pid]
    while waiting:
        one = waiting.pop()
        with suppress(OSError, ValueError):
            total += int(Path(f"/proc/{one}/statm").read_text().split()[1])
            waiting += map(int, Path(f"/proc/{one}/task/{one}/children").read_text().split())
    return total * resource.getpagesize() / 2**20
