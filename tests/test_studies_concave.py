from pathlib import Path

import numpy as np
import pytest

from deepgps.error_field import read_fields
from deepgps.progress import ignore
from deepgps.studies.concave import EDGES, add_reach, measure, pool
from deepgps.studies.engine import carry_out
from deepgps.studies.engine_local import run_all
from deepgps.studies.report import report_study
from deepgps.studies.study import FIGURES, load_study, plan_runs
from deepgps.studies.table import Row
from deepgps.visibility import measure_visible
from sim.records import open_truth

PARTS = range(len(EDGES) - 1)


def make_row(method: str, shape: str, little: float, rest: float) -> Row:
    """10 positions that reach little of the room, 90 that reach much, and the RMS of each [m]."""
    row: Row = {"method": method, "room.shape": shape}
    for part in PARTS:
        count, rms = {0: (10, little), 4: (90, rest)}.get(part, (0, None))
        row |= {f"positions_{part}": count, f"rms_{part}_m": rms, f"median_{part}_m": rms}
    return row


def test_parts_put_together_give_the_error_of_the_whole():
    rows = [make_row("deepgps", "l", 0.3, 0.1), make_row("deepgps", "u", 0.2, 0.1)]
    assert pool(rows, PARTS) == pytest.approx(np.sqrt((10 * 0.09 + 10 * 0.04 + 180 * 0.01) / 200))
    assert pool(rows, [0]) == pytest.approx(np.sqrt((0.09 + 0.04) / 2))
    assert pool(rows, [2]) == 0.0


def test_what_little_reach_costs_is_told_for_each_method():
    rows = [
        make_row("deepgps", shape, 0.4, 0.02 if shape == "two_rooms" else 0.01) for shape in ("rectangle", "two_rooms")
    ]
    rows += [make_row("posenet", shape, 0.01, 0.01) for shape in ("rectangle", "two_rooms")]
    figures = measure(rows)
    assert set(figures) == set(FIGURES["concave"])
    assert figures["deepgps_little"].value == pytest.approx(0.4 / np.sqrt((0.02**2 + 0.01**2) / 2))
    assert figures["posenet_little"].value == pytest.approx(1.0)
    assert figures["posenet_two_rooms"].value == pytest.approx(1.0)


def test_a_study_without_places_of_little_reach_says_nothing_of_them():
    row = make_row("deepgps", "rectangle", 0.1, 0.1) | {"positions_0": 0, "rms_0_m": None, "median_0_m": None}
    assert measure([row])["deepgps_little"].value is None
    assert "deepgps_two_rooms" not in measure([row])


@pytest.mark.slow
def test_the_study_runs_to_its_pictures_and_its_columns_add_up(tmp_path: Path):
    study = load_study("concave", tiny=True)
    plans = plan_runs(study)
    folder = tmp_path / "study"
    assert carry_out(study, plans, folder, fresh=False, run_all=run_all, progress=ignore) == {}
    text = report_study(study, plans, {}, folder)
    assert "50-100 %" in text
    assert {path.name for path in folder.glob("figures/*")} == {"concave.png", "rooms.png"}
    run = folder / "runs" / plans[0].run
    row = add_reach(run, {"method": "deepgps"})
    field = read_fields(run)["deepgps"]
    assert sum(row[f"positions_{part}"] for part in PARTS) == len(field.error)
    assert pool([row], PARTS) == pytest.approx(np.sqrt(np.mean(field.error**2)))
    visible = measure_visible(open_truth(run / "recording").free_space, field.truth)
    assert row["positions_5"] == (visible >= 0.5).sum()
