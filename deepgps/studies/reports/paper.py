"""The reports "landmarks", "lidar" and "lab": our errors next to the paper's."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib import ticker
from matplotlib.figure import Figure as Picture
from safetensors import safe_open

from deepgps.config.methods import colour_of, folder_of, title_of
from deepgps.evaluation.error_field import find_rms, read_all_headings, read_fields
from deepgps.reports.plots import add_scale, print_error_field, print_floor
from deepgps.reports.run_report import read_metrics
from deepgps.reports.table import tabulate
from deepgps.reports.targets import Figure, mean_of
from deepgps.studies.reports.columns import (
    OF_ACCEPTED,
    PAPERS_ERRORS,
    TRAIN,
    Column,
    Line,
    form,
    have_accepted,
    tabulate_lines,
)
from deepgps.studies.reports.rooms import find_baseline
from deepgps.studies.table import Row, find_methods, split_by, split_by_label
from sim.errors import InputError

REACH = "landmarks.reach_m"
# Table I of the paper: RMS, median and maximum [m]; it has no start from MDS.
PAPERS_LANDMARKS = {
    ("complete", "deepgps"): (0.004, 0.004, 0.021),
    ("complete", "posenet"): (0.006, 0.004, 0.024),
    ("complete", "explicit"): (0.800, 0.754, 1.613),
    ("incomplete", "deepgps"): (0.009, 0.007, 0.111),
    ("incomplete", "posenet"): (0.007, 0.006, 0.069),
    ("incomplete", "explicit"): (1.131, 0.742, 5.048),
}
LANDMARKS_NOTE = (
    "Errors in millimetres on the test grid: means over seeds, and the RMS of the worst seed; aligned on training "
    "samples, never scaled. Complete: all landmarks are visible; incomplete: only nearby ones. Explicit positioning "
    "starts at random, as in the paper, or from a map of the landmarks found by multidimensional scaling, which the "
    "paper does not use."
)
PCA = "pca_knn"
EACH = {"each_rms_m": "RMS", "each_median_m": "median", "each_max_m": "max"}
# The paper's table "ATE for 2D Lidar point cloud", a row for each of its four maps, in units of a square of side 2.
PAPERS_LIDAR = {
    "deepgps": ((0.162, 0.008, 2.449), (0.177, 0.006, 2.146), (0.178, 0.008, 2.545), (0.164, 0.008, 2.510)),
    PCA: ((0.142, 0.013, 1.980), (0.151, 0.014, 1.981), (0.177, 0.015, 2.346), (0.150, 0.014, 2.398)),
}
LIDAR_SCALE_M = (0.001, 1.0)
LIDAR_NOTE = (
    "Errors in metres on squares with a side of 2 m, as in the paper: for the worst heading of each test position, and "
    "for each scan separately, as the paper reports them. The paper's maps differ from ours; its results are assigned "
    "to our maps by number only. Aligned on training samples, never scaled. PCA + nearest neighbour uses true "
    "positions. Stored: how many numbers a method stores for positioning; in the paper, these are 2 and 66 million."
)
# References that errors are measured against, by the prefix of their column names.
AGAINST = {"label_": "labels", "": "truth"}
LABELS = ("labels_rms_m",)
# Mean and standard deviation over the paper's six data sets: RMS, median and maximum [m].
PAPERS_LAB = {
    "posenet": ((0.105, 0.053), (0.032, 0.005), (0.762, 0.457)),
    "deepgps": ((0.053, 0.021), (0.036, 0.004), (0.175, 0.026)),
}
LAB_NOTE = (
    "Errors in centimetres at test samples of the same drive; aligned on training samples, never scaled. Labels "
    "are positions that the tag camera measured from images of AprilTags: PoseNet learned from them, and the "
    "first errors are measured against them, as in the paper. The other errors are measured against the "
    "simulator's truth, which the paper did not have. Unlabelled: training and test samples that show too few "
    "tags; PoseNet does not learn from them, and errors against labels exclude them. Errors of what is accepted are "
    "against the truth. Label RMS: the error of the "
    "labels themselves. The last lines are the paper's means and standard deviations over its six data sets."
)


def report_landmarks(rows: Sequence[Row], varied: Sequence[str]) -> list[str]:
    """A table with a line for each kind of observation and method, next to the paper's figures; and a note on it."""
    groups = _group_landmarks(rows)
    lines = [Line((kind, title_of(method)), group) for (kind, method), group in groups.items()]
    columns = [
        Column("seeds", lambda line: str(len(line.rows))),
        *(
            Column(
                f"{title} [mm]", lambda line, name=name: _millimetres(float(np.mean([row[name] for row in line.rows])))
            )
            for name, title in PAPERS_ERRORS.items()
        ),
        Column("worst RMS", lambda line: _millimetres(max(row["rms_m"] for row in line.rows))),
        TRAIN,
        *_list_papers(lambda line: PAPERS_LANDMARKS.get((line.key[0], line.rows[0]["method"]), ()), _millimetres),
    ]
    return [tabulate_lines(["observations", "method"], lines, columns), LANDMARKS_NOTE]


