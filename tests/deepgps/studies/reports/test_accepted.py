"""Columns of what a method accepts, in every report that shows errors; tables from before that read as they did."""

import numpy as np
import pytest

from deepgps.studies.catalog import REPORTS
from deepgps.studies.reports import compare, curves, plain, rooms
from deepgps.studies.reports.report import varied_names
from deepgps.studies.study import load_study
from deepgps.studies.table import ACCEPTED, Row, read_rows
from sim.paths import STUDIES

REPORTS_OF = {"precision": rooms.report, "strategies": compare.report, "samples": curves.report, "seeds": plain.report}


def read_published(study: str) -> tuple[list[Row], list[str]]:
    """The rows of a published table as they were before methods refused images, and the names that vary."""
    rows = read_rows(STUDIES.parents[1] / "docs" / "results" / study / "table.parquet")
    later = (*ACCEPTED, "radius_68_holds", "radius_95_holds")
    known = [{name: value for name, value in row.items() if name not in later} for row in rows]
    return known, varied_names(load_study(study, tiny=False))


def accept(rows: list[Row]) -> list[Row]:
    """The same rows with half the RMS, a third of the maximum and 98 % of the images accepted."""
    return [
        {**row, "rms_accepted_m": row["rms_m"] / 2, "max_accepted_m": row["max_m"] / 3, "accepted": 0.98}
        for row in rows
    ]


def split_cells(table: str) -> list[list[str]]:
    return [[cell.strip() for cell in line.split("|")[1:-1]] for line in table.splitlines()]


@pytest.mark.parametrize("study", REPORTS_OF)
def test_a_table_gains_columns_and_changes_no_other(study: str) -> None:
    rows, varied = read_published(study)
    before, after = (split_cells(REPORTS_OF[study](some, varied)[0]) for some in (rows, accept(rows)))
    new = [after[0].index(heading) for heading in ACCEPTED.values()]
    assert [[cell for place, cell in enumerate(line) if place not in new] for line in after[2:]] == before[2:]
    rms = after[0].index("RMS [cm]")
    for line in after[2:]:
        assert float(line[new[0]]) == pytest.approx(float(line[rms]) / 2, abs=0.06, rel=0.01)
        assert line[new[2]] == "98.0 %"


def test_methods_that_accept_all_have_a_dash() -> None:
    rows, varied = read_published("precision")
    told = [row if row["method"] == "posenet" else one for row, one in zip(rows, accept(rows), strict=True)]
    table = split_cells(rooms.report(told, varied)[0])
    place = table[0].index("accepted")
    assert {line[place] for line in table[2:] if line[1] == "PoseNet"} == {"-"}
    assert {line[place] for line in table[2:] if line[1] == "DeepGPS"} == {"98.0 %"}


def test_targets_of_what_is_accepted_are_medians_over_rooms() -> None:
    rows = [row for row in accept(read_published("precision")[0]) if row["method"] == "deepgps"]
    figures = rooms.measure(rows)
    assert set(figures) <= set(REPORTS["rooms"].targets)
    for name, source, share in (("rms_accepted_m", "rms_m", 2), ("max_accepted_m", "max_m", 3)):
        errors = np.array([row[source] for row in rows]) / share
        assert figures[name].value == pytest.approx(np.median(errors))
        assert figures[name].worst == pytest.approx(errors.max())
    assert not {name for name in rooms.measure([{**row, "rms_accepted_m": None} for row in rows]) if "rms_acc" in name}


def test_how_often_radii_hold_is_a_median_over_the_rooms_that_have_radii() -> None:
    rows = [row for row in read_published("precision")[0] if row["method"] == "deepgps"]
    held = [0.5 + 0.01 * number for number in range(len(rows))]
    told = [{**row, "radius_68_holds": share} for row, share in zip(rows, held, strict=True)]
    told[-1]["radius_68_holds"] = None
    figures = rooms.measure(told)
    assert figures["radius_68_holds"].value == pytest.approx(np.median(held[:-1]))
    assert figures["radius_68_holds"].worst == held[0]
    assert "radius_95_holds" not in figures
