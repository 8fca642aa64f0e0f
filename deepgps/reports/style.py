"""Common style of all figures: method colours, floors for screen and paper, logarithmic axes, PNG bytes."""

from collections.abc import Sequence
from io import BytesIO

import numpy as np
from matplotlib import ticker
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from deepgps.config.methods import colour_of

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
    """Draw a line through the mean over the seeds at each place, and a band from their minimum to their maximum.

    Args:
        axes: The axes to draw into.
        places: Positions along the abscissa.
        seeds: The seeds' values at each place.
        colour: Colour of line and band.
        label: Label of the line.
        marker: Size of the markers [pt].
    """
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
