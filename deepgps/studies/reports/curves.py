"""The report "curves": errors of every method along a numeric axis, with a panel for each case and a band of seeds."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib import ticker
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Picture

from deepgps.config.methods import colour_of, title_of
from deepgps.reports.plots import count_by_decades, draw_band
from deepgps.reports.targets import Figure
from deepgps.studies.reports.columns import (
    ERRORS,
    OF_ACCEPTED,
    TRAIN,
    Column,
    Line,
    explain_accepted,
    form,
    tabulate_lines,
    write_worst,
)
from deepgps.studies.table import Row, mean, split_by, split_by_label, tell_apart, varied_in

TITLES = {"encoder.step_noise": "noise w per gap between readings", "drive.samples": "training images"}
# The paper on DeepGPS: its RMS is below this share of the room's side (Sec. V-A); its RMS at a value [m] (V-B).
PAPER_SHARE = {"encoder.step_noise": 0.02}
PAPER_RMS: dict[str, dict[float, float]] = {"drive.samples": {1000: 0.04}}
KNEE = 1.25
DECADES = 10.0
NOTE = (
    "Errors in centimetres on the test grid for the worst heading of each position: means over seeds, and the RMS of "
    "the worst seed; aligned on training samples, never scaled."
)
COLUMNS = (
    Column("seeds", lambda line: str(len(line.rows))),
    *(Column(title, form(name, ".3g", 100)) for name, title in ERRORS.items()),
    Column("worst RMS", write_worst(spec=".3g")),
    *OF_ACCEPTED,
    Column("RMS / side", form("relative_rms", ".2f", 100, " %")),
    TRAIN,
)


def report(rows: Sequence[Row], varied: Sequence[str]) -> list[str]:
    """A table with a line for each case, method and value of the axis; where the knees are; and a note on the table."""
    axis = find_axis(rows)
    lines = [
        Line((*title, title_of(method), f"{value:g}"), group)
        for title, panel in _split_panels(rows).items()
        for method, curve in split_by(panel, "method").items()
        for value, group in sorted(split_by(curve, axis).items())
    ]
    has_paper = axis in PAPER_SHARE or axis in PAPER_RMS
    paper = [Column("paper's RMS [cm]", lambda line: _write_paper(axis, line.rows[0]))] if has_paper else []
    knees = [
        f"The knee{''.join(f' of {name}' for name in title)}: {axis} {knee:g}, the smallest value from which "
        f"the RMS of DeepGPS (mean over seeds) stays within {KNEE} times that at {max(row[axis] for row in curve):g}."
        for title, curve in _list_ours(rows).items()
        if (knee := find_knee(curve, axis)) is not None
    ]
    table = tabulate_lines([*_name_panels(rows), "method", axis], lines, (*COLUMNS, *paper))
    return [table, *knees, NOTE, *explain_accepted(rows)]


def measure(rows: Sequence[Row]) -> dict[str, Figure]:
    """DeepGPS's errors at the highest value of the axis, as means over seeds in the worst case; and the last knee."""
    rows = [row for row in rows if row["method"] == "deepgps"]
    if not rows:
        return {}
    axis = find_axis(rows)
    last = max(row[axis] for row in rows)
    ends = list(_split_panels([row for row in rows if row[axis] == last]).values())
    where = f"at {axis} {last:g}"
    measures: dict[str, tuple[str, str, Callable[[Row], float]]] = {
        "rms_m": (f"RMS {where}", "cm", lambda row: row["rms_m"]),
        "relative_rms": (f"RMS / side {where}", "%", lambda row: row["relative_rms"]),
        "relative_median": (f"median / side {where}", "%", lambda row: row["median_m"] / row["shorter_side_m"]),
    }
    figures = {}
    for name, (title, unit, take) in measures.items():
        value = max(float(np.mean([take(row) for row in end])) for end in ends)
        figures[name] = Figure(title, value, unit, worst=max(take(row) for end in ends for row in end))
    knees = [knee for curve in _list_ours(rows).values() if (knee := find_knee(curve, axis)) is not None]
    return {**figures, "knee": Figure(f"knee of {axis}", max(knees), "count")} if knees else figures


