"""A study's table: one row for each run and method, read from the runs' own files."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from deepgps.config.methods import title_of
from deepgps.config.scenario import Scenario
from sim.files.atomic import write_bytes
from sim.files.checksums import drop_sum, write_sum

Row = dict[str, Any]
CASE = "case"  # Column, and key in a study's case, of the name that the user gives the case
Point = dict[str, Any]  # Settings of a run by dotted name
# figures of a method, by their names in metrics.json
FIGURES = (
    *("rms_m", "median_m", "p75_m", "p95_m", "max_m", "relative_rms", "heading_spread_m"),
    *("yaw_rms_deg", "yaw_median_deg", "yaw_p95_deg", "yaw_rms_accepted_deg"),
    *("scale", "misplaced", "flipped", "alignment", "steps", "train_s", "parameters", "attempts"),
    *("accepted", "accepted_places", "rms_accepted_m", "median_accepted_m", "p95_accepted_m", "max_accepted_m"),
    *("radius_68_holds", "radius_95_holds", "radius_68_median_m"),
)
# figures of a map by compass
MAP_FIGURES = ("rms_m", "expected_rms_m")
LEVELS = (68, 95)  # Probabilities with which the radii of images hold the true position [%]


@dataclass(frozen=True)
class Plan:
    """One run of a study."""

    scenario: Scenario  # The scenario to run
    varied: Mapping[str, Any]  # Settings that distinguish the run from the study's other runs, by dotted name
    run: str  # Hash of everything the run depends on, which names its folder
    recording: str  # Hash of everything the recording depends on, which names its folder


def gather(plans: Sequence[Plan], failures: Mapping[str, str], folder: Path) -> list[Row]:
    """Rows of all runs of a study in order, including runs that failed, by their hash; each row has every column."""
    names = dict.fromkeys(name for plan in plans for name in plan.varied)
    # the name comes first, then settings that only some cases set, axes last
    varied = sorted(names, key=lambda name: (name != CASE, all(name in plan.varied for plan in plans)))
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
    import pyarrow as pa  # here, since a study can be checked without it
    import pyarrow.parquet as pq

    table = pa.table({name: [row[name] for row in rows] for name in rows[0]})
    buffer = BytesIO()
    pq.write_table(table, buffer)
    drop_sum(path)
    write_bytes(path, buffer.getvalue())
    write_sum(path)


def read_rows(path: Path) -> list[Row]:
    """Read a table that ``write_table`` wrote."""
    import pyarrow.parquet as pq

    return pq.read_table(path).to_pylist()


def split_by(rows: Iterable[Row], name: str) -> dict[Any, list[Row]]:
    """Rows by the values of one column, in the order of their first occurrence."""
    return split_by_label(rows, itemgetter(name))


def split_by_label(rows: Iterable[Row], label: Callable[[Row], Any]) -> dict[Any, list[Row]]:
    """Rows by what a function says of them, in the order of their first occurrence."""
    groups: dict[Any, list[Row]] = {}
    for row in rows:
        groups.setdefault(label(row), []).append(row)
    return groups


def choices(rows: Sequence[Row], names: Sequence[str]) -> list[str]:
    """The names that tell cases apart, without those whose values follow from earlier ones."""
    chosen: list[str] = []
    for name in names:
        before, after = (len({tuple(row[one] for one in some) for row in rows}) for some in (chosen, [*chosen, name]))
        if after > before:
            chosen.append(name)
    return chosen


def describe(row: Row, names: Sequence[str]) -> str:
    """Values of a row in words; numbers and flags appear with their names, and flags only where they are set."""
    words = []
    for name, short in zip(names, shorten(names), strict=True):
        value = row[name]
        if name == "method":
            words.append(title_of(value))
        elif isinstance(value, str):
            words.append(value)
        elif value is not None and value is not False:
            words.append(short.replace("_", " ") + ("" if value is True else f" {value:g}"))
    return ", ".join(words) or "all"


def shorten(names: Sequence[str]) -> list[str]:
    """Dotted names without their groups, except for the last group where two names would otherwise be equal."""
    last = [name.rpartition(".")[2] for name in names]
    return [
        short if last.count(short) == 1 else ".".join(name.split(".")[-2:])
        for name, short in zip(names, last, strict=True)
    ]


def find_methods(rows: Iterable[Row]) -> list[str]:
    """The methods of these rows, in the study's order."""
    return list(dict.fromkeys(row["method"] for row in rows))


def is_seed(name: str) -> bool:
    """Whether a setting is the seed of a run or of a room, which varies only to repeat runs."""
    return name.rpartition(".")[2] == "seed"


def mean(rows: Sequence[Row], name: str) -> float:
    """Mean of one column."""
    return float(np.mean([row[name] for row in rows]))


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
    from deepgps.reports.run_report import read_metrics

    metrics = {} if failure else read_metrics(folder / "runs" / plan.run)
    coverage = metrics.get("coverage")
    head = {
        "run": plan.run,
        "recording": plan.recording,
        "seed": plan.scenario.seed,
        **{name: plan.varied.get(CASE) if name == CASE else read_setting(plan.scenario, name) for name in varied},
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
    found = {f"map_{name}": measured.get("map", {}).get(name) for name in MAP_FIGURES}
    signs = {"undecided": measured.get("undecided"), "turned": measured.get("turned", {}).get("share")}
    return {
        **{name: measured.get(name) for name in FIGURES},
        "fold_found": measured.get("fold", {}).get("found"),
        **signs,
        **found,
    }
