"""The study of initial maps: its report from made-up rows, its rooms, and a small one for real."""

from pathlib import Path

import pytest

from deepgps.reports.style import to_png
from deepgps.studies.catalog import REPORTS
from deepgps.studies.engine.engine import carry_out
from deepgps.studies.plan import plan_runs
from deepgps.studies.reports import maps
from deepgps.studies.reports.report import report_study
from deepgps.studies.study import load_study
from deepgps.studies.table import Row
from deepgps.terminal.progress import ignore
from tests.helpers.small_study import run_all_here

VARIED = ["room.kind", "room.seed", maps.NOISE, maps.SLIP]


def make_row(room: int, noise: float, slip: float, rms_m: float, nees: float, flipped_m2: float) -> Row:
    settings = {"seed": 0, "room.kind": "office", "room.seed": room, maps.NOISE: noise, maps.SLIP: slip}
    measured = {"rms_m": rms_m, "expected_rms_m": rms_m / 2, "nees": nees, "flipped_m2": flipped_m2}
    return {**settings, **{f"map_{name}": value for name, value in measured.items()}}


ROWS = [
    make_row(0, 0.0, 0.0, 0.002, 0.8, 0.0),
    make_row(1, 0.0, 0.0, 0.004, 1.0, 0.3),
    make_row(0, 0.1, 0.05, 0.02, 1.5, 0.05),
]


def test_each_encoder_has_a_line_over_all_rooms_and_each_map_one_of_its_own() -> None:
    encoders, note, each = maps.report(ROWS, VARIED)
    assert encoders.splitlines()[2].replace(" ", "") == "|exact|2|0.30|0.40|0.15|0.90|1of2|"
    assert encoders.splitlines()[3].replace(" ", "") == "|w0.1,slip0.05|1|2.00|2.00|1.00|1.50|0of1|"
    assert "reversed neighbourhoods" in note
    assert each.splitlines()[3].replace(" ", "") == "|office1|0|exact|0.40|0.20|1.00|0.30|"


def test_maps_with_a_large_patch_turned_over_are_counted() -> None:
    figures = maps.measure(ROWS)
    assert set(REPORTS["maps"].targets) <= set(figures)
    assert figures["mirrored"].value == 1
    assert figures["nees exact"].value == pytest.approx(0.9)


def test_methods_without_a_map_by_compass_are_left_out(tmp_path: Path) -> None:
    other = {**ROWS[0], **{name: None for name in ROWS[0] if name.startswith("map_")}}
    assert maps.report([*ROWS, other], VARIED) == maps.report(ROWS, VARIED)
    assert maps.measure([*ROWS, other]) == maps.measure(ROWS)
    for rows in ([*ROWS, other], [other]):
        assert to_png(maps.draw(rows, VARIED, tmp_path)).startswith(b"\x89PNG")
    assert maps.report([other], VARIED)[0].count("\n") == 1


def test_the_study_has_sixty_drives_and_runs_small(tmp_path: Path) -> None:
    plans = plan_runs(load_study("maps", tiny=False))
    assert len({plan.recording for plan in plans}) == len(plans) == 4 * 60
    study = load_study("maps", tiny=True)
    plans = plan_runs(study)
    failures = carry_out(study, plans, tmp_path, run_all_here, ignore)
    assert not failures
    assert "maps mirrored in part, of 4" in report_study(study, plans, failures, tmp_path)
    assert (tmp_path / "figures" / "maps.png").stat().st_size > 10_000