def draw(rows: Sequence[Row], varied: Sequence[str], folder: Path) -> Picture:
    """Draw every method's RMS (a line, and a band from best to worst seed) and median (dashed) along the axis."""
    axis, panels = find_axis(rows), _split_panels(rows)
    picture = Picture(figsize=(5.4 * len(panels) + 0.4, 4.2), layout="constrained")
    for place, ((title, panel), axes) in enumerate(
        zip(panels.items(), picture.subplots(1, len(panels), squeeze=False)[0], strict=True)
    ):
        for method, curve in split_by(panel, "method").items():
            _draw_method(axes, axis, method, curve)
        _draw_paper(axes, axis, panel)
        _scale(axes, axis, panel)
        axes.set(xlabel=TITLES.get(axis, axis), ylabel="error [cm]" if place == 0 else "", title=", ".join(title))
        axes.grid(alpha=0.25)
    lines = {line.get_label(): line for axes in picture.axes for line in axes.lines}
    picture.legend(handles=list(lines.values()), loc="outside upper center", frameon=False, fontsize=8, ncols=3)
    return picture


def find_axis(rows: Sequence[Row]) -> str:
    """The setting along which curves run: the last one that varies."""
    return varied_in(rows[0])[-1]


def find_knee(curve: Sequence[Row], axis: str) -> float | None:
    """The least value of the axis from which on the RMS (mean over seeds) is at most KNEE times the RMS at the end.

    None if no value exceeds that bound or only the last is within it: a line without a drop, or one that still falls,
    has no knee.
    """
    means = {value: mean(group, "rms_m") for value, group in sorted(split_by(curve, axis).items())}
    end = max(means)
    beyond = [value for value, rms in means.items() if rms > KNEE * means[end]]
    knee = min(value for value in means if value > max(beyond)) if beyond else end
    return knee if knee < end else None


def _list_ours(rows: Sequence[Row]) -> dict[tuple[str, ...], list[Row]]:
    names = _name_panels(rows)
    ours = [row for row in rows if row["method"] == "deepgps"]
    return split_by_label(ours, lambda row: tuple(str(row[name]) for name in names))


def _draw_method(axes: Axes, axis: str, method: str, curve: Sequence[Row]) -> None:
    groups = dict(sorted(split_by(curve, axis).items()))
    values, colour, title = list(groups), colour_of(method), title_of(method)
    seeds = [[100 * row["rms_m"] for row in group] for group in groups.values()]
    draw_band(axes, values, seeds, colour, f"{title}, RMS", marker=4)
    medians = [100 * mean(group, "median_m") for group in groups.values()]
    axes.plot(values, medians, "--", color=colour, linewidth=1, label=f"{title}, median")


def _draw_paper(axes: Axes, axis: str, panel: Sequence[Row]) -> None:
    if share := PAPER_SHARE.get(axis):
        label = f"paper: below {100 * share:g} % of the side"
        axes.axhline(100 * share * panel[0]["shorter_side_m"], color="black", linestyle=":", label=label)
    for index, (value, rms_m) in enumerate(PAPER_RMS.get(axis, {}).items()):
        label = "_" if index else "paper's RMS"
        axes.plot(value, 100 * rms_m, "D", color="black", markerfacecolor="none", label=label)


def _scale(axes: Axes, axis: str, panel: Sequence[Row]) -> None:
    """Use logarithmic scales for numbers that span a decade or more; otherwise errors begin at zero."""
    values, errors = [row[axis] for row in panel], [row[name] for row in panel for name in ("rms_m", "median_m")]
    if _span(values) >= DECADES:
        axes.set_xscale("log")
        axes.set_xticks(sorted(set(values)), [f"{value:g}" for value in sorted(set(values))], fontsize=7.5)
        axes.xaxis.set_minor_locator(ticker.NullLocator())
    if _span(errors) >= DECADES:
        axes.set_yscale("log")
        count_by_decades(axes.yaxis)
    else:
        axes.set_ylim(bottom=0)


def _span(values: Sequence[float]) -> float:
    return max(values) / min(values) if min(values) > 0 else 1.0


def _split_panels(rows: Sequence[Row]) -> Mapping[tuple[str, ...], list[Row]]:
    names = _name_panels(rows)
    return split_by_label(rows, lambda row: tuple(str(row[name]) for name in names))


def _name_panels(rows: Sequence[Row]) -> list[str]:
    return tell_apart(rows, varied_in(rows[0])[:-1])


def _write_paper(axis: str, row: Row) -> str:
    if row["method"] != "deepgps":
        return "-"
    if axis in PAPER_SHARE:
        return f"< {100 * PAPER_SHARE[axis] * row['shorter_side_m']:.3g}"
    rms_m = PAPER_RMS[axis].get(row[axis])
    return "-" if rms_m is None else f"{100 * rms_m:.3g}"
