"""A run's figures as PNG: error fields, comparison, training, error distribution, drive.

Every picture of an error uses one colour scale, so that two methods, or two runs, can be compared by eye.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from matplotlib import ticker
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap, ListedColormap, LogNorm
from matplotlib.figure import Figure

from deepgps.report import method_title, read_metrics
from sim.errors import InputError
from sim.files import write_bytes
from sim.records import FreeSpace, Truth, open_recording, open_truth

# Logarithmic, since errors of one centimetre and of one metre stand in one picture.
SCALE_M = (0.01, 1.0)
TICKS_M = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
COLOURS = LinearSegmentedColormap.from_list(
    "error", ["#2b5fd9", "#22a7d6", "#3fd0a5", "#c9e265", "#ffc13b", "#ff7a33", "#e8254f"]
)
DRIVE_COLOURS = LinearSegmentedColormap.from_list("drive", ["#3f78ff", "#c86bff", "#ff8a5c", "#ffe36e"])
LINES = {
    "deepgps": "#0b62d6",
    "deepgps_aware": "#00a3b4",
    "deepgps_turns": "#7048e8",
    "posenet": "#e07b00",
    "posenet_noisy": "#b8860b",
    "explicit": "#7a4fbf",
    "explicit_mds": "#4b5563",
    "knn": "#1a936f",
    "pca_knn": "#6b8e23",
    "odometry": "#c2255c",
}
# Where the robot can reach, where it would fit but cannot come to, where it does not fit.
Floor = tuple[str, str, str]
SCREEN: Floor = ("#161a22", "#2c323e", "#4a5261")
PAPER: Floor = ("#ffffff", "#dde1e7", "#b3bac4")
DOTS_PER_INCH = 130


@dataclass(frozen=True)
class WorstField:
    """One method's error field, of each test position the heading that did worst.

    Attributes:
        truth: Test positions (C, 2) [m].
        predicted: Aligned prediction of the heading that did worst at each position (C, 2) [m].
        error: Its distance from the truth (C,) [m].
    """

    truth: np.ndarray
    predicted: np.ndarray
    error: np.ndarray


def draw_figures(run: Path) -> list[Path]:
    """Draw every figure of a run into ``<run>/figures``; raises InputError where the folder is no whole run."""
    figures = make_figures(run)
    paths = [run / "figures" / f"{name}.png" for name in figures]
    for path, figure in zip(paths, figures.values(), strict=True):
        write_bytes(path, to_png(figure))
    return paths


def make_figures(run: Path) -> dict[str, Figure]:
    """Every figure of a run by its name."""
    metrics, fields, histories = read_metrics(run), read_fields(run), read_histories(run)
    truth, recording = open_truth(run / "recording"), open_recording(run / "recording")
    space = truth.free_space
    figures = {f"error_field_{name}": draw_error_field(space, field, name) for name, field in fields.items()}
    figures["error_fields"] = draw_comparison(space, fields, metrics)
    figures["error_cdf"] = draw_error_cdf(fields)
    figures["drive"] = draw_drive(truth, recording.reading)
    if histories:
        figures["training"] = draw_training(histories)
    return figures


def read_fields(run: Path) -> dict[str, WorstField]:
    """Read error_field.npz: of each position the worst heading decides (paper, Sec. V)."""
    path = run / "error_field.npz"
    if not path.is_file():
        raise InputError(f"{run} is no whole run: error_field.npz is missing")
    data = _read_arrays(path)
    missing = {"truth", "heading"} - set(data)
    if missing:
        raise InputError(f"{path} cannot be read: it has no {' and no '.join(sorted(missing))}")
    methods = (name for name in data if name not in {"truth", "heading"})
    return {name: worst_heading(data["truth"], data[name]) for name in methods}


def worst_heading(truth: np.ndarray, predicted: np.ndarray) -> WorstField:
    """The error field of predictions (C, H, 2) [m] at ``truth`` (C, 2) [m]: per position the largest error."""
    error = np.linalg.norm(predicted - truth[:, None], axis=-1)  # (C, H)
    worst = error.argmax(axis=1)
    cells = np.arange(len(truth))
    return WorstField(truth, predicted[cells, worst], error[cells, worst])


def read_histories(run: Path) -> dict[str, dict[str, np.ndarray]]:
    """Read each method's history.npz; methods that were not trained step by step have none."""
    histories = {path.parent.name: _read_arrays(path) for path in run.glob("*/history.npz")}
    return {name: histories[name] for name in sorted(histories, key=_rank)}


def colours_of(error: np.ndarray, scale_m: tuple[float, float] = SCALE_M) -> np.ndarray:
    """Colours (..., 4) uint8 RGBA of errors (...,) [m] on a logarithmic scale."""
    return (COLOURS(LogNorm(*scale_m, clip=True)(np.maximum(error, scale_m[0]))) * 255).round().astype(np.uint8)


