"""The diagnosis of a folder: that of a run, whose ``diagnosis.json`` is written, or of a recording alone."""

import json
from os.path import isfile
from pathlib import Path

from deepgps.diagnosis.diagnosis import Diagnosis, diagnose
from deepgps.diagnosis.store import FILE, read_diagnosis, write_diagnosis
from deepgps.runs.owned_folder import hold, is_older
from deepgps.runs.run_folder import RUN, is_study
from deepgps.terminal.progress import Report
from sim.errors import InputError
from sim.files.checksums import drop_sum
from sim.recording.format import open_recording
from sim.user_input import shorten


def diagnose_folder(folder: Path, out: Path | None, progress: Report) -> tuple[Diagnosis, Path | None]:
    """Diagnose the wheels of a recording or of a run, and write what was found.

    Args:
        folder: The folder of a recording or of a run.
        out: The file to write; None: that of the run, if the recording is a run's.
        progress: Called before and after.

    Returns:
        The diagnosis, and the file that was written, if any.

    Raises:
        InputError: The folder is neither, or the recording has no images after turns.
    """
    home = folder if isfile(folder / "manifest.json") else folder / "recording"
    if not isfile(home / "manifest.json"):
        raise InputError(
            f"{shorten(str(folder), 300)} is neither a recording (it has no manifest.json) nor a run with a finished "
            "recording"
        )
    run = home.parent if home.name == "recording" and isfile(home.parent / RUN.first) else None
    if run is not None and (is_older(run, RUN) or is_study(run.resolve().parent.parent)):
        run = None  # a study's runs, and those of an earlier version, are not changed
    progress("diagnose", 0, 1)
    recording = open_recording(home)
    diagnosis = diagnose(recording)
    progress("diagnose", 1, 1)
    path = out or (run and run / FILE)
    if run is not None and path == run / FILE:
        with hold(run, RUN, "the run"):
            if read_diagnosis(run, recording) != diagnosis:
                drop_sum(run / "run.rrd")  # the viewer's recording shows the diagnosis
                (run / "run.rrd").unlink(missing_ok=True)
            write_diagnosis(run / FILE, diagnosis, recording)
    elif path is not None:
        write_diagnosis(path, diagnosis, recording)
    return diagnosis, path


def is_diagnosis(data: bytes) -> bool:
    """Whether these are the contents of a diagnosis, which may be written over."""
    try:
        return {"quantities", "stretches", "faults"} <= set(json.loads(data))
    except (ValueError, TypeError, RecursionError):
        return False
