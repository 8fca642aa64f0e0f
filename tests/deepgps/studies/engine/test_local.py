"""Worker processes: one that dies fails its own run and no other, whenever it dies."""

from pathlib import Path
from types import SimpleNamespace

import pytest

from deepgps.studies.engine.local import count_workers, run_all
from deepgps.studies.plan import plan_runs
from deepgps.studies.study import load_study
from deepgps.terminal.progress import ignore
from sim.processes import start_process
from tests.helpers.small_study import write_study


@pytest.mark.parametrize(
    ("device", "gigabytes", "most"),
    [("cpu", 8, 64), ("cuda", 2, 1), ("cuda", 25, 7), ("auto", 800, 64), ("auto", 0, 64)],
)
def test_as_many_runs_train_on_a_gpu_at_once_as_fit(
    device: str, gigabytes: int, most: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("torch.cuda.is_available", lambda: gigabytes > 0)
    card = SimpleNamespace(total_memory=gigabytes * 10**9)
    monkeypatch.setattr("torch.cuda.get_device_properties", lambda _: card)
    monkeypatch.setattr("deepgps.studies.engine.local.usable_cores", lambda: 64)
    study = write_study(tmp_path, set={"learn.train.device": device})
    assert count_workers(plan_runs(load_study(str(study), tiny=False))) == most


def test_workers_that_die_before_they_read_anything_fail_their_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    plans = plan_runs(load_study(str(write_study(tmp_path)), tiny=False))
    monkeypatch.setattr(
        "deepgps.studies.engine.pool.start_process",
        lambda code, words, handles: start_process("raise SystemExit(3)", words, handles),
    )
    failures = run_all(plans, tmp_path, ignore)
    assert failures == {plan.run: "its process ended with 3" for plan in plans}
