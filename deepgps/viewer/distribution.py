"""The distribution of errors over test positions, as a plot."""

from collections.abc import Mapping, Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from deepgps.config.methods import title_of
from deepgps.reports.style import colour_on_dark
from deepgps.viewer.plot import Curve, log_plot, make_axis, plot_view

PATH = "report/distribution"
LEAST_M = 1e-3
PALE = 150


def log_distribution(
    stream: rr.RecordingStream, errors: Mapping[str, Sequence[np.ndarray]], labels: Sequence[str] = ("",)
) -> None:
    """Log the share of test positions whose error is at most a given value.

    Args:
        stream: Stream to log to.
        errors: Errors of each method (C,) [m], in as many runs as there are labels; all but the last run are pale.
        labels: What distinguishes the runs.
    """
    curves = []
    for method, runs in errors.items():
        for label, error in zip(labels, runs, strict=True):
            colour = (*colour_on_dark(method), 255 if label == labels[-1] else PALE)
            centimetres = 100 * np.maximum(np.sort(error), LEAST_M)
            share = 100 * np.arange(1, len(error) + 1) / len(error)
            title = ", ".join([title_of(method), *([label] if label else [])])
            curves.append(Curve(f"{method}{f'_{label}' if label else ''}", title, colour, centimetres, share))
    x = make_axis("error of the worst heading [cm]", np.concatenate([curve.x for curve in curves]), log=True)
    log_plot(stream, PATH, x, make_axis("test positions [%]", [0, 100]), curves)


def distribution_view() -> rrb.Spatial2DView:
    """A view of the plot."""
    return plot_view("Distribution of errors", PATH)
