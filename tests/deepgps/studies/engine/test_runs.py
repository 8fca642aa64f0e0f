"""The runs of a study: as many at once as fit; and of recordings that are diagnosed, a damaged one fails alone."""

import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from deepgps.diagnosis.store import read_diagnosis
from deepgps.studies.engine.runs import count_workers, diagnose_all


@pytest.mark.parametrize(
    ("device", "gigabytes", "most"),
    [("cpu", 8, 64), ("cuda", 2, 1), ("cuda", 25, 7), ("auto", 800, 64), ("auto", 0, 64)],
)
def test_as_many_runs_train_on_a_gpu_at_once_as_fit(
    device: str, gigabytes: int, most: int, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("torch.cuda.is_available", lambda: gigabytes > 0)
    card = SimpleNamespace(total_memory=gigabytes * 10**9)
    monkeypatch.setattr("torch.cuda.get_device_properties", lambda _: card)
    monkeypatch.setattr("deepgps.studies.engine.runs.usable_cores", lambda: 64)
    learn = SimpleNamespace(train=SimpleNamespace(device=device))
    plans: Any = [SimpleNamespace(scenario=SimpleNamespace(learn=learn))]
    assert count_workers(plans) == most


def test_a_process_that_does_runs_sets_its_threads_before_torch_reads_them():
    code = "import sys, deepgps.studies.engine.runs; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False, timeout=60).returncode == 0


@pytest.mark.slow
def test_of_recordings_of_one_drive_or_of_several_each_fails_for_its_own_reason(small_recording: Path, tmp_path: Path):
    for name in ("one", "other", "damaged", "late"):
        shutil.copytree(small_recording, tmp_path / "recordings" / name)
    np.save(tmp_path / "recordings" / "damaged" / "reading.npy", np.zeros((3, 2)))
    np.save(tmp_path / "recordings" / "late" / "time.npy", np.zeros(2))
    names = ("one", "damaged", "missing", "late", "other")
    plans: Any = [SimpleNamespace(run=f"run-{name}", recording=name) for name in names]
    told: list[Any] = []
    failed = diagnose_all(plans, tmp_path, lambda *what: told.append(what[:3]))
    assert set(failed) == {"run-damaged", "run-missing", "run-late"}
    assert "reading.npy" in failed["run-damaged"] and "time.npy" not in failed["run-damaged"]
    assert "time.npy" in failed["run-late"] and "missing" in failed["run-missing"]
    assert all(read_diagnosis(tmp_path / "runs" / f"run-{name}") is not None for name in ("one", "other"))
    assert told[-1] == ("diagnose", 5, 5)
