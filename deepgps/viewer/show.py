"""Opening recordings in the viewer that came with rerun-sdk."""

import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from deepgps.viewer.pair import write_pair
from deepgps.viewer.recording import find_recording
from deepgps.viewer.study import find_study
from deepgps.viewer.study_read import is_study
from sim.errors import WorkError


def view(paths: Sequence[Path]) -> None:
    """Open a run or a study, or two runs side by side, in the Rerun viewer and wait until it is closed.

    Args:
        paths: As of ``find_shown``.

    Raises:
        InputError: As of ``find_shown``.
        WorkError: The viewer is missing or cannot open a window.
    """
    recording = find_shown(paths)
    # the viewer also listens for data; only this machine may send it any
    command = [find_viewer(), "--bind", "127.0.0.1", str(recording)]
    ended = subprocess.run(command, check=False, stderr=subprocess.PIPE, text=True)
    if ended.returncode != 0:
        lines = [line for line in ended.stderr.splitlines() if line.strip()] or ["no reason given"]
        raise WorkError(
            f"the Rerun viewer ended with {ended.returncode} ({lines[-1]}); without a display, copy "
            f"{recording} to a machine that has one, or: deepgps view {' '.join(map(str, paths))} --web"
        )


def find_shown(paths: Sequence[Path]) -> Path:
    """The recording that shows these folders, written where it is missing.

    Args:
        paths: The folder of one run or of one study, or those of two runs, which get one recording of both.

    Raises:
        InputError: A folder is no run and no finished study, its recording is cut off, or two cannot be compared.
    """
    if len(paths) != 1:
        return write_pair(paths)
    return find_study(paths[0]) if is_study(paths[0]) else find_recording(paths[0])


def find_viewer() -> str:
    """Path of the viewer that came with rerun-sdk, whether or not its environment is active; raises WorkError."""
    places = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    viewer = shutil.which("rerun", path=places)
    if viewer is None:
        raise WorkError("the Rerun viewer is missing: there is no command rerun; pip install rerun-sdk brings it")
    return viewer