def measure_landmarks(rows: Sequence[Row]) -> dict[str, Figure]:
    """RMS of every method with every kind of observation, and DeepGPS's training time, mean and longest."""
    figures = {
        f"{method}_{kind}": mean_of(f"RMS, {kind}, {title_of(method)}", [row["rms_m"] for row in group], "mm")
        for (kind, method), group in _group_landmarks(rows).items()
    }
    return figures | _measure_training(rows)


def draw_landmarks(rows: Sequence[Row], varied: Sequence[str], folder: Path) -> Picture:
    """Draw RMS (filled) and median (open) of every method and seed, and the paper's RMS (diamond)."""
    groups = _group_landmarks(rows)
    kinds, methods = (list(dict.fromkeys(names)) for names in zip(*groups, strict=True))
    picture = Picture(figsize=(4.6 * len(kinds) + 0.6, 1.6 + 0.5 * len(methods)), layout="constrained")
    panels = picture.subplots(1, len(kinds), squeeze=False, sharex=True, sharey=True)[0]
    for kind, axes in zip(kinds, panels, strict=True):
        for place, method in enumerate(methods):
            group, colour = groups.get((kind, method), []), colour_of(method)
            for name, inside in (("rms_m", colour), ("median_m", "none")):
                axes.plot([row[name] for row in group], [place] * len(group), "o", color=colour, mfc=inside)
            if (kind, method) in PAPERS_LANDMARKS:
                axes.plot(PAPERS_LANDMARKS[kind, method][0], place, "D", color="black", mfc="none")
        axes.set_yticks(range(len(methods)), [title_of(method) for method in methods])
        axes.set(xscale="log", title=f"{kind} observations", ylim=(len(methods) - 0.5, -0.5))
        axes.set_xlabel("error [m]; filled: RMS, open: median, diamond: the paper's RMS", fontsize=8)
        axes.xaxis.set_major_locator(ticker.LogLocator(numticks=12))
        axes.grid(alpha=0.25)
    return picture


def add_scans(run: Path, row: Row) -> Row:
    """Columns for the errors over single scans, and for how many numbers the method stores for positioning."""
    error = read_all_headings(run)[row["method"]].error
    values = find_rms(error), np.median(error), error.max()
    with safe_open(folder_of(run, row["method"]) / "weights.safetensors", "np") as weights:
        stored = sum(int(np.prod(weights.get_slice(name).get_shape())) for name in weights.offset_keys())
    return {**dict(zip(EACH, map(float, values), strict=True)), "stored": stored}


def report_lidar(rows: Sequence[Row], varied: Sequence[str]) -> list[str]:
    """A table with a line for each map and method, next to the paper's figures; and a note on how to read it."""
    lines = [
        Line((str(number), title_of(row["method"])), [row])
        for number, group in enumerate(_split_maps(rows, varied), start=1)
        for row in group
    ]
    columns = [
        *(
            Column(f"{title}{of}", lambda line, name=name: _metres(line.rows[0][name]))
            for names, of in ((PAPERS_ERRORS, ""), (EACH, ", each scan"))
            for name, title in names.items()
        ),
        Column("stored [million]", form("stored", ".2f", 1e-6)),
        TRAIN,
        *_list_papers(lambda line: _find_papers_map(line.rows[0]["method"], int(line.key[0])), _metres),
    ]
    return [tabulate_lines(["map", "method"], lines, columns), LIDAR_NOTE]


