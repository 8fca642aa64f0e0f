"""Every report: its published figures come out of its table again, no number is lost, and cells follow from rows."""

import re
from functools import cache
from pathlib import Path
from pkgutil import resolve_name
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deepgps.config.scenario import names_in
from deepgps.reports.plots import to_png
from deepgps.studies.catalog import REPORTS
from deepgps.studies.engine.engine import carry_out
from deepgps.studies.plan import plan_runs
from deepgps.studies.reports.pictures import draw
from deepgps.studies.reports.record import VARIED_SETTINGS, Fields, StudyReport, Table, Target
from deepgps.studies.reports.render import add_base, measure, pick, prepare, take, write_table, write_value
from deepgps.studies.reports.report import describe_doubts, report_study, varied_names, write_report
from deepgps.studies.study import Study, load_study
from deepgps.studies.table import Row, choices, describe, read_rows, shorten
from deepgps.terminal.progress import ignore
from docs.shorten import shorten as make_short
from sim.files import STUDIES
from tests.helpers.command import deepgps, drop_progress
from tests.helpers.reports import read_cells
from tests.helpers.small_study import run_all_here

RESULTS = STUDIES.parents[1] / "docs" / "results"
PUBLISHED = sorted(path.parent.name for path in RESULTS.glob("*/table.md"))
BY_COMMAND = "noise_w"
"""The study whose small version is run by the command."""
SMALL_STUDIES_SAY = {
    "camera": "knocked 8° to the right",
    "change": "automatic exposure",
    "corridors": "| bedroom",
    "diagnose": "What was found",
    "encoder": "Which encoder keeps most of the room within 2 cm",
    "knowing": "| a part not driven",
}
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e-?\d+)?")


@cache
def read_published(name: str) -> tuple[Study, list[Row]]:
    study = load_study(name.removesuffix("-full"), tiny=False, full=name.endswith("-full"))
    return study, read_rows(RESULTS / name / "table.parquet")


@cache
def write_again(name: str) -> str:
    study, rows = read_published(name)
    return write_report(study, [SimpleNamespace(scenario=SimpleNamespace(name="any"))], {}, rows)  # pyright: ignore


@pytest.mark.parametrize("name", PUBLISHED)
def test_published_figures_and_numbers_come_out_of_the_table_again(name: str) -> None:
    published, text = (RESULTS / name / "table.md").read_text(), write_again(name)
    written = {line[0]: line[1:] for line in read_cells(text.partition("## Summary")[2])}
    figures = [line for line in read_cells(published) if line[0] in written and len(line) == 7]
    for title, *cells in figures:  # an interval or a worst value may be new
        more = [old if old != "-" else new for old, new in zip(cells[1:3], written[title][1:3], strict=True)]
        assert written[title] == [cells[0], *more, *cells[3:]]
    numbers = np.array([word for line in read_cells(text) for cell in line for word in NUMBER.findall(cell)], float)
    have = np.sort(np.concatenate([numbers, 0.01 * numbers, 100.0 * numbers, 1.0 + 0.01 * numbers]))  # in any unit
    for word in {word for line in read_cells(published) for cell in line for word in NUMBER.findall(cell)}:
        digits, value = len(word.partition(".")[2]), float(word)
        tolerance = max(0.51 * 10.0**-digits, 0.0051 * abs(value))
        assert np.diff(np.searchsorted(have, [value - tolerance, value + tolerance])) > 0, word


@pytest.mark.parametrize("name", PUBLISHED)
def test_a_page_can_be_made_short(name: str) -> None:
    page = make_short(write_again(name))
    lines = [line for line in page.splitlines() if line.startswith("|")]
    assert 3 <= len(lines) <= 14 and max(line.count("|") for line in lines) <= 9
    assert "writes the complete report" in page


@pytest.mark.slow
@pytest.mark.parametrize("name", PUBLISHED)
def test_pictures_of_published_tables_are_drawn(name: str) -> None:
    (study, rows), report = read_published(name), REPORTS[read_published(name)[0].report]
    prepared = prepare(report, rows, varied_names(study))
    for picture in report.pictures.values():
        if not isinstance(picture, Fields):  # those need files of runs
            assert to_png(draw(picture, prepared, varied_names(study), Path())).startswith(b"\x89PNG")


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in names_in(STUDIES) if name != BY_COMMAND])
def test_the_small_study_runs_to_its_pictures(name: str, tmp_path: Path) -> None:
    study = load_study(name, tiny=True)
    plans = plan_runs(study)
    assert carry_out(plans, plans, tmp_path, run_all_here, ignore) == {}
    text = report_study(study, plans, {}, tmp_path)
    report, origin = text.rsplit("\n\n", 1)
    rows = read_rows(tmp_path / "table.parquet")
    assert text.startswith(write_report(study, plans, {}, rows))
    assert SMALL_STUDIES_SAY.get(name, "") in report and origin.startswith("Made at ")
    assert set(varied_names(study)) <= set(rows[0])
    drawn = {path.stem for path in tmp_path.glob("figures/*.png") if path.stat().st_size > 10_000}
    assert drawn == set(REPORTS[study.report].pictures)
    if name == "encoder":  # its room is driven once, and distances get worse with noise
        manifests = [path.read_text() for path in tmp_path.glob("recordings/*/manifest.json")]
        assert sum("derived_from" not in text for text in manifests) == 1 < len(manifests)
        noisy = [row for row in rows if row["encoder.step_noise"] == 0.1]
        assert noisy and all(row["segment_rms_m"] > 10 * rows[0]["segment_rms_m"] for row in noisy)