def draw_error_field(space: FreeSpace, field: WorstField, name: str) -> Figure:
    """One method's error field over the room."""
    figure = Figure(figsize=(9, 7.4 * _aspect(space) + 1.0), layout="constrained")
    axes = figure.add_subplot()
    _draw_field(axes, space, field)
    axes.set_title(f"{method_title(name)}: {_summary(field)}", fontsize=13)
    add_scale(figure, [axes])
    return figure


def print_error_field(axes: Axes, run: Path, name: str, scale_m: tuple[float, float] = SCALE_M) -> WorstField:
    """Draw one method's error field of a run into these axes, on paper white; ``add_scale`` says what colours mean.

    Args:
        axes: Where; their title is left to the caller.
        run: The run's folder.
        name: The method.
        scale_m: Errors at the ends of the colour scale [m].

    Returns:
        What was drawn.
    """
    field = read_fields(run)[name]
    _draw_field(axes, open_truth(run / "recording").free_space, field, PAPER, scale_m)
    return field


def print_floor(axes: Axes, run: Path) -> None:
    """Draw the floor of a run's room on paper white: grey is where the robot cannot be."""
    _draw_room(axes, open_truth(run / "recording").free_space, PAPER)


def draw_comparison(space: FreeSpace, fields: Mapping[str, WorstField], metrics: Mapping[str, Any]) -> Figure:
    """The methods' error fields side by side on one scale."""
    columns = 1 if len(fields) == 1 else 2
    rows = -(-len(fields) // columns)
    aspect, width = _aspect(space), 6.4 * columns
    figure = Figure(figsize=(width + 0.9, rows * (5.75 * aspect + 0.45) + 0.85), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    for axes, (name, field) in zip(grid.flat, fields.items(), strict=False):
        _draw_field(axes, space, field)
        axes.set_title(method_title(name), fontsize=13, fontweight="bold", loc="left")
        axes.set_title(_summary(field), fontsize=10.5, loc="right", color="#444444")
        axes.label_outer()
    for axes in list(grid.flat)[len(fields) :]:
        axes.set_axis_off()
    add_scale(figure, list(grid.flat))
    figure.suptitle(
        f"Where each method thinks it is: {metrics['scenario']}, seed {metrics['seed']}, "
        f"{metrics['samples']} observations",
        fontsize=14,
    )
    return figure


def draw_error_cdf(fields: Mapping[str, WorstField]) -> Figure:
    """Share of test positions whose error is at most so large."""
    figure = Figure(figsize=(7.5, 4.6), layout="constrained")
    axes = figure.add_subplot()
    for name, field in fields.items():
        share = np.arange(1, len(field.error) + 1) / len(field.error)
        axes.step(np.sort(field.error), 100 * share, where="post", **_line(name))
    axes.set_xscale("log")
    axes.set(xlabel="error of the worst heading [m]", ylabel="test positions [%]", ylim=(0, 100))
    axes.xaxis.set_major_formatter(ticker.FormatStrFormatter("%g"))
    axes.axhline(50, color="#999999", linewidth=0.8, linestyle=":")
    axes.set_title("How large are the errors?", fontsize=13)
    _finish_plot(axes)
    return figure


def draw_training(histories: Mapping[str, Mapping[str, np.ndarray]]) -> Figure:
    """Loss against step, a panel for each method, since their losses differ in kind."""
    figure = Figure(figsize=(7.5, 1.0 + 2.1 * len(histories)), layout="constrained")
    grid = figure.subplots(len(histories), 1, squeeze=False, sharex=True)[:, 0]
    for axes, (name, history) in zip(grid, histories.items(), strict=True):
        step, loss = np.asarray(history["step"]), np.asarray(history["loss"], float)
        line = _line(name)
        axes.plot(step, loss, color=line["color"], linewidth=0.7, alpha=0.35)
        axes.plot(step, smooth(loss), color=line["color"], linewidth=1.8)
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter(ticker.FormatStrFormatter("%g"))
        axes.yaxis.set_minor_formatter(ticker.FormatStrFormatter("%g"))
        axes.yaxis.set_minor_locator(ticker.LogLocator(subs=(2, 5)))
        axes.set_ylabel("loss")
        axes.set_title(line["label"], loc="left", fontsize=11)
        axes.grid(alpha=0.25)
        axes.spines[["top", "right"]].set_visible(False)
    grid[-1].set_xlabel("training step")
    return figure


def draw_drive(truth: Truth, reading: np.ndarray) -> Figure:
    """The way driven over the free space, coloured from its start to its end."""
    space = truth.free_space
    figure = Figure(figsize=(9, 7.4 * _aspect(space) + 1.0), layout="constrained")
    axes = figure.add_subplot()
    _draw_room(axes, space)
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
    length = np.linalg.norm(pieces[:, 1] - pieces[:, 0], axis=1).sum()
    count = len(np.unique(segment))
    axes.set_title(f"The drive: {len(truth.pose)} observations, {count} straight segments, {length:.0f} m", fontsize=13)
    bar = figure.colorbar(lines, ax=axes, shrink=0.8, pad=0.02, ticks=[0, max(len(pieces) - 1, 1)])
    bar.ax.set_yticklabels(["start", "end"])
    return figure


def add_scale(figure: Figure, axes: list[Axes], scale_m: tuple[float, float] = SCALE_M) -> None:
    """The colour bar of error fields, beside these axes."""
    bar = figure.colorbar(
        ScalarMappable(LogNorm(*scale_m), COLOURS), ax=axes, extend="both", shrink=0.8, pad=0.015, aspect=30
    )
    bar.set_label("error of the worst heading [m]", fontsize=10)
    bar.ax.yaxis.set_major_locator(ticker.LogLocator(subs=(1, 2, 5)))
    bar.ax.yaxis.set_major_formatter(ticker.FormatStrFormatter("%g"))
    bar.ax.yaxis.set_minor_locator(ticker.NullLocator())


def count_by_decades(axis: Axis) -> None:
    """Write 1, 2, 5, 10 and so on, as they are, at an axis that grows by decades."""
    axis.set_major_locator(ticker.LogLocator(subs=(1, 2, 5)))
    axis.set_major_formatter(ticker.FormatStrFormatter("%g"))
    axis.set_minor_formatter(ticker.NullFormatter())


def to_png(figure: Figure) -> bytes:
    """A figure as PNG; equal figures give equal bytes, since no date is written."""
    FigureCanvasAgg(figure)
    buffer = BytesIO()
    figure.savefig(buffer, format="png", dpi=DOTS_PER_INCH, metadata={"Software": None})
    return buffer.getvalue()


def smooth(values: np.ndarray) -> np.ndarray:
    """Running median of values (N,) over about a fortieth of them; the ends use what there is."""
    half = max(len(values) // 80, 1)
    return np.array([np.median(values[max(i - half, 0) : i + half + 1]) for i in range(len(values))])


def limits(space: FreeSpace, margin_m: float = 0.2) -> tuple[np.ndarray, np.ndarray]:
    """South-west and north-east corner (2,) [m] of the reachable area with a margin around it."""
    row, column = np.nonzero(space.reachable)
    corner = np.array([[column.min(), row.min()], [column.max(), row.max()]])
    low, high = space.origin + corner * space.cell_m
    return low - margin_m, high + margin_m


def _read_arrays(path: Path) -> dict[str, np.ndarray]:
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
            return {name: arrays[name] for name in arrays.files}
    except (ValueError, OSError, BadZipFile) as error:
        raise InputError(f"{path} cannot be read: {error}") from None


def _draw_field(
    axes: Axes,
    space: FreeSpace,
    field: WorstField,
    floor: Floor = SCREEN,
    scale_m: tuple[float, float] = SCALE_M,
) -> None:
    """Dots at the truth, lines to the predictions with a head's share drawn by width, colour by magnitude."""
    _draw_room(axes, space, floor)
    order = np.argsort(field.error)  # the worst lie on top
    truth, predicted = field.truth[order], field.predicted[order]
    colours = colours_of(field.error[order], scale_m) / 255
    axes.scatter(*truth.T, s=7, c=colours, linewidths=0)
    axes.quiver(
        *truth.T,
        *(predicted - truth).T,
        color=colours,
        angles="xy",
        scale_units="xy",
        scale=1,
        width=0.0022,
        headwidth=4,
        headlength=5,
        headaxislength=4.5,
        minlength=0,
    )


def _draw_room(axes: Axes, space: FreeSpace, floor: Floor = SCREEN) -> None:
    rows, columns = space.free.shape
    kind = np.where(space.reachable, 0, np.where(space.free, 1, 2))
    half = space.cell_m / 2
    x, y = space.origin
    extent = (x - half, x + (columns - 0.5) * space.cell_m, y - half, y + (rows - 0.5) * space.cell_m)
    axes.imshow(
        kind,
        origin="lower",
        extent=extent,
        cmap=ListedColormap(floor),
        vmin=0,
        vmax=2,
        interpolation="nearest",
    )
    low, high = limits(space)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x [m]", ylabel="y [m]", aspect="equal")
    axes.tick_params(labelsize=9)
    for spine in axes.spines.values():
        spine.set_color("#888888")


def _aspect(space: FreeSpace) -> float:
    low, high = limits(space)
    return (high[1] - low[1]) / (high[0] - low[0])


def _summary(field: WorstField) -> str:
    rms = np.sqrt((field.error**2).mean())
    return f"RMS {100 * rms:.1f} cm, median {100 * np.median(field.error):.1f} cm"


def _line(name: str) -> dict[str, Any]:
    return {"color": LINES.get(name, "#555555"), "label": method_title(name), "linewidth": 1.8}


def _finish_plot(axes: Axes) -> None:
    axes.grid(alpha=0.25, which="both")
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False)


def _rank(name: str) -> tuple[int, str]:
    names = list(LINES)
    return (names.index(name) if name in names else len(names), name)