def measure_lidar(rows: Sequence[Row]) -> dict[str, Figure]:
    """DeepGPS's errors, their ratio to the baseline's on the same map, and how much less DeepGPS stores."""
    ours, baseline = [row for row in rows if row["method"] == "deepgps"], find_baseline(rows, PCA)
    both = [(row, baseline[row["recording"]]) for row in ours if row["recording"] in baseline]
    names, figures = ("rms_m", "median_m"), {}
    for name in names if ours else ():
        figures[name] = mean_of(PAPERS_ERRORS[name], [row[name] for row in ours], "cm")
    if both:
        for name in names:
            worst = max(mine[name] / other[name] for mine, other in both)
            title = f"{PAPERS_ERRORS[name]} / PCA + nearest neighbour's, worst map"
            figures[f"{name.removesuffix('_m')}_ratio"] = Figure(title, worst, "", worst=worst)
        least = min(other["stored"] / mine["stored"] for mine, other in both)
        figures["stored_ratio"] = Figure("stored by PCA / by DeepGPS", least, "", at_least=True, worst=least)
    return figures | _measure_training(rows)


def draw_lidar(rows: Sequence[Row], varied: Sequence[str], folder: Path) -> Picture:
    """Draw the maps with their obstacles, and the error of each method on them, on one scale."""
    maps, methods = _split_maps(rows, varied), find_methods(rows)
    picture = Picture(figsize=(4.0 * len(maps) + 0.8, 4.7 * len(methods)), layout="constrained")
    panels = picture.subplots(len(methods), len(maps), squeeze=False, sharex=True, sharey=True)
    for column, group in enumerate(maps):
        for row in group:
            axes = panels[methods.index(row["method"]), column]
            print_error_field(axes, folder / "runs" / row["run"], row["method"], LIDAR_SCALE_M)
            figures = f"RMS {_metres(row['rms_m'])} m, median {_metres(row['median_m'])} m"
            axes.set_title(f"map {column + 1}, {title_of(row['method'])}\n{figures}", fontsize=10, loc="left")
            axes.label_outer()
    add_scale(picture, list(panels.flat), LIDAR_SCALE_M)
    return picture


def add_labels(run: Path, row: Row) -> Row:
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


def report_lab(rows: Sequence[Row], varied: Sequence[str]) -> list[str]:
    """A table of every data set and method, then means and standard deviations, then the paper's; and a note on it."""
    names = [prefix + name for prefix in AGAINST for name in PAPERS_ERRORS]
    errors = [f"{title}, {kind} [cm]" for kind in AGAINST.values() for title in PAPERS_ERRORS.values()]
    accepted = [column for column in OF_ACCEPTED if have_accepted(rows)]
    headings = ["data set", "method", *errors, *(column.heading for column in accepted)]
    headings += ["unlabelled", "label RMS [cm]", "train [s]"]

    def write_line(first: str, line: Line, unlabelled: str, write: Callable[[Sequence[float]], str]) -> list[str]:
        errors, labels = [[write([100 * row[name] for row in line.rows]) for name in some] for some in (names, LABELS)]
        shares = [column.write(line) for column in accepted]
        return [first, title_of(line.rows[0]["method"]), *errors, *shares, unlabelled, *labels, TRAIN.write(line)]

    cells = [
        write_line(str(row["seed"]), Line((), [row]), f"{row['unlabelled']} + {row['test_unlabelled']}", _write_one)
        for row in rows
    ]
    for group in split_by(rows, "method").values():
        cells.append(write_line("mean ± std", Line((), group), "-", _write_spread))
    for method, figures in PAPERS_LAB.items():
        theirs = [f"{100 * mean:.1f} ± {100 * std:.1f}" for mean, std in figures]
        cells.append(["paper", title_of(method), *theirs, *["-"] * (len(headings) - 5)])
    return [tabulate(headings, cells), LAB_NOTE]


def measure_lab(rows: Sequence[Row]) -> dict[str, Figure]:
    """Means over the data sets: each method's errors against labels and truth, and the labels' own error."""
    figures = {
        f"{method}_{prefix}{name}": mean_of(
            f"{title_of(method)}, {title}, against {kind}", [row[prefix + name] for row in group], "cm"
        )
        for method, group in split_by(rows, "method").items()
        for prefix, kind in AGAINST.items()
        for name, title in PAPERS_ERRORS.items()
    }
    return {**figures, "labels_rms_m": mean_of("labels' own RMS", [row["labels_rms_m"] for row in rows], "cm")}


