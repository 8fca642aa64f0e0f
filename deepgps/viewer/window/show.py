"""Opening recordings in the viewer that came with rerun-sdk."""

import shlex
import signal
import subprocess
from collections.abc import Sequence
from pathlib import Path

from deepgps.runs.run_folder import is_study
from deepgps.viewer.pair import write_pair
from deepgps.viewer.run.recording import find_recording
from deepgps.viewer.study.study import find_study
from deepgps.viewer.window.connect import HOST, end_group, find_free_port, find_viewer, has_display
from sim.errors import WorkError


def view(paths: Sequence[Path]) -> None:
    """Open a run or a study, or two runs side by side, in the Rerun viewer and wait until it is closed.

    Args:
        paths: As in ``find_shown``.

    Raises:
        InputError: As in ``find_shown``.
        WorkError: The viewer is missing or cannot open a window.
    """
    recording = find_shown(paths)
    # The viewer also listens for data, which only this machine may send. At the port of another viewer, it would hand
    # over the recording without opening a window, and wait forever if that viewer hangs.
    command = [find_viewer(), "--bind", HOST, "--port", str(find_free_port()), str(recording)]
    fix = (
        f"without a display, copy {recording} to a machine that has one, or run: "
        f"deepgps view {shlex.join(map(str, paths))} --web"
    )
    if not has_display():
        raise WorkError(f"the Rerun viewer cannot open a window; {fix}")
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True) as viewer:
        try:
            _, said = viewer.communicate()
        except BaseException:
            end_group(viewer, signal.SIGTERM)
            raise
    if viewer.returncode != 0:
        lines = [line for line in said.splitlines() if line.strip()] or ["no reason given"]
        raise WorkError(f"the Rerun viewer exited with code {viewer.returncode} ({lines[-1]}); {fix}")


def find_shown(paths: Sequence[Path]) -> Path:
    """Return the recording that shows these folders; write it if it is missing.

    Args:
        paths: The folder of one run or of one study, or the folders of two runs, which share one recording.

    Raises:
        InputError: A folder is neither a run nor a finished study, its recording is truncated, or two runs cannot be
            compared.
    """
    if len(paths) != 1:
        return write_pair(paths)
    return find_study(paths[0]) if is_study(paths[0]) else find_recording(paths[0])
