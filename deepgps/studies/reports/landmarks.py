"""The report of landmarks: every method with complete and incomplete observations, next to the paper's Table I."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib import ticker
from matplotlib.figure import Figure as Picture

from deepgps.config.methods import colour_of, title_of
from deepgps.reports.table import tabulate
from deepgps.reports.targets import Figure, mean_of
from deepgps.studies.table import PAPERS_ERRORS, Row

REACH = "landmarks.reach_m"
# Table I of the paper: RMS, median and maximum [m]; it has no start from MDS.
PAPER = {
    ("complete", "deepgps"): (0.004, 0.004, 0.021),
    ("complete", "posenet"): (0.006, 0.004, 0.024),
    ("complete", "explicit"): (0.800, 0.754, 1.613),
    ("incomplete", "deepgps"): (0.009, 0.007, 0.111),
    ("incomplete", "posenet"): (0.007, 0.006, 0.069),
    ("incomplete", "explicit"): (1.131, 0.742, 5.048),
}
NOTE = (
    "Errors in millimetres on the test grid: means over seeds, and the RMS of the worst seed; aligned on training "
    "samples, never scaled. Complete: all landmarks are visible; incomplete: only nearby ones. Explicit positioning "
    "starts at random, as in the paper, or from a map of the landmarks found by multidimensional scaling, which the "
    "paper does not use."
)
Groups = Mapping[tuple[str, str], Sequence[Row]]


def report(rows: Sequence[Row], varied: Sequence[str]) -> list[str]:
    """A table with a line for each kind of observation and method, next to the paper's figures; and a note on it."""
    ours = [f"{title} [mm]" for title in PAPERS_ERRORS.values()]
    paper = [f"paper's {title}" for title in PAPERS_ERRORS.values()]
    headings = ["observations", "method", "seeds", *ours, "worst RMS", "train [s]", *paper]
    cells = []
    for (kind, method), group in _group(rows).items():
        means = [_millimetres(float(np.mean([row[name] for row in group]))) for name in PAPERS_ERRORS]
        worst = _millimetres(max(row["rms_m"] for row in group))
        seconds = f"{np.mean([row['train_s'] for row in group]):.0f}"
        theirs = [_millimetres(value) for value in PAPER[kind, method]] if (kind, method) in PAPER else ["-"] * 3
        cells.append([kind, title_of(method), str(len(group)), *means, worst, seconds, *theirs])
    return [tabulate(headings, cells), NOTE]


def measure(rows: Sequence[Row]) -> dict[str, Figure]:
    """RMS of every method with every kind of observation, and DeepGPS's training time, mean and longest."""
    figures = {}
    for (kind, method), group in _group(rows).items():
        values = [row["rms_m"] for row in group]
        title = f"RMS, {kind}, {title_of(method)}"
        figures[f"{method}_{kind}"] = mean_of(title, values, "mm")
    if seconds := [row["train_s"] for row in rows if row["method"] == "deepgps"]:
        figures["train_s"] = mean_of("training", seconds, "s")
    return figures


def draw(rows: Sequence[Row], varied: Sequence[str], folder: Path) -> Picture:
    """Draw RMS (filled) and median (open) of every method and seed, and the paper's RMS (diamond)."""
    groups = _group(rows)
    kinds, methods = (list(dict.fromkeys(names)) for names in zip(*groups, strict=True))
    picture = Picture(figsize=(4.6 * len(kinds) + 0.6, 1.6 + 0.5 * len(methods)), layout="constrained")
    panels = picture.subplots(1, len(kinds), squeeze=False, sharex=True, sharey=True)[0]
    for kind, axes in zip(kinds, panels, strict=True):
        for place, method in enumerate(methods):
            group = groups.get((kind, method), [])
            colour = colour_of(method)
            for name, inside in (("rms_m", colour), ("median_m", "none")):
                axes.plot([row[name] for row in group], [place] * len(group), "o", color=colour, mfc=inside)
            if (kind, method) in PAPER:
                axes.plot(PAPER[kind, method][0], place, "D", color="black", mfc="none")
        axes.set_yticks(range(len(methods)), [title_of(method) for method in methods])
        axes.set(xscale="log", title=f"{kind} observations", ylim=(len(methods) - 0.5, -0.5))
        axes.set_xlabel("error [m]; filled: RMS, open: median, diamond: the paper's RMS", fontsize=8)
        axes.xaxis.set_major_locator(ticker.LogLocator(numticks=12))
        axes.grid(alpha=0.25)
    return picture


def _group(rows: Sequence[Row]) -> Groups:
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        kind = "complete" if row.get(REACH) is None else "incomplete"
        groups.setdefault((kind, row["method"]), []).append(row)
    return groups


def _millimetres(value: float) -> str:
    return f"{1000 * value:.3g}" if value < 1.0 else f"{1000 * value:.0f}"
