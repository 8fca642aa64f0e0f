"""Opening recordings in the viewer that came with rerun-sdk."""

import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from deepgps.viewer.recording import find_recording
from sim.errors import WorkError


def view(paths: Sequence[Path]) -> None:
    """Open runs in the Rerun viewer and wait until it is closed.

    Args:
        paths: Run folders; a run without a recording gets one first.

    Raises:
        InputError: A folder is no run, or its recording is cut off.
        WorkError: The viewer is missing or cannot open a window.
    """
    recordings = [find_recording(path) for path in paths]
    # the viewer also listens for data; only this machine may send it any
    command = [find_viewer(), "--bind", "127.0.0.1", *map(str, recordings)]
    ended = subprocess.run(command, check=False, stderr=subprocess.PIPE, text=True)
    if ended.returncode != 0:
        lines = [line for line in ended.stderr.splitlines() if line.strip()] or ["no reason given"]
        raise WorkError(
            f"the Rerun viewer ended with {ended.returncode} ({lines[-1]}); without a display, copy "
            f"{recordings[0]} to a machine that has one, or: deepgps view {paths[0]} --web"
        )


def find_viewer() -> str:
    """Path of the viewer that came with rerun-sdk, whether or not its environment is active; raises WorkError."""
    places = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    viewer = shutil.which("rerun", path=places)
    if viewer is None:
        raise WorkError("the Rerun viewer is missing: there is no command rerun; pip install rerun-sdk brings it")
    return viewer