@pytest.mark.slow
def test_a_study_run_by_the_command_is_published_and_noise_of_the_encoders_does_not_reach_posenet(tmp_path: Path):
    done = deepgps("study", BY_COMMAND, "--tiny", "--networks", "--out", "out", "--publish", "results", cwd=tmp_path)
    assert (done.returncode, drop_progress(done.stderr)) == (0, [])
    published = tmp_path / "results" / f"{BY_COMMAND}-tiny"
    names = {path.relative_to(published).as_posix() for path in published.rglob("*") if path.is_file()}
    assert names == {"table.md", "table.parquet", "figures/curves.png"}
    for name in names:
        assert (published / name).read_bytes() == (tmp_path / "out" / name).read_bytes()
    rows = read_rows(published / "table.parquet")
    assert {row["scenario"] for row in rows} == {"landmarks", "tiny"}
    assert {row["encoder.step_noise"] for row in rows} == {0.0, 0.1}
    assert len({(row["scenario"], row["rms_m"]) for row in rows if row["method"] == "posenet"}) == 2


def test_every_record_names_a_function_that_exists_and_each_figure_once() -> None:
    for report in REPORTS.values():
        assert report.tables
        assert not report.columns or callable(resolve_name(f"deepgps.studies.reports.{report.columns}"))
        assert len({target.name for target in report.targets}) == len(report.targets)


# --- cells


@given(st.floats(1e-3, 1e6))
def test_a_cell_has_three_digits(value: float) -> None:
    assert float(write_value(value)) == pytest.approx(value, rel=0.0051)
    assert float(write_value(value, "cm")) == pytest.approx(100 * value, rel=0.0051)
    assert [write_value(one) for one in (None, "", "text", True, 8000, 0.0)] == ["-", "-", "text", "True", "8000", "0"]


ROWS: list[Row] = [
    {"room": "a", "seed": 0, "method": "deepgps", "rms_m": 0.02, "folded": True, "said": "one", "seen": 0.5},
    {"room": "a", "seed": 1, "method": "deepgps", "rms_m": 0.04, "folded": None, "said": "one", "seen": 0.9},
    {"room": "a", "seed": 0, "method": "posenet", "rms_m": 0.01, "folded": False, "said": None, "seen": None},
    {"room": "b", "seed": 0, "method": "deepgps", "rms_m": 0.08, "folded": True, "said": "two", "seen": 0.7},
]


def tell(columns: str, rows: list[Row] | None = None, **table: object) -> list[list[str]]:
    (text,) = write_table(Table("room method", columns, **table), ROWS if rows is None else rows, [])  # pyright: ignore
    return read_cells(text, headings=True)


def test_a_cell_is_the_mean_the_count_or_the_text_of_its_lines_rows() -> None:
    heading, ours, posenet, other = tell("runs rms_m rms_m:max folded said seen nothing")
    assert heading == ["room", "method", "runs", "RMS [cm]", "RMS, most [cm]", "folded", "said", "seen [%]"]
    assert ours == ["a", "DeepGPS", "2", "3.00", "4.00", "1", "one", "70.0"]
    assert posenet == ["a", "PoseNet", "1", "1.00", "1.00", "0", "-", "-"]
    assert other[2:] == ["1", "8.00", "8.00", "1", "two", "70.0"]


def test_summaries_follow_for_each_method_and_the_worst_share_is_the_least() -> None:
    lines = tell("rms_m seen", summary="mean std worst")[4:]
    assert [line[:2] for line in lines[::2]] == [["mean", "DeepGPS"], ["std", "DeepGPS"], ["worst", "DeepGPS"]]
    assert lines[0][2:] == ["4.67", "70.0"]
    assert float(lines[2][2]) == pytest.approx(np.std([2, 4, 8]), rel=0.005)
    assert lines[4][2:] == ["8.00", "50.0"]


