"""``diagnosis.json`` in a run's folder: made once, read by every method, the viewer and people's own programs."""

import hashlib
import json
from os.path import isfile
from pathlib import Path
from typing import Any

from deepgps.diagnosis.diagnosis import (
    LEARNED_QUANTITIES,
    Diagnosis,
    Estimate,
    StuckStretch,
    apply_diagnosis,
    can_diagnose,
    diagnose,
)
from deepgps.diagnosis.findings import as_stored
from deepgps.diagnosis.gaps import mend_stuck
from deepgps.runs.owned_folder import hold
from deepgps.runs.run_folder import RUN, drop_viewed, is_study
from deepgps.terminal.progress import Report
from sim.errors import DamagedError, InputError, shorten
from sim.files.checksums import FORMAT, read_json, write_json
from sim.recording.format import Recording, open_recording

FILE = "diagnosis.json"


def diagnose_once(recording: Recording, folder: Path) -> Diagnosis | None:
    """The diagnosis of a run's recording, as stored in its folder or made and stored.

    None without turns, with too few readings to tell anything, or where these are not the wheels' own.
    """
    if not can_diagnose(recording):
        return None
    if (stored := read_diagnosis(folder, recording)) is not None:
        return stored
    diagnosis = diagnose(recording)
    write_diagnosis(folder / FILE, diagnosis, recording)
    return diagnosis


def take_diagnosed(recording: Recording, folder: Path) -> tuple[Recording, dict[str, Any]]:
    """The recording with noise and track width as diagnosed, a stuck wheel mended, and what ``training.json`` says.

    Recordings without turns keep what their odometry's data sheet says.
    """
    diagnosis = diagnose_once(recording, folder)
    if diagnosis is None:
        return recording, {"diagnosed": None}
    mended = apply_diagnosis(mend_stuck(recording), diagnosis)
    return mended, {"diagnosed": {name: mended.manifest.odometry.get(name) for name in LEARNED_QUANTITIES}}


def write_diagnosis(path: Path, diagnosis: Diagnosis, recording: Recording) -> None:
    """Write a diagnosis, with the faults that it shows and what to set."""
    values = {name: vars(estimate) for name, estimate in diagnosis.quantities.items()}
    write_json(
        path,
        {
            "format": FORMAT,  # Number of the format
            "recording": digest_files(recording),  # Digest of the recording, of which alone the diagnosis is valid
            # Estimates by name: value, low and high of the 95 % interval, std where it is symmetric
            "quantities": values,
            "stretches": [vars(one) for one in diagnosis.stretches],  # Stretches in which a wheel is stuck
            "turns": diagnosis.turns,  # Turns in place that were compared
            "pairs": diagnosis.pairs,  # Pairs of images of about one place that were compared
            "odometry": diagnosis.odometry,  # The constants that readings were converted with
            **as_stored(diagnosis),
        },
    )


def read_diagnosis(folder: Path, recording: Recording | None = None) -> Diagnosis | None:
    """The diagnosis in a run's folder; None: there is none, it is damaged, or it is of another recording."""
    try:
        stored = read_json(folder / FILE)
        if recording is not None and stored["recording"] != digest_files(recording):
            return None
        return Diagnosis(
            **{name: Estimate(**values) for name, values in stored["quantities"].items()},
            stretches=tuple(StuckStretch(**values) for values in stored["stretches"]),
            turns=stored["turns"],
            pairs=stored["pairs"],
            odometry=stored["odometry"],
        )
    except (DamagedError, KeyError, TypeError):
        return None


def digest_files(recording: Recording) -> str:
    """Hexadecimal digest of a recording's files and its odometry."""
    manifest = recording.manifest
    named = json.dumps([manifest.sha256, manifest.odometry], sort_keys=True)
    return hashlib.sha256(named.encode()).hexdigest()[:16]


def diagnose_folder(folder: Path, out: Path | None, progress: Report) -> tuple[Diagnosis, Path | None]:
    """Diagnose the wheels of a recording or of a run, and write what was found to a file, or to that of the run.

    Also returns the file, if any. Raises InputError if the folder is neither, or there are no images after turns.
    """
    home = folder if isfile(folder / "manifest.json") else folder / "recording"
    if not isfile(home / "manifest.json"):
        raise InputError(
            f"{shorten(str(folder), 300)} is neither a recording (it has no manifest.json) nor a run with a finished "
            "recording"
        )
    run = home.parent if home.name == "recording" and isfile(home.parent / RUN.first) else None
    if run is not None and is_study(run.resolve().parent.parent):
        run = None  # a study's runs are not changed
    progress("diagnose", 0, 1)
    recording = open_recording(home)
    diagnosis = diagnose(recording)
    progress("diagnose", 1, 1)
    path = out or (run and run / FILE)
    if run is not None and path == run / FILE:
        with hold(run, RUN, "the run"):
            if read_diagnosis(run, recording) != diagnosis:
                drop_viewed(run)
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
