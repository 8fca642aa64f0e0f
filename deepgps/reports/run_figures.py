"""A run's figures as PNG: error fields, comparison, error distribution, drive."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import ticker
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

from deepgps.config.methods import METHODS, colour_of, title_of
from deepgps.evaluation.error_field import ErrorField, find_rms, read_all_headings, split_by_acceptance
from deepgps.reports.plots import add_scale, draw_field, draw_room, explain_refused, to_png
from deepgps.reports.run_report import read_metrics
from sim.files.atomic import write_bytes
from sim.files.checksums import read_arrays
from sim.geometry import FreeSpace, limits
from sim.recording.format import Truth, open_recording, open_truth

NOTE_IN = 0.4  # Height of the note below error fields [inch]
MAX_ASPECT = 4.0  # Largest height of a figure's floor over its width; matplotlib draws no picture of 65,536 px
DRIVE_COLOURS = LinearSegmentedColormap.from_list("drive", ["#3f78ff", "#c86bff", "#ff8a5c", "#ffe36e"])


def draw_figures(run: Path) -> list[Path]:
    """Draw every figure of a run into ``<run>/figures``; raises InputError if the folder holds no complete run."""
    figures = make_figures(run)
    paths = [run / "figures" / f"{name}.png" for name in figures]
    for path, figure in zip(paths, figures.values(), strict=True):
        write_bytes(path, to_png(figure))
    return paths


def make_figures(run: Path) -> dict[str, Figure]:
    """Every figure of a run by its name."""
    metrics, fields = read_metrics(run), read_all_headings(run)
    truth, recording = open_truth(run / "recording"), open_recording(run / "recording")
    space = truth.free_space
    figures = {"error_fields": draw_comparison(space, fields, metrics)}
    figures["error_cdf"] = draw_error_cdf(fields)
    figures["drive"] = draw_drive(truth, recording.reading, recording.manifest.distance_driven_m)
    return figures


def read_histories(run: Path) -> dict[str, dict[str, np.ndarray]]:
    """Read each method's history.npz; methods that are not trained step by step have none."""
    histories = {path.parent.name: read_arrays(path) for path in run.glob("*/history.npz")}
    return {name: histories[name] for name in sorted(histories, key=_rank)}


def draw_comparison(space: FreeSpace, fields: Mapping[str, ErrorField], metrics: Mapping[str, Any]) -> Figure:
    """The methods' error fields side by side on one scale."""
    columns = 1 if len(fields) == 1 else 2
    rows = -(-len(fields) // columns)
    aspect, width = _aspect(space), 6.4 * columns
    figure = Figure(figsize=(width + 0.9, rows * (5.75 * aspect + 0.45) + 0.85 + NOTE_IN), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    for axes, (name, field) in zip(grid.flat, fields.items(), strict=False):
        draw_field(axes, space, field)
        axes.set_title(title_of(name), fontsize=13, fontweight="bold", loc="left")
        axes.set_title(_summary(field), fontsize=10.5, loc="right", color="#444444")
        axes.label_outer()
    for axes in list(grid.flat)[len(fields) :]:
        axes.set_axis_off()
    add_scale(figure, list(grid.flat))
    explain_refused(figure, fields.values())
    figure.suptitle(
        f"Predicted positions of each method: {metrics['scenario']}, seed {metrics['seed']}, "
        f"{metrics['samples']} observations",
        fontsize=14,
    )
    return figure


def draw_error_cdf(fields: Mapping[str, ErrorField], *before: Mapping[str, ErrorField]) -> Figure:
    """Plot the share of test positions whose error is at most a given value, dashed for another run before."""
    figure = Figure(figsize=(7.5, 4.6), layout="constrained")
    axes = figure.add_subplot()
    for some, changes in ((fields, {}), *((one, {"linestyle": "--", "label": None}) for one in before)):
        for name, field in some.items():
            share = np.arange(1, len(field.worst) + 1) / len(field.worst)
            axes.step(100 * np.sort(field.worst), 100 * share, where="post", **_line(name) | changes)
    axes.set_xscale("log")
    axes.set(xlabel="error of the worst heading [cm]", ylabel="test positions [%]", ylim=(0, 100))
    axes.xaxis.set_major_formatter(ticker.FormatStrFormatter("%g"))
    axes.axhline(50, color="#999999", linewidth=0.8, linestyle=":")
    axes.set_title("Distribution of errors", fontsize=13)
    _finish_plot(axes)
    return figure


def draw_drive(truth: Truth, reading: np.ndarray, driven_m: float | None = None) -> Figure:
    """Plot the driven path of readings (R, 4) over the free space, coloured from its start to its end.

    The distance is that of the recording [m], or the length of what is drawn.
    """
    space = truth.free_space
    figure = Figure(figsize=(9, 7.4 * _aspect(space) + 1.0), layout="constrained")
    axes = figure.add_subplot()
    draw_room(axes, space)
    segment, observation = reading[:, 0], reading[:, 1]
    joined = segment[1:] == segment[:-1]
    place = truth.pose[:, :2][observation]
    pieces = np.stack([place[:-1], place[1:]], axis=1)[joined]
    lines = LineCollection(list(pieces), cmap=DRIVE_COLOURS, linewidths=0.8, alpha=0.8)
    lines.set_array(np.arange(len(pieces)))
    axes.add_collection(lines)
    start = truth.pose[0, :2]
    axes.plot(*start, "o", color="white", markersize=7, markeredgecolor="black")
    axes.annotate("start", (start[0], start[1]), xytext=(7, 6), textcoords="offset points", color="white", fontsize=10)
    length = driven_m or np.linalg.norm(pieces[:, 1] - pieces[:, 0], axis=1).sum()
    count = len(np.unique(segment))
    axes.set_title(f"The drive: {len(truth.pose)} observations, {count} straight segments, {length:.0f} m", fontsize=13)
    bar = figure.colorbar(lines, ax=axes, shrink=0.8, pad=0.02, ticks=[0, max(len(pieces) - 1, 1)])
    bar.ax.set_yticklabels(["start", "end"])
    return figure


def _aspect(space: FreeSpace) -> float:
    low, high = limits(space)
    return min((high[1] - low[1]) / (high[0] - low[0]), MAX_ASPECT)


def _summary(field: ErrorField) -> str:
    rms, accepted = f"RMS {100 * find_rms(field.worst):.1f} cm", split_by_acceptance(field)[0].error
    if field.accepted is None or not len(accepted):
        return f"{rms}, median {100 * np.median(field.worst):.1f} cm"
    return f"{rms}; {100 * field.accepted.mean():.1f} % accepted: {100 * find_rms(accepted):.1f} cm"


def _line(name: str) -> dict[str, Any]:
    return {"color": colour_of(name), "label": title_of(name), "linewidth": 1.8}


def _finish_plot(axes: Axes) -> None:
    axes.grid(alpha=0.25, which="both")
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False)


def _rank(name: str) -> tuple[int, str]:
    names = list(METHODS)
    return (names.index(name) if name in names else len(names), name)
