"""Comparison of two runs: which settings differ, which figures changed, and where the error grew or fell."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import LinearSegmentedColormap

from deepgps.config.methods import title_of
from deepgps.config.scenario import list_settings
from deepgps.evaluation.error_field import ErrorField, read_all_headings
from deepgps.reports.field_plot import SCALE_M
from deepgps.reports.run_report import COLUMNS, Column, read_metrics
from deepgps.reports.table import tabulate
from deepgps.runs.run_folder import open_run
from sim.errors import InputError
from sim.occupancy import FreeSpace
from sim.recording.format import open_truth

SAME_M = SCALE_M[0]
"""Errors that differ by less than this count as equal [m]."""
# blue: B is better; grey: the same; orange: B is worse
CHANGE = LinearSegmentedColormap.from_list(
    "change",
    [
        *[(0.0, "#3d6bff"), (0.25, "#2fb5ff"), (0.48, "#4a7f99")],
        (0.5, "#59606e"),
        *[(0.52, "#9c7350"), (0.75, "#ffa03c"), (1.0, "#ff4a2e")],
    ],
)
TABLES = (("rms_m", "median_m"), ("p95_m", "max_m"))
"""Figures of each table, few enough for its width."""


@dataclass(frozen=True)
class Side:
    """One run of a pair.

    Attributes:
        folder: The run's folder.
        metrics: The contents of its metrics.json.
        fields: Its error fields by method name.
        space: The free space of its room.
    """

    folder: Path
    metrics: Mapping[str, Any]
    fields: Mapping[str, ErrorField]
    space: FreeSpace


@dataclass(frozen=True)
class Pair:
    """Two runs, A and B.

    Attributes:
        a: The first run.
        b: The second run.
        methods: Methods that both runs have, in the order of the first.
        same_floor: Whether both have the same room and test positions, so that errors can be compared at each position.
    """

    a: Side
    b: Side
    methods: Sequence[str]
    same_floor: bool


def open_pair(folders: Sequence[Path]) -> Pair:
    """Open two runs; raise InputError unless there are exactly two different runs with a method in common."""
    if len(folders) != 2:
        raise InputError(f"exactly two runs can be compared, not {len(folders)}: {', '.join(map(str, folders))}")
    if folders[0].resolve() == folders[1].resolve():
        raise InputError(f"{folders[0]} and {folders[1]} are the same run; choose two different ones")
    a, b = (_open_side(folder) for folder in folders)
    methods = [name for name in a.fields if name in b.fields]
    if not methods:
        names = [", ".join(side.fields) for side in (a, b)]
        raise InputError(f"no method is in both runs: {a.folder} has {names[0]}, {b.folder} has {names[1]}")
    places = (a.fields[methods[0]].truth, b.fields[methods[0]].truth)
    same = np.array_equal(*places) and np.array_equal(a.space.reachable, b.space.reachable)
    return Pair(a, b, methods, same)


def measure_change(pair: Pair, method: str) -> np.ndarray:
    """Error of B minus error of A at each test position (C,) [m]."""
    return pair.b.fields[method].worst - pair.a.fields[method].worst


def scale_change(change: np.ndarray) -> np.ndarray:
    """Scale changes (...,) [m] to [-1, 1]: 0 up to a centimetre, then logarithmic to a metre, as errors are drawn."""
    decades = np.log10(SCALE_M[1] / SAME_M)
    return np.sign(change) * np.clip(np.log10(np.maximum(np.abs(change), SAME_M) / SAME_M) / decades, 0, 1)


def colours_of_change(share: np.ndarray) -> np.ndarray:
    """Colours (..., 4) uint8 RGBA of scaled changes (...,)."""
    return (CHANGE((np.asarray(share) + 1) / 2) * 255).round().astype(np.uint8)


def describe_pair(pair: Pair) -> str:
    """Describe as Markdown both runs, the settings that differ, where which run is better, and both runs' figures."""
    sides = [
        [f"**{letter}**", _name(side.folder), str(side.metrics["scenario"]), str(side.metrics["seed"])]
        for letter, side in (("A", pair.a), ("B", pair.b))
    ]
    return "\n\n".join(
        [
            "# B compared with A",
            tabulate(["", "run", "scenario", "seed"], sides),
            _list_settings(pair),
            _list_places(pair),
            "Errors [cm] for the worst heading of each test position:",
            *(_list_figures(pair, names) for names in TABLES),
        ]
    )


def _open_side(folder: Path) -> Side:
    return Side(folder, read_metrics(folder), read_all_headings(folder), open_truth(folder / "recording").free_space)


def _name(folder: Path) -> str:
    return folder.resolve().name


def _list_places(pair: Pair) -> str:
    if not pair.same_floor:
        return "**The rooms or test positions differ**, so there is no difference of the fields to show."
    rows = []
    for name in pair.methods:
        change = measure_change(pair, name)
        better, worse = int((change < -SAME_M).sum()), int((change > SAME_M).sum())
        rows.append([title_of(name), str(better), str(len(change) - better - worse), str(worse)])
    table = tabulate(["method", "B better", "same", "B worse"], rows)
    return f"Test positions where B is better or worse by more than {100 * SAME_M:g} cm:\n\n{table}"


def _list_figures(pair: Pair, names: Sequence[str]) -> str:
    """A table with a row for each method: figures of A, of B, and their ratio."""
    columns = [column for column in COLUMNS if column[1] in names]
    heads = [name for heading, _, _ in columns for name in (f"{heading.split(' [')[0]} A", "B", "B / A")]
    rows = [
        [title_of(method), *(cell for column in columns for cell in _compare(pair, method, column))]
        for method in pair.methods
    ]
    return tabulate(["method", *heads], rows)


def _compare(pair: Pair, method: str, column: Column) -> list[str]:
    _, name, write = column
    a, b = (side.metrics["methods"].get(method, {}).get(name) for side in (pair.a, pair.b))
    ratio = "-" if not a or b is None else f"{b / a:.2f}"
    return [*("-" if value is None else write(value) for value in (a, b)), ratio]


def _list_settings(pair: Pair) -> str:
    """A table of the settings that differ, without ``methods``, since only common methods are shown."""
    a, b = (list_settings(open_run(side.folder)) for side in (pair.a, pair.b))
    differ = [name for name in a | b if a.get(name) != b.get(name) and name != "methods"]
    if not differ:
        return "Both runs have the same settings."
    rows = [[name, str(a.get(name, "-")), str(b.get(name, "-"))] for name in differ]  # of plugins, one may lack some
    return tabulate(["different setting", "A", "B"], rows)