def draw_lab_errors(rows: Sequence[Row], varied: Sequence[str], folder: Path) -> Picture:
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
            if method in PAPERS_LAB:
                paper = 100 * PAPERS_LAB[method][place][0]
                axes.axhline(paper, color=colour, linestyle=":", label=f"{title_of(method)}, paper's mean")
        axes.set(title=title, xlabel="data set", yscale="log")
        axes.set_xticks(range(len(seeds)), [str(seed) for seed in seeds])
        for axis_ticks in (axes.yaxis.set_major_formatter, axes.yaxis.set_minor_formatter):
            axis_ticks(ticker.FormatStrFormatter("%g"))
        axes.yaxis.set_minor_locator(ticker.LogLocator(subs=(2, 5)))
        axes.grid(alpha=0.25, which="both")
    first = picture.axes[0]
    first.set_ylabel("error [cm]")
    picture.legend(*first.get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False, fontsize=8)
    return picture


def draw_lab_places(rows: Sequence[Row], varied: Sequence[str], folder: Path) -> Picture:
    """Draw predictions (blue) and true positions (orange) of one data set, joined by red lines, as in the paper.

    The data set is the one with the median RMS of DeepGPS against the truth.
    """
    order = sorted((row for row in rows if row["method"] == "deepgps"), key=lambda row: row["rms_m"]) or list(rows)
    row = order[(len(order) - 1) // 2]
    fields = read_fields(folder / "runs" / row["run"])
    picture = Picture(figsize=(5.4 * len(fields), 5.1), layout="constrained")
    panels = np.ravel(picture.subplots(1, len(fields), squeeze=False))
    for axes, (method, field) in zip(panels, fields.items(), strict=True):
        print_floor(axes, folder / "runs" / row["run"])
        for true, predicted in zip(field.truth, field.predicted, strict=True):
            axes.plot(*np.stack([true, predicted], axis=1), color="#d62728", linewidth=1.0, zorder=1)
        axes.scatter(*field.truth.T, s=9, color="#ff7f0e", label="truth", zorder=2)
        axes.scatter(*field.predicted.T, s=9, color="#1f77b4", label="predicted", zorder=3)
        rms = find_rms(field.error)
        axes.set_title(f"{title_of(method)}: RMS {100 * rms:.1f} cm, max {100 * field.error.max():.0f} cm", fontsize=11)
        axes.legend(loc="upper right", fontsize=8)
    picture.suptitle(f"Data set {row['seed']}, {len(field.error)} test samples", fontsize=12)
    return picture


def _group_landmarks(rows: Sequence[Row]) -> Mapping[tuple[str, str], list[Row]]:
    return split_by_label(rows, lambda row: ("complete" if row.get(REACH) is None else "incomplete", row["method"]))


def _split_maps(rows: Sequence[Row], varied: Sequence[str]) -> list[list[Row]]:
    return list(split_by_label(rows, lambda row: tuple(row[name] for name in varied)).values())


def _find_papers_map(method: str, number: int) -> Sequence[float]:
    return (PAPERS_LIDAR.get(method, ())[number - 1 : number] or ((),))[0]


def _measure_training(rows: Sequence[Row]) -> dict[str, Figure]:
    seconds = [row["train_s"] for row in rows if row["method"] == "deepgps"]
    return {"train_s": mean_of("training", seconds, "s")} if seconds else {}


def _list_papers(find, write) -> list[Column]:
    """Columns of the paper's figures, which ``find`` gives for a line; a dash where it has none."""

    def write_one(place: int):
        return lambda line: write(find(line)[place]) if find(line) else "-"

    return [Column(f"paper's {title}", write_one(place)) for place, title in enumerate(PAPERS_ERRORS.values())]


def _write_one(values: Sequence[float]) -> str:
    return f"{values[0]:.1f}"


def _write_spread(values: Sequence[float]) -> str:
    return f"{np.mean(values):.1f} ± {np.std(values):.1f}"


def _millimetres(value: float) -> str:
    return f"{1000 * value:.3g}" if value < 1.0 else f"{1000 * value:.0f}"


def _metres(value: float) -> str:
    return f"{value:.3f}" if value >= 0.1 else f"{value:.4f}"
