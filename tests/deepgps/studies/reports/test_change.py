"""The study of changes in use: its report from made-up rows, its runs, and a small one for real."""

from pathlib import Path

import pytest

from deepgps.reports.style import to_png
from deepgps.studies.catalog import REPORTS
from deepgps.studies.engine.engine import carry_out
from deepgps.studies.plan import plan_runs
from deepgps.studies.reports import change
from deepgps.studies.reports.report import report_study
from deepgps.studies.study import load_study
from deepgps.studies.table import Row
from deepgps.terminal.progress import ignore
from tests.helpers.small_study import run_all_here

VARIED = ["deployment.light", "deployment.daylight", change.LIGHT, change.VALUES]


def make_row(median: float, light: float = 1.0, daylight: float | None = None) -> Row:
    settings = {"seed": 0, "deployment.light": light, "deployment.daylight": daylight}
    training = {"method": "deepgps_compass", change.LIGHT: False, change.VALUES: "ranks"}
    errors = {"rms_m": 2 * median, "median_m": median, "p95_m": 3 * median, "max_m": 10 * median}
    return {**settings, **training, **errors}


ROWS = [
    make_row(0.01),
    make_row(0.02, light=0.2),
    make_row(0.03, daylight=0.3),
    {**make_row(0.05, daylight=0.0), "accepted": 0.9, "rms_accepted_m": 0.04},
    {**make_row(0.02), change.VALUES: "pixels"},
    {**make_row(0.08, light=0.2), change.VALUES: "pixels"},
    {**make_row(0.04, daylight=0.0), change.LIGHT: True},
]


def test_each_training_has_a_table_in_which_changes_stand_beside_none():
    blocks = change.report(ROWS, VARIED)
    assert [block for block in blocks if block.startswith("##")] == [
        "## Trained in one light, features of ranks",
        "## Trained in one light, features of pixels",
        "## Trained in several lights, features of ranks",
    ]
    ranks = blocks[1].replace(" ", "").splitlines()
    assert ranks[2].startswith("|nochange|DeepGPS,compass|1|2.0(1.00)|1.0(1.00)")
    assert ranks[3].startswith("|alllightx0.2|DeepGPS,compass|1|4.0(2.00)|2.0(2.00)")
    assert ranks[-1].endswith("|90.0|4.0|")
    assert "accepted" not in blocks[3]


def test_the_worst_change_of_each_kind_is_a_figure():
    values = {name: figure.value for name, figure in change.measure(ROWS).items()}
    assert values == pytest.approx({"light_0.2_ratio": 2.0, "mixed_ratio": 5.0})
    assert set(REPORTS["change"].targets) == set(change.FIGURES)
    assert change.measure(ROWS[1:2]) == {}


def test_a_study_on_one_kind_of_features_needs_not_vary_it(tmp_path: Path):
    rows = [{name: value for name, value in row.items() if name != change.VALUES} for row in ROWS[:4]]
    varied = [name for name in VARIED if name != change.VALUES]
    assert change.report(rows, varied)[0] == "## Trained in one light"
    assert change.measure(rows)["light_0.2_ratio"].value == pytest.approx(2.0)
    assert to_png(change.draw(rows, varied, tmp_path)).startswith(b"\x89PNG")


def test_each_change_is_trained_in_one_light_and_in_several_on_pixels_and_on_ranks():
    plans = plan_runs(load_study("change", tiny=False))
    assert len(plans) == 11 * 2 * 2
    assert len({plan.recording for plan in plans}) == 11 * 2
    titles = {title for titles in change.FIGURES.values() for title in titles}
    rows = [{**plan.varied} for plan in plans]
    names = sorted({name for row in rows for name in row})
    usual = {"deployment.daylight": None, "deployment.exposure": "fixed"}
    flags = ("deployment.person", "deployment.lamp_on")
    for name in names:
        for row in rows:
            row.setdefault(name, usual.get(name, name not in flags and float(name != "deployment.moved_m")))
    assert titles < set(change.group_changes(rows, names))


def test_a_small_one_runs(tmp_path: Path):
    study = load_study("change", tiny=True)
    plans = plan_runs(study)
    failures = carry_out(study, plans, tmp_path, run_all_here, ignore)
    assert not failures
    assert "automatic exposure" in report_study(study, plans, failures, tmp_path)
    assert (tmp_path / "figures" / "change.png").stat().st_size > 10_000
