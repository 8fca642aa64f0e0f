"""Recordings diagnosed by several processes: one that is damaged fails alone."""

import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from deepgps.diagnosis.store import read_diagnosis
from deepgps.studies.engine.diagnosing import diagnose_all


def plan(name: str) -> Any:
    return SimpleNamespace(run=f"run-{name}", recording=name)


def test_a_damaged_recording_fails_alone(small_recording: Path, tmp_path: Path):
    for name in ("one", "other", "damaged"):
        shutil.copytree(small_recording, tmp_path / "recordings" / name)
    np.save(tmp_path / "recordings" / "damaged" / "reading.npy", np.zeros((3, 2)))
    plans, told = [plan(name) for name in ("one", "damaged", "missing", "other")], []
    failed = diagnose_all(plans, tmp_path, lambda *what: told.append(what[:3]))
    assert set(failed) == {"run-damaged", "run-missing"}
    assert "reading.npy" in failed["run-damaged"]
    assert "missing" in failed["run-missing"]
    assert all(read_diagnosis(tmp_path / "runs" / f"run-{name}") is not None for name in ("one", "other"))
    assert told[-1] == ("diagnose", 4, 4)


def test_of_the_recordings_of_one_drive_each_fails_for_its_own_reason(small_recording: Path, tmp_path: Path):
    names = ("one", "two", "three")
    for name in names:
        shutil.copytree(small_recording, tmp_path / "recordings" / name)
    np.save(tmp_path / "recordings" / "one" / "reading.npy", np.zeros((3, 2)))
    np.save(tmp_path / "recordings" / "two" / "time.npy", np.zeros(2))
    failed = diagnose_all([plan(name) for name in names], tmp_path, lambda *what: None)
    assert set(failed) == {"run-one", "run-two"}
    assert "reading.npy" in failed["run-one"] and "time.npy" not in failed["run-one"]
    assert "time.npy" in failed["run-two"] and "reading.npy" not in failed["run-two"]
