"""Worker processes: one that dies fails its own run and no other, whenever it dies."""

from pathlib import Path

import pytest

from deepgps.progress import ignore
from deepgps.studies.engine.local import run_all
from deepgps.studies.study import load_study, plan_runs
from sim.processes import start_process
from tests.helpers.small_study import write_study


def test_workers_that_die_before_they_read_anything_fail_their_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    plans = plan_runs(load_study(str(write_study(tmp_path)), tiny=False))
    monkeypatch.setattr(
        "deepgps.studies.engine.local.start_process",
        lambda code, words, handles: start_process("raise SystemExit(3)", words, handles),
    )
    failures = run_all(plans, tmp_path, ignore)
    assert failures == {plan.run: "its process ended with 3" for plan in plans}
