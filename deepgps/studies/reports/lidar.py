"""The report of lidar: DeepGPS against PCA + nearest neighbour on four maps, next to the paper's appendix."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure as Picture
from safetensors import safe_open

from deepgps.config.methods import folder_of, title_of
from deepgps.evaluation.error_field import find_rms, read_all_headings
from deepgps.reports.field_plot import add_scale, print_error_field
from deepgps.reports.table import tabulate
from deepgps.reports.targets import Figure, mean_of
from deepgps.studies.table import PAPERS_ERRORS, Row, find_methods

BASELINE = "pca_knn"
EACH = {"each_rms_m": "RMS", "each_median_m": "median", "each_max_m": "max"}
# The paper's table "ATE for 2D Lidar point cloud", a row for each of its four maps, in units of a square of side 2.
PAPER = {
    "deepgps": ((0.162, 0.008, 2.449), (0.177, 0.006, 2.146), (0.178, 0.008, 2.545), (0.164, 0.008, 2.510)),
    BASELINE: ((0.142, 0.013, 1.980), (0.151, 0.014, 1.981), (0.177, 0.015, 2.346), (0.150, 0.014, 2.398)),
}
SCALE_M = (0.001, 1.0)
NOTE = (
    "Errors in metres on squares with a side of 2 m, as in the paper: for the worst heading of each test position, and "
    "for each scan separately, as the paper reports them. The paper's maps differ from ours; its results are assigned "
    "to our maps by number only. Aligned on training samples, never scaled. PCA + nearest neighbour uses true "
    "positions. Stored: how many numbers a method stores for positioning; in the paper, these are 2 and 66 million."
)


def add(run: Path, row: Row) -> Row:
    """Columns for the errors over single scans, and for how many numbers the method stores for positioning."""
    error = read_all_headings(run)[row["method"]].error
    values = find_rms(error), np.median(error), error.max()
    with safe_open(folder_of(run, row["method"]) / "weights.safetensors", "np") as weights:
        stored = sum(int(np.prod(weights.get_slice(name).get_shape())) for name in weights.offset_keys())
    return {**dict(zip(EACH, map(float, values), strict=True)), "stored": stored}


def report(rows: Sequence[Row], varied: Sequence[str]) -> list[str]:
    """A table with a line for each map and method, next to the paper's figures; and a note on how to read it."""
    each = [f"{title}, each scan" for title in EACH.values()]
    paper = [f"paper's {title}" for title in PAPERS_ERRORS.values()]
    headings = ["map", "method", *PAPERS_ERRORS.values(), *each, "stored [million]", "train [s]", *paper]
    cells = []
    for number, group in enumerate(_by_map(rows, varied).values()):
        for row in group:
            ours = [_write(row[name]) for name in (*PAPERS_ERRORS, *EACH)]
            theirs = [_write(value) for value in _paper(row["method"], number)] or ["-"] * 3
            stored = f"{row['stored'] / 1e6:.2f}"
            title = [str(number + 1), title_of(row["method"])]
            cells.append([*title, *ours, stored, f"{row['train_s']:.0f}", *theirs])
    return [tabulate(headings, cells), NOTE]


def measure(rows: Sequence[Row]) -> dict[str, Figure]:
    """DeepGPS's errors, their ratio to the baseline's on the same map, and how much less DeepGPS stores."""
    ours = [row for row in rows if row["method"] == "deepgps"]
    baseline = {row["recording"]: row for row in rows if row["method"] == BASELINE}
    both = [(row, baseline[row["recording"]]) for row in ours if row["recording"] in baseline]
    figures = {}
    for name, title in PAPERS_ERRORS.items():
        if ours and name != "max_m":
            figures[name] = mean_of(title, [row[name] for row in ours], "cm")
    for name in ("rms_m", "median_m"):
        if both:
            ratios = [mine[name] / other[name] for mine, other in both]
            title = f"{PAPERS_ERRORS[name]} / PCA + nearest neighbour's, worst map"
            figures[f"{name.removesuffix('_m')}_ratio"] = Figure(title, max(ratios), "", worst=max(ratios))
    if both:
        less = [other["stored"] / mine["stored"] for mine, other in both]
        figures["stored_ratio"] = Figure("stored by PCA / by DeepGPS", min(less), "", at_least=True, worst=min(less))
    if ours:
        figures["train_s"] = mean_of("training", [row["train_s"] for row in ours], "s")
    return figures


def draw(rows: Sequence[Row], varied: Sequence[str], folder: Path) -> Picture:
    """Draw the maps with their obstacles, and the error of each method on them, on one scale."""
    maps = _by_map(rows, varied)
    methods = find_methods(rows)
    picture = Picture(figsize=(4.0 * len(maps) + 0.8, 4.7 * len(methods)), layout="constrained")
    panels = picture.subplots(len(methods), len(maps), squeeze=False, sharex=True, sharey=True)
    for column, group in enumerate(maps.values()):
        for row in group:
            axes = panels[methods.index(row["method"]), column]
            print_error_field(axes, folder / "runs" / row["run"], row["method"], SCALE_M)
            figures = f"RMS {_write(row['rms_m'])} m, median {_write(row['median_m'])} m"
            axes.set_title(f"map {column + 1}, {title_of(row['method'])}\n{figures}", fontsize=10, loc="left")
            axes.label_outer()
    add_scale(picture, list(panels.flat), SCALE_M)
    return picture


def _by_map(rows: Sequence[Row], varied: Sequence[str]) -> Mapping[tuple, list[Row]]:
    maps: dict[tuple, list[Row]] = {}
    for row in rows:
        maps.setdefault(tuple(row[name] for name in varied), []).append(row)
    return maps


def _paper(method: str, number: int) -> Sequence[float]:
    theirs = PAPER.get(method, ())
    return theirs[number] if number < len(theirs) else ()


def _write(value: float) -> str:
    return f"{value:.3f}" if value >= 0.1 else f"{value:.4f}"
