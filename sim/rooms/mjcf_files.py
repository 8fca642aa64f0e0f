"""The files of a user's own room or robot, after a trial in a process with limits. It needs no MuJoCo itself."""

import json
import os
import subprocess
import sys
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

from sim.errors import InputError, shorten

Kind = Literal["room", "robot"]
LONGEST_S = 60.0
"""Longest time that a trial may take, also on a busy machine, for 10 s of computing [s]."""


def list_files(path: Path, kind: Kind = "room") -> list[Path]:
    """The files that a room or a robot uses, its own first, after MuJoCo has compiled it within the limits.

    Raises:
        InputError: It is refused; one line names the setting, the file and the reason.
    """
    what = f"{kind}.mjcf {shorten(str(path), 300)}"
    try:
        own = path.resolve(strict=True)
        state = own.stat()
    except FileNotFoundError:
        raise InputError(f"{what}: no such file") from None
    except (OSError, RuntimeError, ValueError) as error:
        raise InputError(f"{what}: cannot be found: {error}") from None
    if not own.is_file():
        raise InputError(f"{what} is {'a folder' if own.is_dir() else 'a pipe or a device'}, not a file")
    result = json.loads(_try_out(str(own), kind, state.st_mtime_ns, state.st_size))
    if "refused" in result:
        raise InputError(f"{what}: {shorten(result['refused'], 500)}")
    return [Path(file) for file in result["files"]]


@lru_cache(maxsize=8)
def _try_out(path: str, kind: Kind, changed_ns: int, size: int) -> str:
    """What the trial prints; a file that has not changed is tried out once."""
    command = [sys.executable, "-P", "-m", "sim.rooms.mjcf_trial", kind, path]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(os.path.abspath, sys.path)), "OMP_NUM_THREADS": "1"}
    with TemporaryDirectory() as folder:
        try:
            done = subprocess.run(
                command, cwd=folder, env=environment, capture_output=True, text=True, timeout=LONGEST_S, check=True
            )
        except (subprocess.TimeoutExpired, subprocess.CalledProcessError):
            reason = "MuJoCo cannot compile it within 10 s of computing and 2 GB of memory"
            return json.dumps({"refused": reason})
    return done.stdout
