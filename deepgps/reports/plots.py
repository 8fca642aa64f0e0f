"""Plots: their common style, and error fields drawn over the floor of a room."""

from collections.abc import Iterable, Sequence
from io import BytesIO
from pathlib import Path

import numpy as np
from matplotlib import ticker
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, ListedColormap, LogNorm, to_rgb, to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from deepgps.config.methods import colour_of
from deepgps.evaluation.error_field import ErrorField, WorstField, find_worst, read_all_headings, split_by_acceptance
from sim.geometry import FreeSpace, limits
from sim.recording.format import open_truth

# Colours of where the robot can get to, where it would fit but cannot get to, and where it does not fit.
Floor = tuple[str, str, str]
SCREEN: Floor = ("#161a22", "#2c323e", "#4a5261")
PAPER: Floor = ("#ffffff", "#dde1e7", "#b3bac4")
DOTS_PER_INCH = 130


def colour_on_dark(method: str) -> tuple[int, int, int]:
    """A method's colour, paler than on paper: red, green and blue, up to 255."""
    red, green, blue = (int(255 * (0.3 + 0.7 * part)) for part in to_rgb(colour_of(method)))
    return red, green, blue


def draw_band(
    axes: Axes, places: Sequence[float], seeds: Sequence[Sequence[float]], colour: str, label: str, marker: float
) -> None:
    """Draw a line through the mean of the seeds' values at each place, and a band from least to greatest."""
    axes.plot(places, [np.mean(one) for one in seeds], "o-", color=colour, markersize=marker, label=label)
    axes.fill_between(places, [min(one) for one in seeds], [max(one) for one in seeds], color=colour, alpha=0.15, lw=0)


def count_by_decades(axis: Axis) -> None:
    """Label a logarithmic axis with 1, 2, 5, 10 and so on, as plain numbers."""
    axis.set_major_locator(ticker.LogLocator(subs=(1, 2, 5)))
    axis.set_major_formatter(ticker.FormatStrFormatter("%g"))
    axis.set_minor_formatter(ticker.NullFormatter())


def to_png(figure: Figure) -> bytes:
    """A figure as PNG; equal figures give equal bytes, since neither date nor software is written."""
    FigureCanvasAgg(figure)
    buffer = BytesIO()
    figure.savefig(buffer, format="png", dpi=DOTS_PER_INCH, metadata={"Software": None})
    return buffer.getvalue()


def smooth(values: np.ndarray, first: int = 0) -> np.ndarray:
    """Running median of values (N,) over about a fortieth of them, from ``first`` on; shorter at the ends."""
    half = max(len(values) // 80, 1)
    return np.array([np.median(values[max(i - half, 0) : i + half + 1]) for i in range(first, len(values))])


REFUSED_COLOUR = "#9aa0aa"
"""Colour of errors of images that the method refuses."""
# Logarithmic, since one plot shows errors of a centimetre and of a metre.
SCALE_M = (0.01, 1.0)
TICKS_M = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
COLOURS = LinearSegmentedColormap.from_list(
    "error", ["#2b5fd9", "#22a7d6", "#3fd0a5", "#c9e265", "#ffc13b", "#ff7a33", "#e8254f"]
)


def colours_of(error: np.ndarray, scale_m: tuple[float, float] = SCALE_M) -> np.ndarray:
    """Colours (..., 4) uint8 RGBA of errors (...,) [m] on a logarithmic scale."""
    return (COLOURS(LogNorm(*scale_m, clip=True)(np.maximum(error, scale_m[0]))) * 255).round().astype(np.uint8)


def print_error_field(axes: Axes, run: Path, name: str, scale_m: tuple[float, float] = SCALE_M) -> WorstField:
    """Draw one method's error field of a run on a white floor, refused images in grey; ``add_scale`` adds the colours.

    Returns the worst heading of each position, refused or not. The ends of the colour scale are in metres.
    """
    field = read_all_headings(run)[name]
    draw_field(axes, open_truth(run / "recording").free_space, field, PAPER, scale_m)
    return find_worst(field)


def draw_field(
    axes: Axes, space: FreeSpace, field: ErrorField, floor: Floor = SCREEN, scale_m: tuple[float, float] = SCALE_M
) -> None:
    """Draw dots at the true positions and arrows from them to the predictions, at the worst heading of each.

    Colours are by error. Where a method refuses images, the worst of those it accepts has the colour, and the worst of
    those it refuses is grey below it.
    """
    draw_room(axes, space, floor)
    accepted, refused = split_by_acceptance(field)
    order = np.argsort(accepted.error)  # the largest errors are drawn on top
    _draw_arrows(axes, refused, np.array([to_rgba(REFUSED_COLOUR)]))
    _draw_arrows(axes, accepted.take(order), colours_of(accepted.error[order], scale_m) / 255)


def explain_refused(figure: Figure, fields: Iterable[ErrorField]) -> None:
    """Add a line below the axes that says what grey means, if some of the fields have refused images."""
    if any(not field.is_accepted.all() for field in fields):
        figure.legend(
            handles=[Line2D([], [], color=REFUSED_COLOUR, marker="o", markersize=3)],
            labels=["grey: images that the method refuses; colours: the worst heading of those it accepts"],
            loc="outside lower center",
            frameon=False,
            fontsize=10,
        )


def _draw_arrows(axes: Axes, field: WorstField, colours: np.ndarray) -> None:
    axes.scatter(*field.truth.T, s=7, c=colours, linewidths=0)
    axes.quiver(
        *field.truth.T,
        *(field.predicted - field.truth).T,
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


def draw_room(axes: Axes, space: FreeSpace, floor: Floor = SCREEN) -> None:
    """Draw the floor: where the robot can get to, where it would fit but cannot get to, and where it does not fit."""
    rows, columns = space.free.shape
    kind = np.where(space.reachable, 0, np.where(space.free, 1, 2))
    half = space.cell_m / 2
    x, y = space.origin
    extent = (x - half, x + (columns - 0.5) * space.cell_m, y - half, y + (rows - 0.5) * space.cell_m)
    axes.imshow(
        kind, origin="lower", extent=extent, cmap=ListedColormap(floor), vmin=0, vmax=2, interpolation="nearest"
    )
    low, high = limits(space)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x [m]", ylabel="y [m]", aspect="equal")
    axes.tick_params(labelsize=9)
    for spine in axes.spines.values():
        spine.set_color("#888888")


def add_scale(
    figure: Figure,
    axes: list[Axes],
    scale_m: tuple[float, float] = SCALE_M,
    label: str = "error of the worst heading [m]",
) -> None:
    """Add the colour bar of errors next to these axes."""
    bar = figure.colorbar(
        ScalarMappable(LogNorm(*scale_m), COLOURS), ax=axes, extend="both", shrink=0.8, pad=0.015, aspect=30
    )
    bar.set_label(label, fontsize=10)
    count_by_decades(bar.ax.yaxis)
    bar.ax.yaxis.set_minor_locator(ticker.NullLocator())
