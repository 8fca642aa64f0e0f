from pathlib import Path

import numpy as np
import pytest

from deepgps.evaluation.error_field import read_fields
from deepgps.evaluation.visibility import measure_visible
from deepgps.studies.catalog import REPORTS
from deepgps.studies.engine.engine import carry_out
from deepgps.studies.plan import plan_runs
from deepgps.studies.reports.concave import EDGES, add_reach, measure, pool, report
from deepgps.studies.reports.report import report_study
from deepgps.studies.study import load_study
from deepgps.studies.table import Row
from deepgps.terminal.progress import ignore
from sim.recording.format import open_truth
from tests.helpers.small_study import run_all_here

PARTS = range(len(EDGES) - 1)
EMPTY = {"heading_spread_m": None, "flipped": None, "fold_found": None}


def make_row(method: str, shape: str, little: float, rest: float) -> Row:
    """10 positions that reach little of the room, 90 that reach much, and the error of each [m]."""
    errors = {f"errors_{part}_m": {0: [little] * 10, 4: [rest] * 90}.get(part, []) for part in PARTS}
    return {"method": method, "room.shape": shape, **errors}


def test_parts_put_together_give_the_error_of_the_whole():
    rows = [make_row("deepgps", "l", 0.3, 0.1), make_row("deepgps", "u", 0.2, 0.1)]
    assert sorted(pool(rows, PARTS)) == pytest.approx([0.1] * 180 + [0.2] * 10 + [0.3] * 10)
    assert pool(rows, [0]).tolist() == [0.3] * 10 + [0.2] * 10
    assert pool(rows, [2]).tolist() == []


def test_the_median_is_that_of_all_positions_not_of_the_rooms_medians():
    rows = [make_row("deepgps", "l", 0.3, 0.1), make_row("deepgps", "u", 0.2, 0.1)]
    rows[0]["errors_0_m"] = [0.3] * 2
    common = dict.fromkeys(("samples", "distance_m", "rms_m", "median_m", "p95_m", "max_m", "train_s"), 0.1)
    table = report([{**row, **common, **EMPTY} for row in rows], [])[-2]
    assert " ".join(table.splitlines()[2].split()) == "| 0-10 % | 12 | 22.0 | 20.0 |"


def test_what_little_reach_costs_is_told_for_each_method():
    rows = [
        make_row("deepgps", shape, 0.4, 0.02 if shape == "two_rooms" else 0.01) for shape in ("rectangle", "two_rooms")
    ]
    rows += [make_row("posenet", shape, 0.01, 0.01) for shape in ("rectangle", "two_rooms")]
    figures = measure(rows)
    assert set(figures) == set(REPORTS["concave"].targets)
    assert figures["deepgps_little"].value == pytest.approx(0.4 / np.sqrt((0.02**2 + 0.01**2) / 2))
    assert figures["posenet_little"].value == pytest.approx(1.0)
    assert figures["posenet_two_rooms"].value == pytest.approx(1.0)


def test_a_study_without_places_of_little_reach_says_nothing_of_them():
    row = make_row("deepgps", "rectangle", 0.1, 0.1) | {"errors_0_m": []}
    assert measure([row])["deepgps_little"].value is None
    assert "deepgps_two_rooms" not in measure([row])


@pytest.mark.slow
def test_the_study_runs_to_its_pictures_and_its_columns_add_up(tmp_path: Path):
    study = load_study("concave", tiny=True)
    plans = plan_runs(study)
    folder = tmp_path / "study"
    assert carry_out(study, plans, folder, run_all=run_all_here, progress=ignore) == {}
    text = report_study(study, plans, {}, folder)
    assert "50-100 %" in text
    assert {path.name for path in folder.glob("figures/*")} == {"concave.png", "rooms.png"}
    run = folder / "runs" / plans[0].run
    row = add_reach(run, {"method": "deepgps"})
    field = read_fields(run)["deepgps"]
    np.testing.assert_allclose(sorted(pool([row], PARTS)), sorted(field.error), rtol=1e-6)
    visible = measure_visible(open_truth(run / "recording").free_space, field.truth)
    assert len(row["errors_5_m"]) == (visible >= 0.5).sum()
