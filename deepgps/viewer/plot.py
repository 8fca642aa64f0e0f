"""Plots with axes of their own, drawn as lines in a 2D view: the viewer's own plots have only timelines as abscissa.

A plot is ``WIDTH`` wide and 1 high with its origin at the lower left; its legend to the right of it covers nothing.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from matplotlib import ticker

from deepgps.config.methods import title_of
from deepgps.reports.plots import colour_on_dark
from deepgps.viewer.scene import STILL_BEHAVIOUR
from deepgps.viewer.stream import Rows, put

WIDTH = 2.1
LEGEND = 0.8  # width of the legend
ROW, ROWS = 0.15, 0.7  # height of a row of the legend, and of all rows at most
TICKS = 4
GRID, INK = (44, 49, 60), (170, 177, 190)
DISTRIBUTION = "report/distribution"
MIN_ERROR_M = 1e-3
PALE_OPACITY = 150  # Opacity of the curves of all runs but the last


@dataclass(frozen=True)
class Axis:
    """One axis of a plot."""

    title: str  # What is along it, with its unit
    low: float  # Value at its start
    high: float  # Value at its end
    ticks: Mapping[float, str]  # Labels by value
    log: bool = False  # Whether it is logarithmic

    def share(self, values: np.ndarray | Sequence[float]) -> np.ndarray:
        """Positions of values along the axis, from 0 to 1 between its ends; values beyond them are moved there."""
        low, high, values = self.low, self.high, np.clip(np.asarray(values, float), self.low, self.high)
        if self.log:
            low, high, values = np.log(low), np.log(high), np.log(values)
        return (values - low) / (high - low)


@dataclass(frozen=True)
class Curve:
    """One line of a plot."""

    name: str  # Entity below the plot
    title: str  # Its line in the legend; empty: none
    colour: tuple[int, ...]  # RGB or RGBA, up to 255
    x: Sequence[float] | np.ndarray  # Abscissas (n,)
    y: Sequence[float] | np.ndarray  # Ordinates (n,)
    marked: bool = False  # Whether there is a dot at each point


def make_axis(title: str, values: np.ndarray | Sequence[float], log: bool = False, zero: bool = False) -> Axis:
    """Make an axis around values, with about four ticks at round numbers; ``zero`` makes it start at zero."""
    values = np.asarray(values, float)
    low, high = float(values.min()), float(values.max())
    if log:
        exponents = np.arange(np.floor(np.log10(low)) - 1, np.ceil(np.log10(high)) + 2)
        found = (10.0 ** exponents[:, None] * [1, 2, 5]).reshape(-1)
        first, last = np.searchsorted(found, low, "right") - 1, np.searchsorted(found, high, "left")
        found = found[first : max(last, first + 1) + 1]
        if len(found) > 2 * TICKS:  # only powers of ten between the ends
            found = np.unique([found[0], *found[np.isclose(np.log10(found) % 1, [[0], [1]]).any(axis=0)], found[-1]])
        low, high = float(found[0]), float(found[-1])
    else:
        low = 0.0 if zero else low
        found = ticker.MaxNLocator(TICKS).tick_values(low, high if high > low else low + 1)
        low, high = float(found[0]), float(found[-1])
    return Axis(title, low, high, {float(one): f"{one:.6g}" for one in found}, log)


def log_plot(stream: rr.RecordingStream, path: str, x: Axis, y: Axis, curves: Sequence[Curve], at: Rows = ()) -> None:
    """Log a plot below an entity, statically or from the places ``at`` on."""
    columns, rows = WIDTH * x.share(list(x.ticks)), 1 - y.share(list(y.ticks))
    grid = [[(column, 0), (column, 1)] for column in columns] + [[(0, row), (WIDTH, row)] for row in rows]
    titled = [curve for curve in curves if curve.title]
    height = min(ROW, ROWS / max(len(titled), 1))
    put(stream, f"{path}/axes", rr.LineStrips2D(grid, colors=GRID, radii=rr.Radius.ui_points(0.6)), at)
    for entity, places, labels, colours in (  # a label is drawn below its point
        ("axes/x", [(column, 1) for column in columns], list(x.ticks.values()), [INK]),
        ("axes/y", [(-0.09, row - 0.035) for row in rows], list(y.ticks.values()), [INK]),
        ("axes/titles", [(WIDTH + 0.55 * LEGEND, 0.75), (0.1, -0.2)], [x.title, y.title], [INK]),
        (
            "legend",
            [(WIDTH + LEGEND / 2, height * row) for row in range(len(titled))],
            [one.title for one in titled],
            [one.colour for one in titled],
        ),
    ):
        points, radius = np.asarray(places, float).reshape(-1, 2), rr.Radius.ui_points(0)
        text = rr.Points2D(points, labels=labels, show_labels=True, radii=radius, colors=colours)
        put(stream, f"{path}/{entity}", text, at)
    for curve in curves:
        points = np.stack([WIDTH * x.share(curve.x), 1 - y.share(curve.y)], axis=1)
        line = rr.LineStrips2D([points], colors=[curve.colour], radii=rr.Radius.ui_points(1.2 if curve.title else 0.6))
        put(stream, f"{path}/curves/{curve.name}", line, at)
        if curve.marked:
            dots = rr.Points2D(points, colors=[curve.colour], radii=rr.Radius.ui_points(3.5))
            for thing in (dots, rr.AnyValues(x=np.asarray(curve.x, float), y=np.asarray(curve.y, float))):
                put(stream, f"{path}/curves/{curve.name}/points", thing, at)


def log_cursor(stream: rr.RecordingStream, path: str, x: Axis, value: float, at: Rows) -> None:
    """Log a vertical line at a value of a plot's abscissa, where the slider is."""
    column = WIDTH * float(x.share([value])[0])
    line = rr.LineStrips2D([[(column, 0), (column, 1)]], colors=INK, radii=rr.Radius.ui_points(0.8))
    put(stream, f"{path}/cursor", line, at)


def plot_view(name: str, path: str) -> rrb.Spatial2DView:
    """A view of a plot and its legend; its grid and its labels do not catch the pointer."""
    return rrb.Spatial2DView(
        name=name,
        origin=path,
        background=(13, 14, 17),
        visual_bounds=rrb.VisualBounds2D(x_range=(-0.2, WIDTH + LEGEND), y_range=(-0.24, 1.2)),
        overrides={f"{path}/{one}": STILL_BEHAVIOUR for one in ("axes", "legend", "cursor")},
    )


def log_distribution(
    stream: rr.RecordingStream, errors: Mapping[str, Sequence[np.ndarray]], labels: Sequence[str] = ("",)
) -> None:
    """Log the share of test positions whose error is at most a given value.

    Each method has errors (C,) [m] in as many runs as there are labels; all but the last run are pale.
    """
    curves = []
    for method, runs in errors.items():
        for label, error in zip(labels, runs, strict=True):
            colour = (*colour_on_dark(method), 255 if label == labels[-1] else PALE_OPACITY)
            centimetres = 100 * np.maximum(np.sort(error), MIN_ERROR_M)
            share = 100 * np.arange(1, len(error) + 1) / len(error)
            title = ", ".join([title_of(method), *([label] if label else [])])
            curves.append(Curve(f"{method}{f'_{label}' if label else ''}", title, colour, centimetres, share))
    x = make_axis("error of the worst heading [cm]", np.concatenate([curve.x for curve in curves]), log=True)
    log_plot(stream, DISTRIBUTION, x, make_axis("test positions [%]", [0, 100]), curves)
