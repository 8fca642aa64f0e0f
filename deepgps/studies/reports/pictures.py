"""The pictures of reports: dots by case, curves along an axis, points of two columns, and error fields of runs."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import ticker
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from deepgps.config.methods import colour_of, title_of
from deepgps.reports.plots import add_scale, count_by_decades, draw_band, print_error_field
from deepgps.studies.reports.record import Curves, Dots, Fields, Picture, Scatter
from deepgps.studies.reports.render import pick, resolve, take
from deepgps.studies.table import Row, choices, describe, find_methods, mean, split_by, split_by_label

DECADE_RATIO, MAX_LOG_RATIO = 10.0, 1e5
WIDTH = 0.6  # Part of a case's height over which the dots of its methods are spread
POINT_COLOURS = ("#2a6f97", "#d1495b", "#e07b00", "#1a936f", "#7a4fbf", "#4b5563")
LEGEND: Mapping[str, Any] = {"loc": "outside upper center", "frameon": False, "fontsize": 8}
LINES = ("k:", "k--", "k-.", "k-")


def draw(picture: Picture, rows: Sequence[Row], varied: Sequence[str], folder: Path) -> Figure:
    """Draw one of a report's pictures of prepared rows; the folder is the study's."""
    if isinstance(picture, Dots):
        return draw_dots(picture, rows, varied)
    if isinstance(picture, Curves):
        return draw_curves(picture, pick(rows, picture.where))
    if isinstance(picture, Scatter):
        return draw_scatter(picture, pick(rows, picture.where))
    assert isinstance(picture, Fields)
    return draw_fields(picture, rows, varied, folder)


def draw_dots(picture: Dots, rows: Sequence[Row], varied: Sequence[str]) -> Figure:
    """Draw errors by case; see ``Dots``."""
    cases, methods = _label_cases(rows, picture.line, varied), find_methods(rows)
    parts = split_by(rows, picture.panel) if picture.panel else {"": rows}
    panels = [(str(value), mark, some) for (value, some), mark in product(parts.items(), picture.marks)]
    names = list(dict.fromkeys(cases(row) for row in rows))
    side_by_side = "method" not in picture.line.split()
    place = {
        (case, method): line + (WIDTH * ((number + 0.5) / len(methods) - 0.5) if side_by_side else 0.0)
        for line, case in enumerate(names)
        for number, method in enumerate(methods)
    }
    height = 1.6 + (0.16 + 0.05 * len(methods) if side_by_side else 0.3) * len(names)
    figure = Figure(figsize=(3.6 + 4.2 * len(panels), height), layout="constrained")
    axes_of = figure.subplots(1, len(panels), squeeze=False, sharex=True, sharey=True)[0]
    for axes, (title, (kind, filled, hollow), some) in zip(axes_of, panels, strict=True):
        for (case, method), group in split_by_label(some, lambda row: (cases(row), row["method"])).items():
            colour, at = colour_of(method), place[case, method]
            for name, inside in ((filled, colour), (hollow, "white")):
                values = [100 * row[name] for row in group if row.get(name) is not None]
                if len(values) > 1:
                    axes.plot(values, [at] * len(values), "o", color=colour, mfc=inside, alpha=0.4, ms=2.5)
                if values:
                    axes.plot(np.mean(values), at, "o", color=colour, mfc=inside, ms=5, zorder=3)
            if paper := take(group, f"paper_{filled}"):
                axes.plot(100 * paper, at, "D", color=colour, mfc="none", mec="black", ms=6, zorder=2)
            crossed = pick(group, picture.cross) if picture.cross else []
            axes.plot([100 * row[filled] for row in crossed], [at] * len(crossed), "x", color="black", ms=9, zorder=4)
        for method, clean in split_by(pick(some, picture.clean) if picture.clean else [], "method").items():
            for name, style in ((filled, "-"), (hollow, (0, (3, 3)))):
                axes.axvline(100 * mean(clean, name), color=colour_of(method), linestyle=style, lw=1.0, alpha=0.5)
        axes.set_title(", ".join(filter(None, (title, kind))), fontsize=9)
        axes.set(xscale="log", ylim=(len(names) - 0.5, -0.5), xlabel=f"error [cm]; {picture.words}")
        axes.set_yticks(range(len(names)), names, fontsize=8)
        _count(axes.xaxis)
        axes.grid(alpha=0.25, axis="x")
    notes = {"without a fault": Line2D([], [], color="grey")} if picture.clean else {}
    papers = (value for row in rows for name, value in row.items() if name.startswith("paper_"))
    notes |= {"the paper": _mark("black", "D", "none")} if any(value is not None for value in papers) else {}
    notes |= {"wrong": _mark("black", "x")} if picture.cross else {}
    marks = {title_of(name): _mark(colour_of(name)) for name in methods} | notes
    _add_legend(figure, marks)
    return figure


def draw_curves(picture: Curves, rows: Sequence[Row]) -> Figure:
    """Draw curves; see ``Curves``."""
    panels = split_by(rows, picture.panel)
    size = (4.6, 3.6) if len(panels) < 4 else (3.3, 2.9)
    figure, axes_of = _make_panels(len(panels), size, share=picture.even)
    for axes, (title, panel) in zip(axes_of, panels.items(), strict=False):
        values = list(split_by(panel, picture.axis)) if picture.even else sorted(split_by(panel, picture.axis))
        places = list(range(len(values))) if picture.even else values
        for method, curve in split_by(panel, "method").items():
            groups, colour = split_by(curve, picture.axis), colour_of(method)
            have = [(place, groups[value]) for place, value in zip(places, values, strict=True) if value in groups]
            seeds = [[100 * row[picture.of] for row in group] for _, group in have]
            draw_band(axes, [place for place, _ in have], seeds, colour, title_of(method), marker=3)
            for name, words in picture.also.items():
                if all(row.get(name) is not None for row in curve):
                    means, label = [100 * mean(group, name) for _, group in have], f"{title_of(method)}, {words}"
                    axes.plot([place for place, _ in have], means, "--", color=colour, lw=1, label=label)
        for style, (name, label) in zip(LINES, picture.lines.items(), strict=False):
            groups = split_by(panel, picture.axis)
            found = [take(groups[value], name) for value in values]
            points = [(place, 100 * one) for place, one in zip(places, found, strict=True) if one is not None]
            if points:
                axes.plot(*zip(*points, strict=True), style, marker="x", markersize=5, label=label)
        _scale_curves(axes, picture, places, values)
        label = picture.label or title
        axes.set_xlabel(panel[0].get(label, label), fontsize=9)
        axes.set_title(title if picture.label else "", fontsize=9)
    axes_of[0].set_ylabel(picture.unit)
    _add_legend(figure, _find_labels(axes_of))
    return figure


def draw_scatter(picture: Scatter, rows: Sequence[Row]) -> Figure:
    """Draw points; see ``Scatter``."""
    panels = split_by(rows, picture.panel) if picture.panel else {"": rows}
    figure, axes_of = _make_panels(len(panels), (4.2, 3.8))
    kinds = dict(zip(split_by(rows, picture.by), POINT_COLOURS * len(rows), strict=False))
    names = (picture.x, picture.y, *picture.bars)
    for axes, (title, some) in zip(axes_of, panels.items(), strict=False):
        for kind, group in split_by(some, picture.by).items():
            known = [[row[name] for name in names] for row in group if None not in (row[picture.x], row[picture.y])]
            x, y, low, high = picture.factor * np.array(known, float).reshape(-1, 4).T
            ends = [y - low, high - y]
            axes.errorbar(x, y, ends, fmt="o", color=kinds[kind], ms=3.5, lw=0.8, alpha=0.7, label=kind)
        low, high = max(axes.get_xlim()[0], axes.get_ylim()[0]), min(axes.get_xlim()[1], axes.get_ylim()[1])
        axes.plot([low, high], [low, high], color="0.6", lw=1, zorder=0)
        axes.set(xlabel=picture.labels[0], ylabel=picture.labels[1])
        axes.set_title(title, fontsize=9)
        axes.grid(alpha=0.25)
    _add_legend(figure, _find_labels(axes_of))
    return figure


def draw_fields(picture: Fields, rows: Sequence[Row], varied: Sequence[str], folder: Path) -> Figure:
    """Draw error fields; see ``Fields``."""
    groups = split_by_label(rows, _label_cases(rows, picture.by, varied))
    figure, axes_of = _make_panels(len(groups), (4.4, 3.6), most=3)
    for axes, (title, group) in zip(axes_of, groups.items(), strict=False):
        row = sorted(group, key=lambda row: row["rms_m"])[(len(group) - 1) // 2]
        print_error_field(axes, folder / "runs" / row["run"], row["method"], picture.scale_m)
        errors = f"RMS {100 * row['rms_m']:.3g} cm, median {100 * row['median_m']:.3g} cm"
        axes.set_title(f"{title}\n{errors}", fontsize=9)
    add_scale(figure, axes_of, picture.scale_m)
    return figure


def _make_panels(
    count: int, size: tuple[float, float], most: int = 4, share: bool = False
) -> tuple[Figure, list[Axes]]:
    columns = max(1, min(most, count))
    lines = max(1, -(-count // columns))
    figure = Figure(figsize=(size[0] * columns + 0.6, size[1] * lines + 0.8), layout="constrained")
    panels = list(figure.subplots(lines, columns, squeeze=False, sharey=share).flat)
    for axes in panels[count:]:
        axes.set_axis_off()
    return figure, panels


def _add_legend(figure: Figure, marks: Mapping[str, Any]) -> None:
    columns = max(2, int(figure.get_figwidth() / 2.2))
    figure.legend(list(marks.values()), list(marks), ncols=min(columns, 6), **LEGEND)


def _find_labels(panels: Iterable[Axes]) -> dict[str, Any]:
    """What each label of some panels stands for, once."""
    found = [pair for axes in panels for pair in zip(*axes.get_legend_handles_labels(), strict=True)]
    return {label: handle for handle, label in found}


def _scale_curves(axes: Axes, picture: Curves, places: Sequence[float], values: Sequence[float]) -> None:
    """Use logarithmic scales for numbers that span a decade or more; otherwise values begin at zero."""
    if picture.even or _spans_decade(values):
        axes.set_xscale("linear" if picture.even else "log")
        axes.set_xticks(places, [f"{one:g}" if isinstance(one, int | float) else one for one in values], fontsize=7.5)
        axes.xaxis.set_minor_locator(ticker.NullLocator())
    drawn = np.concatenate([np.asarray(line.get_ydata(), float) for line in axes.lines])
    if picture.unit.endswith("[%]"):
        axes.set_ylim(0, 100)
    elif _spans_decade(drawn.tolist()):
        axes.set_yscale("log")
        _count(axes.yaxis)
    else:
        axes.set_ylim(bottom=0)
    axes.grid(alpha=0.25)


def _count(axis: Axis) -> None:
    """Label a logarithmic axis with 1, 2, 5, 10, or with decades if it spans many."""
    low, high = axis.get_view_interval()
    if high < MAX_LOG_RATIO * low:
        count_by_decades(axis)
    else:
        axis.set_major_formatter(ticker.FormatStrFormatter("%g"))
        axis.set_minor_formatter(ticker.NullFormatter())


def _spans_decade(values: Sequence[float]) -> bool:
    return min(values) > 0 and max(values) / min(values) >= DECADE_RATIO


def _label_cases(rows: Sequence[Row], by: str, varied: Sequence[str]) -> Callable[[Row], str]:
    """What names the case of a row: the fewest of these columns that tell all cases apart."""
    others = [name for name in resolve(by, varied) if name != "method"]
    names = [*choices(rows, others), *(["method"] if "method" in by.split() else [])]
    return lambda row: describe(row, names)


def _mark(colour: str, marker: str = "o", inside: str | None = None) -> Line2D:
    return Line2D([], [], color=colour, marker=marker, ls="", mfc=inside or colour)
