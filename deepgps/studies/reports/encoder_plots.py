"""Figures of encoders: errors as each fault grows, and the part of test positions with small errors."""

from collections.abc import Callable, Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure as Picture

from deepgps.config.methods import colour_of, title_of
from deepgps.reports.style import count_by_decades, draw_band
from deepgps.studies.reports.encoder import EXPECTED, NEAR_M, PART, name_part
from deepgps.studies.reports.encoder_sweeps import Sweep, find_sweeps
from deepgps.studies.table import Row, find_methods, mean


def draw(rows: Sequence[Row], varied: Sequence[str], folder: Path) -> Picture:
    """Draw a panel for each fault: every method's RMS with a band of seeds, and segment errors next to theory's."""
    return _draw_panels(rows, _draw_errors, "error [cm]")


def draw_near(rows: Sequence[Row], varied: Sequence[str], folder: Path) -> Picture:
    """Draw a panel for each fault: the part of the test positions with small errors, with a band of seeds."""
    return _draw_panels(rows, _draw_near, f"positions within {100 * NEAR_M[0]:g} cm [%]")


def _draw_panels(rows: Sequence[Row], draw_one: Callable[[Axes, Sweep], None], ylabel: str) -> Picture:
    sweeps = find_sweeps(rows)
    columns = min(4, max(1, len(sweeps)))
    lines = max(1, -(-len(sweeps) // columns))
    picture = Picture(figsize=(3.3 * columns + 0.3, 2.9 * lines + 0.8), layout="constrained")
    panels = list(picture.subplots(lines, columns, squeeze=False, sharey=True).flat)
    for axes, sweep in zip(panels, sweeps, strict=False):
        draw_one(axes, sweep)
        axes.set_xlabel(sweep.title)
        axes.grid(alpha=0.25)
    for axes in panels[len(sweeps) :]:
        axes.set_axis_off()
    for axes in panels[::columns]:
        axes.set_ylabel(ylabel)
    named = {line.get_label(): line for axes in panels for line in axes.lines}
    picture.legend(list(named.values()), list(named), loc="outside upper center", frameon=False, fontsize=8, ncols=4)
    return picture


def _draw_errors(axes: Axes, sweep: Sweep) -> None:
    _draw_methods(axes, sweep, "rms_m")
    groups = sweep.by_value(find_methods(sweep.rows)[0])
    for name, style, label in (
        ("segment_expected_m", "k:", "one segment, theory"),
        ("segment_rms_m", "kx", "one segment, measured"),
    ):
        values = [100 * mean(group, name) for group in groups.values()]
        axes.plot(range(len(groups)), values, style, markersize=5, label=label)
    for method in find_methods(sweep.rows):
        groups = sweep.by_value(method)
        if all(row.get(EXPECTED) is not None for group in groups.values() for row in group):
            values = [100 * mean(group, EXPECTED) for group in groups.values()]
            label = f"{title_of(method)}: expected by its map"
            axes.plot(range(len(groups)), values, ":", color=colour_of(method), label=label)
    axes.set_yscale("log")
    count_by_decades(axes.yaxis)


def _draw_near(axes: Axes, sweep: Sweep) -> None:
    _draw_methods(axes, sweep, name_part(NEAR_M[0]))
    axes.axhline(100 * PART, color="k", linestyle=":", label="good enough")
    axes.set_ylim(0, 100)


def _draw_methods(axes: Axes, sweep: Sweep, name: str) -> None:
    """Draw each method's mean over seeds, times 100, and a band from the least to the greatest."""
    for method in find_methods(sweep.rows):
        groups, colour = sweep.by_value(method), colour_of(method)
        seeds = [[100 * row[name] for row in group] for group in groups.values()]
        place = range(len(groups))
        draw_band(axes, place, seeds, colour, title_of(method), marker=3)
        # evenly spaced: some faults grow by factors and others by steps
        axes.set_xticks(place, [f"{value:g}" for value in groups], fontsize=8)
