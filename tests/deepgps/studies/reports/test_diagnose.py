"""The study of diagnoses: what is drawn, what counts as right, and the whole of its small version."""

from collections import Counter
from pathlib import Path

import pytest

from deepgps.studies.plan import plan_runs
from deepgps.studies.reports.diagnose import LIMITS, list_set
from deepgps.studies.study import load_study
from tests.helpers.command import deepgps_here


def test_two_hundred_recordings_have_every_fault_within_the_limits():
    plans = plan_runs(load_study("diagnose", tiny=False))
    kinds = Counter(" ".join(list_set(plan.scenario)) for plan in plans)
    assert len(plans) == len({plan.recording for plan in plans}) == 200
    assert (kinds[""], kinds["alike"]) == (40, 40)
    assert {name for kind in kinds for name in kind.split()} == {
        *("alike", "radius", "wheel", "track", "slip", "step_noise", "ticks", "dropout", "stuck")
    }
    assert sum(count for kind, count in kinds.items() if len(kind.split()) == 2) == 24
    for plan in plans:
        for name, value in plan.varied.items():
            low, high = LIMITS.get(name, (float("-inf"), float("inf")))
            assert low <= (abs(value) if name in LIMITS else 0.0) <= high


@pytest.mark.slow
def test_the_small_study_runs_and_does_nothing_twice(tmp_path: Path):
    done = deepgps_here("study", "diagnose", "--tiny", "--out", "small", "--publish", "pages", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "What was found" in done.stdout
    written = {path: path.stat().st_mtime_ns for path in tmp_path.glob("small/runs/*/diagnosis.json")}
    assert len(written) == 23
    assert (tmp_path / "pages" / "diagnose-tiny" / "figures" / "diagnose.png").is_file()
    again = deepgps_here("study", "diagnose", "--tiny", "--out", "small", cwd=tmp_path)
    assert again.stdout.startswith("# diagnose-tiny")
    assert {path: path.stat().st_mtime_ns for path in written} == written
