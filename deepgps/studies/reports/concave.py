"""The report "concave": errors by how much of the room a straight drive reaches, the limit that the paper names."""

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib.colors import Normalize
from matplotlib.figure import Figure as Picture

from deepgps.config.methods import colour_of, title_of
from deepgps.evaluation.error_field import find_rms, read_fields
from deepgps.evaluation.visibility import measure_visible
from deepgps.reports.field_plot import add_scale, print_error_field
from deepgps.reports.style import count_by_decades
from deepgps.reports.table import tabulate
from deepgps.reports.targets import Figure, write
from deepgps.studies.grouping import group_rows
from deepgps.studies.reports.compare import report as compare_choices
from deepgps.studies.table import Row, find_methods
from sim.recording.format import open_truth

SHAPE = "room.shape"
EDGES = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 1.0)
"""Edges of the bins of reach, as shares of the floor, into which positions are sorted."""
LITTLE = 2
"""Number of leading bins that count as reaching little of the room."""
NOTE = (
    "Reach: share of the accessible floor that the robot can reach from a position by one straight drive. Positions "
    "of all rooms are pooled; errors are for the worst heading. PoseNet learns from true positions, so errors that "
    "both methods make are not due to a lack of straight paths."
)


def report(rows: Sequence[Row], varied: Sequence[str]) -> list[str]:
    """A table with a line for each shape and method, then one with a line for each bin of reach."""
    methods = find_methods(rows)
    headings = ["reach", "positions", *(f"{title_of(name)}, RMS [cm]" for name in methods)]
    headings += [f"{title_of(name)}, median [cm]" for name in methods]
    cells = []
    for part, (low, high) in enumerate(pairwise(EDGES)):
        errors = [pool([row for row in rows if row["method"] == name], [part]) for name in methods]
        if not len(errors[0]):
            continue
        figures = [*map(find_rms, errors), *map(np.median, errors)]
        count = str(len(errors[0]))
        cells.append([f"{100 * low:.0f}-{100 * high:.0f} %", count, *(f"{100 * one:.1f}" for one in figures)])
    return [*compare_choices(rows, varied), tabulate(headings, cells), NOTE]


def measure(rows: Sequence[Row]) -> dict[str, Figure]:
    """How much larger each method's RMS is where little is reached than elsewhere, and in two rooms than in one."""
    figures = {}
    for (method,), group in group_rows(rows, []).items():
        little, rest = pool(group, range(LITTLE)), pool(group, range(LITTLE, len(EDGES) - 1))
        title = f"{title_of(method)}, RMS where reach is below {write(EDGES[LITTLE], '%')} / elsewhere"
        ratio = find_rms(little) / find_rms(rest) if len(little) and len(rest) else None
        figures[f"{method}_little"] = Figure(title, ratio, "")
        shapes = {
            key[0]: find_rms(pool(some, range(len(EDGES) - 1))) for key, some in group_rows(group, [SHAPE]).items()
        }
        if {"two_rooms", "rectangle"} <= set(shapes):
            title = f"{title_of(method)}, RMS in two rooms / in a rectangle"
            figures[f"{method}_two_rooms"] = Figure(title, shapes["two_rooms"] / shapes["rectangle"], "")
    return figures


def add_reach(run: Path, row: Row) -> Row:
    """A column for each bin of reach: the errors of all its positions [m]."""
    field = read_fields(run)[row["method"]]
    part = np.digitize(measure_visible(open_truth(run / "recording").free_space, field.truth), EDGES[1:-1])
    return {f"errors_{number}_m": field.error[part == number].astype(np.float32) for number in range(len(EDGES) - 1)}


def pool(rows: Sequence[Row], parts: Sequence[int]) -> np.ndarray:
    """Errors (n,) [m] of all positions of these rows in these bins of reach."""
    return np.concatenate([np.asarray(row[f"errors_{part}_m"], float) for row in rows for part in parts])


def draw(rows: Sequence[Row], varied: Sequence[str], folder: Path) -> Picture:
    """Draw RMS (filled) and median (open) by how much of the floor is reached."""
    middles = [50 * (low + high) for low, high in pairwise(EDGES)]
    picture = Picture(figsize=(6.4, 3.8), layout="constrained")
    axes = picture.add_subplot()
    for (method,), group in group_rows(rows, []).items():
        errors = {middle: pool(group, [part]) for part, middle in enumerate(middles)}
        there = {middle: error for middle, error in errors.items() if len(error)}
        colour, title = colour_of(method), title_of(method)
        rms, median = ([100 * take(error) for error in there.values()] for take in (find_rms, np.median))
        axes.plot(list(there), rms, "o-", color=colour, label=f"{title}, RMS")
        axes.plot(list(there), median, "o--", color=colour, mfc="none", label=f"{title}, median")
    axes.set(yscale="log", xlim=(0, 100), ylabel="error of the worst heading [cm]")
    axes.set_xlabel("share of the floor reached by straight drives [%]")
    count_by_decades(axes.yaxis)
    axes.grid(alpha=0.25, which="both")
    axes.legend(frameon=False, fontsize=8)
    return picture


def draw_rooms(rows: Sequence[Row], varied: Sequence[str], folder: Path) -> Picture:
    """Draw a room of each shape: how much of it each position reaches, and DeepGPS's error there."""
    rows = [row for row in rows if row["method"] == "deepgps"]
    shapes = {key[0]: group[0] for key, group in group_rows(rows, [SHAPE]).items()}
    picture = Picture(figsize=(9.6, 2.9 * len(shapes) + 0.2), layout="constrained")
    panels = picture.subplots(len(shapes), 2, squeeze=False, sharex=True, sharey=True)
    dots = None
    for (left, right), (shape, row) in zip(panels, shapes.items(), strict=True):
        run = folder / "runs" / row["run"]
        field = print_error_field(right, run, "deepgps")
        right.set_title(f"{shape}: RMS {100 * row['rms_m']:.1f} cm", fontsize=9)
        visible = measure_visible(open_truth(run / "recording").free_space, field.truth)
        dots = left.scatter(*field.truth.T, s=6, c=100 * visible, norm=Normalize(0, 100), cmap="viridis", linewidths=0)
        left.set_title(f"{shape}: reach", fontsize=9)
        left.set(aspect="equal", ylabel="y [m]")
    if dots is not None:
        picture.colorbar(
            dots, ax=list(panels[:, 0]), shrink=0.5, label="share of the floor reached [%]", location="left"
        )
    add_scale(picture, list(panels[:, 1]))
    return picture
