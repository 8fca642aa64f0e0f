"""The study of worlds whose places look alike: its report from made-up rows, its worlds, and a small one for real."""

from pathlib import Path

import numpy as np
import pytest

from deepgps.studies.catalog import REPORTS
from deepgps.studies.engine.engine import carry_out
from deepgps.studies.plan import plan_runs
from deepgps.studies.reports import corridors
from deepgps.studies.reports.report import report_study
from deepgps.studies.study import load_study
from deepgps.studies.table import Row
from deepgps.terminal.progress import ignore
from sim.files.json_files import read_json
from tests.helpers.small_study import run_all_here

VARIED = ["room.kind", "room.seed", "room.look_alike", "room.width_m", "encoder.step_noise"]


def make_row(method: str, world: int, rms: float, noise: float = 0.0, **known: object) -> Row:
    settings = {"room.kind": "labyrinth", "room.seed": world, "room.look_alike": world == 1, "room.width_m": None}
    signs = {"fold_found": None, "undecided": None, "turned": 0.0}
    errors = {"rms_m": rms, "median_m": rms / 10, "misplaced": None, "seen": 0.9, **signs}
    place = {"method": method, "recording": f"{world}-{noise}", "encoder.step_noise": noise}
    return {**settings, **place, **errors, **known}


OWN = {"fold_found": False, "misplaced": 0.02, "map_rms_m": 0.004}
ROWS = [
    make_row("deepgps_compass", 0, 0.3, **OWN),
    make_row("posenet", 0, 0.2),
    make_row("knn", 0, 1.7),
    make_row("deepgps_compass", 1, 0.2, **OWN),
    make_row("posenet", 1, 0.2),
    make_row("knn", 1, 1.2),
    make_row("deepgps_compass", 0, 2.0, 0.3, fold_found=False, misplaced=0.6, undecided=True),
    make_row("deepgps_compass", 1, 2.0, 0.3, fold_found=False, misplaced=0.6, undecided=False),
    make_row("posenet", 1, 0.2, 0.3),
    make_row("deepgps", 0, 2.0, fold_found=True, misplaced=0.4),
    make_row("deepgps", 1, 0.3, fold_found=True, turned=0.1, misplaced=0.0),
]


def lines(table: str) -> list[list[str]]:
    return [[cell.strip() for cell in line.split("|")[1:-1]] for line in table.splitlines()[2:]]


def test_each_world_has_a_line_for_each_method_with_ratios_and_what_the_method_says() -> None:
    table = lines(corridors.report(ROWS, VARIED)[0])
    assert table[0] == [
        *("labyrinth 0", "0", "DeepGPS, compass", "30.0", "3.0", "1.50", "1.50", "0.4", "2.0 %", "nothing", "90.0 %")
    ]
    assert table[4][0:7] == ["labyrinth 1, alike", "0", "PoseNet", "20.0", "2.0", "-", "-"]
    assert [line[-2] for line in table[6:]] == ["undecided", "nothing", "-", "folded", "folded, turned 10.0 %"]
    assert table[6][5:9] == ["-", "-", "-", "60.0 %"]  # no PoseNet to compare with


def test_wrong_maps_are_counted_by_what_is_said_of_them() -> None:
    table = lines(corridors.report(ROWS, VARIED)[-1])
    assert table == [
        ["0", "DeepGPS, compass", "2", "0", "0", "0", "-", "0", "0"],
        ["0", "DeepGPS", "2", "1", "2", "1", "-", "0", "1"],
        ["0.3", "DeepGPS, compass", "2", "2", "0", "0", "1", "1", "0"],
    ]


def test_figures_are_medians_of_ratios_without_noise_and_counts_over_all() -> None:
    figures = corridors.measure(ROWS)
    assert set(figures) == set(REPORTS["corridors"].targets)
    values = {name: figure.value for name, figure in figures.items()}
    assert values == pytest.approx(
        {"compass_rms_ratio": 1.25, "compass_median_ratio": 1.25, "compass_unsaid": 1, "deepgps_unsaid": 0}
        | {"aliased_rms_m": 1.2}
    )
    assert figures["compass_rms_ratio"].worst == pytest.approx(1.5)


def test_a_study_of_one_method_has_no_ratios() -> None:
    figures = corridors.measure([row for row in ROWS if row["method"] == "knn"])
    assert set(figures) == {"aliased_rms_m"}


def test_the_study_has_twenty_worlds_each_driven_once() -> None:
    study = load_study("corridors", tiny=False)
    worlds = {tuple(sorted(case.items())) for case in study.cases}
    assert len(worlds) == len(study.cases) == 20
    assert {case["room.kind"] for case in study.cases} >= {"labyrinth", "corridor", "bedroom"}
    assert len(plan_runs(study)) == 40


@pytest.mark.slow
def test_the_study_runs_to_its_picture_and_its_columns_are_the_truth_s(tmp_path: Path) -> None:
    study = load_study("corridors", tiny=True)
    plans, folder = plan_runs(study), tmp_path / "study"
    assert carry_out(study, plans, folder, run_all=run_all_here, progress=ignore) == {}
    text = report_study(study, plans, {}, folder)
    assert "labyrinth 0, 4 x 3 m" in text
    assert "bedroom 1, 3.2 x 2.8 m, alike" in text
    assert (folder / "figures" / "corridors.png").stat().st_size > 10_000
    run = folder / "runs" / plans[0].run
    measured = read_json(run / "metrics.json")["methods"]["deepgps_compass"]
    assert 0.0 <= measured["misplaced"] <= 1.0
    assert np.isfinite(measured["rms_m"])
