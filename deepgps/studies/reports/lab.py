"""The report of the laboratory: errors against labels, as in the paper's Table III, and against the truth."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib import ticker
from matplotlib.figure import Figure as Picture

from deepgps.config.methods import colour_of, title_of
from deepgps.evaluation.error_field import find_rms, read_fields
from deepgps.reports.field_plot import print_floor
from deepgps.reports.run_report import read_metrics
from deepgps.reports.table import tabulate
from deepgps.reports.targets import Figure, mean_of
from deepgps.studies.table import PAPERS_ERRORS, Row, choose_accepted, split_by, write_accepted
from sim.errors import InputError

# References that errors are measured against, by the prefix of their column names.
AGAINST = {"label_": "labels", "": "truth"}
# Mean and standard deviation over the paper's six data sets: RMS, median and maximum [m].
PAPER = {
    "posenet": ((0.105, 0.053), (0.032, 0.005), (0.762, 0.457)),
    "deepgps": ((0.053, 0.021), (0.036, 0.004), (0.175, 0.026)),
}
NOTE = (
    "Errors in centimetres at test samples of the same drive; aligned on training samples, never scaled. Labels "
    "are positions that the tag camera measured from images of AprilTags: PoseNet learned from them, and the "
    "first errors are measured against them, as in the paper. The other errors are measured against the "
    "simulator's truth, which the paper did not have. Unlabelled: training and test samples that show too few "
    "tags; PoseNet does not learn from them, and errors against labels exclude them. Errors of what is accepted are "
    "against the truth. Label RMS: the error of the "
    "labels themselves. The last lines are the paper's means and standard deviations over its six data sets."
)


def add(run: Path, row: Row) -> Row:
    """Columns for errors against labels, and for the errors of the labels themselves."""
    metrics = read_metrics(run)
    if "labels" not in metrics:
        raise InputError(f"{run}: the report lab needs a recording with labels, as tag_camera.mounted gives it")
    labels, against = metrics["labels"], metrics["methods"][row["method"]]["against_labels"]
    return {
        **{f"label_{name}": against[name] for name in PAPERS_ERRORS},
        **{name: labels[name] for name in ("unlabelled", "test_unlabelled")},
        "labels_rms_m": labels["rms_m"],
        "labels_max_m": labels["max_m"],
    }


def report(rows: Sequence[Row], varied: Sequence[str]) -> list[str]:
    """A table of every data set and method, then means and standard deviations, then the paper's; and a note on it."""
    ours = [f"{title}, {kind} [cm]" for kind in AGAINST.values() for title in PAPERS_ERRORS.values()]
    accepted = choose_accepted(rows)
    headings = ["data set", "method", *ours, *accepted.values(), "unlabelled", "label RMS [cm]", "train [s]"]
    cells = [
        [
            str(row["seed"]),
            title_of(row["method"]),
            *(_centimetres(row[prefix + name]) for prefix in AGAINST for name in PAPERS_ERRORS),
            *write_accepted([row], accepted),
            f"{row['unlabelled']} + {row['test_unlabelled']}",
            _centimetres(row["labels_rms_m"]),
            f"{row['train_s']:.0f}",
        ]
        for row in rows
    ]
    for method, group in split_by(rows, "method").items():
        spread = [_spread(group, prefix + name) for prefix in AGAINST for name in PAPERS_ERRORS]
        rest = [_spread(group, "labels_rms_m"), f"{np.mean([row['train_s'] for row in group]):.0f}"]
        cells.append(["mean ± std", title_of(method), *spread, *write_accepted(group, accepted), "-", *rest])
    for method, figures in PAPER.items():
        theirs = [f"{100 * mean:.1f} ± {100 * std:.1f}" for mean, std in figures]
        cells.append(["paper", title_of(method), *theirs, *["-"] * (len(headings) - 5)])
    return [tabulate(headings, cells), NOTE]


