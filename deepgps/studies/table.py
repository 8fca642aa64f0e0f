"""A study's table: one row for each run and method, read from the runs' own files."""

from collections.abc import Iterable, Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from deepgps.config.scenario import Scenario
from deepgps.reports.run_report import read_metrics
from deepgps.studies.plan import Plan
from sim.files.atomic import write_bytes
from sim.files.checksums import drop_sum, write_sum
from sim.renamed import translate_row

Row = dict[str, Any]
# figures of a method, by their names in metrics.json
FIGURES = (
    *("rms_m", "median_m", "p75_m", "p95_m", "max_m", "relative_rms", "heading_spread_m"),
    *("yaw_rms_deg", "yaw_median_deg", "yaw_p95_deg", "yaw_rms_accepted_deg"),
    *("scale", "misplaced", "flipped", "alignment", "steps", "train_s", "parameters", "attempts"),
    *("accepted", "accepted_places", "rms_accepted_m", "median_accepted_m", "p95_accepted_m", "max_accepted_m"),
    *("auroc_10cm", "aurc_m", "radius_68_holds", "radius_95_holds", "radius_68_median_m"),
)
# figures of a map by compass
MAP_FIGURES = ("rms_m", "expected_rms_m", "nees", "flipped_m2")
# the errors in the paper's tables
PAPERS_ERRORS = {"rms_m": "RMS", "median_m": "median", "max_m": "max"}
# the errors that every report shows, with their headings
ERRORS = {"rms_m": "RMS [cm]", "median_m": "median [cm]", "p95_m": "p95 [cm]", "max_m": "max [cm]"}
# the errors of what a method accepts, and the share of images that it accepts; older tables have none
ACCEPTED = {
    "rms_accepted_m": "RMS of accepted [cm]",
    "max_accepted_m": "max of accepted [cm]",
    "accepted": "accepted",
}
LEVELS = (68, 95)
"""Probabilities with which the radii of images hold the true position [%]."""
ACCEPTED_NOTE = (
    "Accepted: share of the images. A position is among the accepted where any of its headings is, with the error of "
    "the worst of these."
)


def gather(plans: Sequence[Plan], failures: Mapping[str, str], folder: Path) -> list[Row]:
    """Rows of all runs of a study in order, including failed runs; each row has every column.

    Args:
        plans: The runs.
        failures: Reasons why runs failed, by the hash of the run.
        folder: The study's folder.
    """
    names = dict.fromkeys(name for plan in plans for name in plan.varied)
    # settings that only some cases set come first, axes last
    varied = sorted(names, key=lambda name: all(name in plan.varied for plan in plans))
    return [row for plan in plans for row in _rows(plan, varied, failures.get(plan.run), folder)]


def varied_in(row: Row) -> list[str]:
    """Names of the settings that vary in a study, from one of its rows; axes come last."""
    names = list(row)
    return names[names.index("seed") + 1 : names.index("samples")]


def tell_apart(rows: Sequence[Row], names: Sequence[str]) -> list[str]:
    """The fewest leading settings that tell all cases apart; the scenario, which says most, comes first."""
    names = sorted(names, key=lambda name: name != "scenario")
    cases = [len({tuple(row[name] for name in names[:count]) for row in rows}) for count in range(len(names) + 1)]
    return names[: cases.index(cases[-1])]


def write_table(path: Path, rows: Sequence[Row]) -> None:
    """Write rows as a Parquet file."""
    table = pa.table({name: [row[name] for row in rows] for name in rows[0]})
    buffer = BytesIO()
    pq.write_table(table, buffer)
    drop_sum(path)
    write_bytes(path, buffer.getvalue())
    write_sum(path)


def read_rows(path: Path) -> list[Row]:
    """Read a table that ``write_table`` wrote, possibly before settings and methods were renamed."""
    return [translate_row(row) for row in pq.read_table(path).to_pylist()]


