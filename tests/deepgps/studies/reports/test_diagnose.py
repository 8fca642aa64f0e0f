"""The study of diagnoses: what is drawn, what counts as right, and the whole of its small version."""

from collections import Counter
from pathlib import Path

import pytest

from deepgps.studies.diagnose_runs import LIMITS
from deepgps.studies.plan import plan_runs
from deepgps.studies.reports.diagnose import confuse, list_set, measure
from deepgps.studies.study import load_study
from deepgps.studies.table import Row
from tests.helpers.command import deepgps_here


def row(made: str, found: str, must: str | None = None, track_m: float = 0.16) -> Row:
    """A recording: the faults that were set, found, and large enough; all intervals hold if ``track_m`` is 0.16."""
    names = {"track_m": 0.16, "reading_ratio": 1.0, "wheel_ratio": 1.0}
    names |= dict.fromkeys(("step_noise", "slip_per_m", "dropout", "stuck_fraction"), 0.0)
    values = {name: (track_m if name == "track_m" else true) for name, true in names.items()}
    bounds = {f"{name}_{end}": value for name, value in values.items() for end in ("low", "high")}
    truth = {f"{name}_true": true for name, true in names.items()}
    return {"set": made, "found": found, "must": made if must is None else must, **values, **bounds, **truth}


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


def test_what_counts_as_right():
    rows = [row("", ""), row("", "slip"), row("radius", "radius"), row("radius slip", "radius"), row("ticks", "", "")]
    rows += [row("alike", "track"), row("alike", "track radius"), row("track", "track", track_m=0.17)]
    figures = measure(rows)
    assert figures["recall"].value == pytest.approx(3 / 4), "a fault too small to be told need not be found"
    assert figures["precision"].value == pytest.approx(5 / 7)
    assert figures["false_alarms"].value == 1
    assert figures["false_alarms_alike"].value == 1
    assert figures["coverage_least"].value == pytest.approx(7 / 8)
    assert figures["track_error"].worst == pytest.approx(1 / 16)
    lines = {line[0]: line[1:] for line in confuse(rows)[1]}
    assert lines["none"][0] == "2"
    assert lines["both radii alike"][3] == "2", "the scale of turns"


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
    viewed = deepgps_here("view", "small", "--web", cwd=tmp_path)
    assert viewed.returncode == 2
    assert "without maps to view" in viewed.stderr
