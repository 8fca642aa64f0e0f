"""The risk-coverage curve: RMS error of the images left when those with the highest novelty are refused."""

from collections.abc import Mapping

import numpy as np
from matplotlib import ticker
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from deepgps.config.methods import colour_of, title_of
from deepgps.evaluation.acceptance import REFUSED, find_risk
from deepgps.evaluation.error_field import ErrorField

LARGEST_SHARE = REFUSED[-1]
"""Share refused at the end of the axis, as in the table of ``metrics.json``."""


def draw_risk(fields: Mapping[str, ErrorField]) -> Figure:
    """The risk-coverage curve of each method that gives a novelty, and the lowest curve that any score can have."""
    figure = Figure(figsize=(7.5, 4.6), layout="constrained")
    axes = figure.add_subplot()
    plot_risk(axes, fields)
    axes.set_title("Errors left when the least familiar images are refused", fontsize=13)
    return figure


def plot_risk(axes: Axes, fields: Mapping[str, ErrorField]) -> None:
    """Plot the curves into axes: by novelty, dashed by the true error, and a dot at what each method refuses itself."""
    for name, field in fields.items():
        if field.novelty is None:
            continue
        colour = colour_of(name)
        _plot_curve(axes, find_risk(field.error, field.novelty), color=colour, lw=1.8, label=title_of(name))
        _plot_curve(axes, find_risk(field.error, field.error), color=colour, lw=1.0, ls="--")
        kept = field.error[field.is_accepted]
        if field.accepted is not None and len(kept):
            refused = 100 * (1 - field.accepted.mean())
            axes.plot(refused, 100 * np.sqrt(np.mean(kept**2)), "o", color=colour, ms=6, mec="#ffffff", zorder=4)
    axes.plot([], [], "--", color="#666666", lw=1.0, label="refused by the true error")
    axes.plot([], [], "o", color="#666666", ms=6, mec="#ffffff", label="what the method refuses")
    axes.set(xlabel="images refused [%]", ylabel="RMS error of the others [cm]")
    axes.set_xlim(-0.1, 100 * LARGEST_SHARE)
    axes.xaxis.set_major_locator(ticker.MultipleLocator(1))
    axes.set_ylim(bottom=0)
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, fontsize=9)


def _plot_curve(axes: Axes, risk: np.ndarray, **line) -> None:
    """Plot a curve of risks (n,) [m] over the share refused."""
    refused = 100 * (1 - np.arange(1, len(risk) + 1) / len(risk))
    shown = refused <= 100 * LARGEST_SHARE
    axes.plot(refused[shown], 100 * risk[shown], **line)