def measure(rows: Sequence[Row]) -> dict[str, Figure]:
    """Means over the data sets: each method's errors against labels and truth, and the labels' own error."""
    figures = {}
    for method, group in split_by(rows, "method").items():
        for prefix, kind in AGAINST.items():
            for name, title in PAPERS_ERRORS.items():
                values = [row[prefix + name] for row in group]
                heading = f"{title_of(method)}, {title}, against {kind}"
                figures[f"{method}_{prefix}{name}"] = mean_of(heading, values, "cm")
    figures["labels_rms_m"] = mean_of("labels' own RMS", [row["labels_rms_m"] for row in rows], "cm")
    return figures


def draw_errors(rows: Sequence[Row], varied: Sequence[str], folder: Path) -> Picture:
    """Draw RMS, median and maximum of each data set against labels (filled) and truth (open), and the paper's mean."""
    picture = Picture(figsize=(9.6, 3.4), layout="constrained")
    seeds = list(dict.fromkeys(row["seed"] for row in rows))
    for axes, (place, (name, title)) in zip(picture.subplots(1, 3), enumerate(PAPERS_ERRORS.items()), strict=True):
        for side, (method, group) in enumerate(split_by(rows, "method").items()):
            colour = colour_of(method)
            x = np.array([seeds.index(row["seed"]) for row in group]) + 0.2 * side - 0.1
            values = {prefix: [100 * row[prefix + name] for row in group] for prefix in AGAINST}
            axes.plot(x, values["label_"], "o", color=colour, label=f"{title_of(method)}, against labels")
            axes.plot(x, values[""], "o", color=colour, mfc="none", label=f"{title_of(method)}, against truth")
            if method in PAPER:
                paper = 100 * PAPER[method][place][0]
                axes.axhline(paper, color=colour, linestyle=":", label=f"{title_of(method)}, paper's mean")
        axes.set(title=title, xlabel="data set", yscale="log")
        axes.set_xticks(range(len(seeds)), [str(seed) for seed in seeds])
        for axis_ticks in (axes.yaxis.set_major_formatter, axes.yaxis.set_minor_formatter):
            axis_ticks(ticker.FormatStrFormatter("%g"))
        axes.yaxis.set_minor_locator(ticker.LogLocator(subs=(2, 5)))
        axes.grid(alpha=0.25, which="both")
        if place == 0:
            axes.set_ylabel("error [cm]")
            picture.legend(
                *axes.get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False, fontsize=8
            )
    return picture


def draw_places(rows: Sequence[Row], varied: Sequence[str], folder: Path) -> Picture:
    """Draw predictions (blue) and true positions (orange) of one data set, joined by red lines, as in the paper.

    The data set is the one with the median RMS of DeepGPS against the truth.
    """
    order = sorted((row for row in rows if row["method"] == "deepgps"), key=lambda row: row["rms_m"]) or list(rows)
    row = order[(len(order) - 1) // 2]
    fields = read_fields(folder / "runs" / row["run"])
    picture = Picture(figsize=(5.4 * len(fields), 5.1), layout="constrained")
    for axes, (method, field) in zip(
        np.ravel(picture.subplots(1, len(fields), squeeze=False)), fields.items(), strict=True
    ):
        print_floor(axes, folder / "runs" / row["run"])
        for true, found in zip(field.truth, field.predicted, strict=True):
            axes.plot(*np.stack([true, found], axis=1), color="#d62728", linewidth=1.0, zorder=1)
        axes.scatter(*field.truth.T, s=9, color="#ff7f0e", label="truth", zorder=2)
        axes.scatter(*field.predicted.T, s=9, color="#1f77b4", label="predicted", zorder=3)
        rms = find_rms(field.error)
        axes.set_title(f"{title_of(method)}: RMS {100 * rms:.1f} cm, max {100 * field.error.max():.0f} cm", fontsize=11)
        axes.legend(loc="upper right", fontsize=8)
    picture.suptitle(f"Data set {row['seed']}, {len(field.error)} test samples", fontsize=12)
    return picture


def _spread(rows: Sequence[Row], name: str) -> str:
    values = [100 * row[name] for row in rows]
    return f"{np.mean(values):.1f} ± {np.std(values):.1f}"


def _centimetres(value: float) -> str:
    return f"{100 * value:.1f}"