def test_a_base_is_the_mean_of_other_rows_with_the_same_values() -> None:
    rows = add_base(ROWS, {"method": "posenet"}, ["room"], "rms_m")
    assert [row["base_rms_m"] for row in rows] == [0.01, 0.01, 0.01, None]
    lines = tell("rms_m/base", rows)
    assert [line[2] for line in lines] == ["RMS / base", "3.00", "1.00", "-"]
    assert take(rows, "rms_m/base", "max") == pytest.approx(4.0)


def test_values_side_by_side_are_those_of_their_own_rows() -> None:
    (text,) = write_table(Table("room", "", across="method", each="rms_m"), ROWS, [])
    assert read_cells(text, headings=True) == [
        ["room", "DeepGPS: RMS [cm]", "PoseNet: RMS [cm]"],
        ["a", "3.00", "1.00"],
        ["b", "8.00", "-"],
    ]


def test_rows_are_picked_by_values_by_several_and_by_functions() -> None:
    assert pick(ROWS, {"seed": 0, "method": ("deepgps", "knn")}) == [ROWS[0], ROWS[3]]
    assert pick(ROWS, {"seen": None}) == [ROWS[2]]
    assert pick(ROWS, {"rms_m": lambda rms: rms > 0.03}) == [ROWS[1], ROWS[3]]


def figures_of(*targets: Target, rows: list[Row] = ROWS) -> dict[str, float | None]:
    report = StudyReport((), targets=targets)
    return {name: figure.value for name, figure in measure(report, rows).items()}


def test_figures_are_means_medians_shares_counts_and_ratios() -> None:
    ours, based = {"method": "deepgps"}, add_base(ROWS, {"method": "posenet"}, ["room"], "rms_m")
    values = figures_of(
        Target("mean", "", "rms_m", ours),
        Target("median", "", "rms_m:median", ours),
        Target("share", "", "folded:share"),
        Target("count", "", "folded:count"),
        Target("base", "", "rms_m", ours, {"method": "posenet"}),
        Target("ratio", "", "rms_m:ratio", ours),
        Target("worst", "", "rms_m", ours, each="room"),
        Target("best", "", "rms_m", ours, each="room", at_least=True),
        Target("{method}_{room}", "", "rms_m", per="method room"),
        Target("none", "", "rms_m", {"method": "knn"}),
        rows=based,
    )
    assert values.pop("share") == pytest.approx(2 / 3)
    assert values == pytest.approx(
        {"mean": 0.14 / 3, "median": 0.04, "count": 2, "base": 14 / 3, "ratio": 3.0, "worst": 0.08, "best": 0.03}
        | {"deepgps_a": 0.03, "posenet_a": 0.01, "deepgps_b": 0.08}
    )


def test_cases_are_told_apart_by_the_fewest_names_in_words() -> None:
    rows = [{"kind": kind, "as": kind.upper(), "flag": flag, "n": 3} for kind in "xy" for flag in (True, False)]
    assert choices(rows, ["kind", "as", "flag", "n"]) == ["kind", "flag"]
    assert [describe(row, ["kind", "flag", "n"]) for row in rows[:2]] == ["x, flag, n 3", "x, n 3"]
    assert shorten(["drive.samples", "learn.train.samples", "learn.start"]) == [
        "drive.samples",
        "train.samples",
        "start",
    ]
    (text,) = write_table(Table(VARIED_SETTINGS, "runs"), [{"kind": None, "room.seed": 0.5}], ["kind", "room.seed"])
    assert read_cells(text) == [["-", "0.5", "1"]]


def test_maps_without_a_test_grid_are_neither_folded_nor_not() -> None:
    for name in ("rooms30", "recipe-full", "camera"):
        study, rows = read_published(name)
        report = REPORTS[study.report]
        prepared = prepare(report, [{**row, "flipped": None} for row in rows], varied_names(study))
        heading = read_cells(write_table(report.tables[0], prepared, varied_names(study))[0], headings=True)[0]
        assert not {"flipped [%]", "folded", "unfolded"} & set(heading)


def test_a_study_names_the_runs_that_doubt_their_results() -> None:
    def measure_run(found: bool) -> dict[str, dict[str, dict[str, Any]]]:
        return {"methods": {"deepgps": {"fold": {"found": found}}}}

    rows = [{"run": name, "seed": seed} for seed, name in enumerate("abc")]
    said = describe_doubts({"a": measure_run(False), "b": measure_run(True), "c": measure_run(False)}, rows, ["seed"])
    assert "theirs: 1 of 3." in said and "`b` (seed 1): Not converged: DeepGPS (the map is folded)." in said
    assert "none of 1" in describe_doubts({"a": measure_run(False)}, rows, ["seed"])
