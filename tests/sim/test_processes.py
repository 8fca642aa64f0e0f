"""Worker processes: as many as the cores that may be used, and none that outlives its parent."""

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

from sim.processes import usable_cores


def test_only_cores_that_may_be_used_are_counted():
    allowed = os.sched_getaffinity(0)
    try:
        os.sched_setaffinity(0, {min(allowed)})
        assert usable_cores() == 1
    finally:
        os.sched_setaffinity(0, allowed)
    assert usable_cores() == len(allowed)


def test_a_worker_ends_with_a_parent_that_is_killed():
    code = (
        "import time; from sim.processes import WORKERS\n"
        "if __name__ == '__main__':\n"
        "    worker = WORKERS.Process(target=time.sleep, args=(600,)); worker.start(); print(worker.pid, flush=True)\n"
        "    worker.join()"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        worker = Path(f"/proc/{int(parent.stdout.readline())}")
        wait_for(lambda: b"spawn_main" in read_if_there(worker / "cmdline"))
        parent.kill()
    wait_for(lambda: not read_if_there(worker / "cmdline"))


def read_if_there(file: Path) -> bytes:
    """What a file of a process holds; nothing once the process has ended."""
    try:
        return file.read_bytes()
    except (FileNotFoundError, ProcessLookupError):
        return b""


def wait_for(holds: Callable[[], bool]) -> None:
    end = time.monotonic() + 60.0
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.05)
