"""The runs of a study: as many at once as fit."""

import subprocess
import sys
from types import SimpleNamespace
from typing import Any

import pytest

from deepgps.studies.engine.runs import count_workers


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
