"""The command line as a user runs it, and what tests ask of what it says and leaves."""

import io
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import chdir, contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from select import select
from subprocess import CompletedProcess, Popen

import pytest

from deepgps.commands.main import main

MINI = """
room: {kind: bedroom, width_m: 3.2, depth_m: 2.8}
camera: {rings: 8, sectors: 32, face_px: 16}
drive: {samples: 200}
deployment: {drive_samples: 60}
grid: {spacing_m: 0.5, headings: 2}
methods: [deepgps_compass, deepgps, posenet, knn]
learn: {train: {steps: 60, checkpoint_steps: 20}, fold: {restarts: 1}}
"""
"""The scenario of the run that tests share."""
LIMIT_S = 120.0
"""Longest wait for anything that a process does."""


def deepgps(*words: str, cwd: Path, **environment: str) -> CompletedProcess[str]:
    """Run ``deepgps`` with these words in a folder, in a process of its own."""
    command = [sys.executable, "-m", "deepgps.commands.main", *words]
    return subprocess.run(
        command, cwd=cwd, env={**os.environ, **environment}, capture_output=True, text=True, check=False, timeout=1500
    )


def make_by_command(*words: str, cwd: Path) -> None:
    """The same, which must do its work; ``said.txt`` in the folder is what it printed."""
    done = deepgps(*words, cwd=cwd)
    assert done.returncode == 0, done.stderr
    (cwd / "said.txt").write_text(done.stdout)


def deepgps_here(*words: str, cwd: Path) -> CompletedProcess[str]:
    """The same in this process, without the seconds that a process of its own takes to start."""
    out, errors, code = io.StringIO(), io.StringIO(), 0
    with chdir(cwd), redirect_stdout(out), redirect_stderr(errors):
        try:
            main(words)
        except SystemExit as ended:
            code = ended.code if isinstance(ended.code, int) else 0
    return CompletedProcess(words, code, out.getvalue(), errors.getvalue())


@contextmanager
def started(*command: str, cwd: Path | None = None, **environment: str) -> Iterator[Popen[str]]:
    """A process that has been started, which is killed when left if it has not ended by then."""
    with Popen(
        command, cwd=cwd, env={**os.environ, **environment}, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def read_line(process: Popen[str], awaited: str) -> str:
    """The next line that a process prints; it is killed, and the test fails, where that takes too long."""
    assert process.stdout is not None
    if not select([process.stdout], [], [], LIMIT_S)[0]:
        process.kill()
        pytest.fail(f"waited {LIMIT_S:.0f} s for {awaited}: {process.communicate()}")
    return process.stdout.readline()


def wait_until(condition: Callable[[], object], process: Popen[str], awaited: str = "its work") -> None:
    """Wait for something that a running process brings about; it is killed where that takes too long."""
    end = time.monotonic() + LIMIT_S
    while not condition():
        assert process.poll() is None, f"{awaited}: {process.communicate()}"
        if time.monotonic() > end:
            process.kill()
            pytest.fail(f"waited {LIMIT_S:.0f} s for {awaited}: {process.communicate()}")
        time.sleep(0.02)


def drop_progress(said: str) -> list[str]:
    """The lines on standard error but those of the progress."""
    shown = r"[\w, +:]+: [\d,]+ of [\d,]+ \(\d+ %\).*|drives: .* idle cores"
    return [line for line in said.splitlines() if not re.fullmatch(shown, line)]


def assert_one_clear_line(done: CompletedProcess[str], code: int, message: str, folder: Path) -> None:
    """Assert how a command failed, and that it left nothing in the folder."""
    assert done.returncode == code, done.stderr
    assert message in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1, done.stderr
    assert "Traceback" not in done.stderr + done.stdout
    assert list(folder.rglob("*")) == [], "nothing half-written"


def arrays(run: Path) -> dict[str, bytes]:
    """Every array of a run, by its path."""
    paths = (path for path in sorted(run.rglob("*")) if path.suffix in {".npy", ".npz", ".safetensors"})
    return {path.relative_to(run).as_posix(): path.read_bytes() for path in paths}