def split_by(rows: Sequence[Row], name: str) -> dict[Any, list[Row]]:
    """Rows by the values of one column, in the order of their first occurrence."""
    return {value: [row for row in rows if row[name] == value] for value in dict.fromkeys(row[name] for row in rows)}


def find_methods(rows: Iterable[Row]) -> list[str]:
    """The methods of these rows, in the study's order."""
    return list(dict.fromkeys(row["method"] for row in rows))


def is_seed(name: str) -> bool:
    """Whether a setting is the seed of a run or of a room, which varies only to repeat runs."""
    return name.rpartition(".")[2] == "seed"


def mean(rows: Sequence[Row], name: str) -> float:
    """Mean of one column."""
    return float(np.mean([row[name] for row in rows]))


def write_errors(row: Mapping[str, Any]) -> list[str]:
    """The figures of ``ERRORS`` in centimetres."""
    return [f"{100 * row[name]:.1f}" for name in ERRORS]


def write_ratio(name: str, rows: Sequence[Row], usual: Sequence[Row]) -> str:
    """The mean of an error in centimetres and, in brackets, over that of the usual rows, if there are any."""
    value = f"{100 * mean(rows, name):.1f}"
    return f"{value} ({mean(rows, name) / mean(usual, name):.2f})" if usual else value


def choose_accepted(rows: Sequence[Row]) -> dict[str, str]:
    """The headings of ``ACCEPTED``; none if no method in these rows refuses images."""
    return ACCEPTED if any(row.get("accepted") is not None for row in rows) else {}


def write_accepted(rows: Sequence[Mapping[str, Any]], columns: Iterable[str]) -> list[str]:
    """The means over rows of some columns of ``ACCEPTED``: shares in per cent, errors in centimetres; a dash: none."""
    known = ([row[name] for row in rows if row.get(name) is not None] for name in columns)
    means = (100 * float(np.mean(values)) if values else None for values in known)
    return [
        "-" if value is None else f"{value:.1f} %" if name == "accepted" else f"{value:.1f}"
        for name, value in zip(columns, means, strict=True)
    ]


def read_setting(scenario: Scenario, dotted: str) -> Any:
    """Read a setting by its dotted name, as a table column stores it; a group of settings becomes text."""
    if dotted == "scenario":
        return scenario.name
    value: Any = scenario
    for part in dotted.split("."):
        if isinstance(value, Mapping):  # the strengths of plugins' faults; those that are off are left out
            return value.get(part, 0.0)
        value = getattr(value, part)
    return value if value is None or isinstance(value, bool | int | float | str) else str(value)


def _rows(plan: Plan, varied: Sequence[str], failure: str | None, folder: Path) -> list[Row]:
    metrics = {} if failure else read_metrics(folder / "runs" / plan.run)
    coverage = metrics.get("coverage")
    head = {
        "run": plan.run,
        "recording": plan.recording,
        "seed": plan.scenario.seed,
        **{name: read_setting(plan.scenario, name) for name in varied},
        "samples": metrics.get("samples"),
        "segments": metrics.get("segments"),
        "distance_m": metrics.get("distance_driven_m"),
        "shorter_side_m": metrics.get("shorter_side_m"),
        "seen": coverage and coverage["cells_seen"] / max(coverage["reachable_cells"], 1),
    }
    return [
        {**head, "method": method, **_figures(metrics.get("methods", {}).get(method, {})), "failure": failure}
        for method in plan.scenario.methods
    ]


def _figures(measured: Mapping[str, Any]) -> Row:
    # only methods whose map can fold have a fold detector
    fold = measured.get("fold", {})
    score = {name: fold.get(name) for name in ("length_error_fraction", "overlap_fraction")}
    found = {f"map_{name}": measured.get("map", {}).get(name) for name in MAP_FIGURES}
    signs = {"undecided": measured.get("undecided"), "turned": measured.get("turned", {}).get("share")}
    return {
        **{name: measured.get(name) for name in FIGURES},
        "fold_found": fold.get("found"),
        **score,
        **signs,
        **found,
    }
