"""The reports "plain", "compare", "networks" and "strategies": runs side by side, or means over their seeds."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure as Picture

from deepgps.config.methods import colour_of, folder_of, title_of
from deepgps.evaluation.evaluate import measure_heading_spread
from deepgps.positioner.positioner import Positioner
from deepgps.positioner.stored_positioner import load_positioner
from deepgps.reports.plots import add_scale, count_by_decades, print_error_field
from deepgps.reports.targets import Figure, compare_means, mean_of
from deepgps.studies.reports.columns import (
    FOLDED,
    IN_CM,
    OF_ACCEPTED,
    RUNS,
    TRAIN,
    Column,
    Line,
    explain_accepted,
    form,
    lines_of_rows,
    tabulate_lines,
    write_worst,
)
from deepgps.studies.table import Row, choices, describe_group, find_methods, group_rows, is_seed, shorten, split_by
from sim.recording.format import open_recording

NOTE = (
    "Means over runs that differ only in their seeds. Errors on the test grid, for the worst heading of each position; "
    "aligned on training samples, never scaled. Headings: RMS distance of the predictions at one position from their "
    "mean. Folded: maps that flip more than a tenth of the neighbourhoods; said: maps that the detector, which does "
    "not use the truth, reports as folded."
)
DRIVEN = (Column("images", form("samples", ".0f")), Column("travel [m]", form("distance_m", ".0f")))
HEADINGS = Column("headings [cm]", form("heading_spread_m", ".3g", 100))
TURNED = Column("turned [cm]", form("turn_spread_m", ".3g", 100))
TURNED_NOTE = (
    "Turned: RMS distance from their mean of the predictions for one test image turned by every whole number of "
    "sectors; unlike the spread over headings, it excludes the effects of rendering."
)
NETWORK, SHIFT = "learn.network.architecture", "learn.train.shift"
STRATEGY, SAMPLES = "drive.strategy", "drive.samples"
TURNED_IMAGES = 30


def report_runs(rows: Sequence[Row], varied: Sequence[str]) -> list[str]:
    """A table with one line for each run and method."""
    table = tabulate_lines([*varied, "method"], lines_of_rows(rows, *varied), (*IN_CM, *OF_ACCEPTED))
    return [table, *explain_accepted(rows)]


def report(rows: Sequence[Row], varied: Sequence[str], also: Sequence[Column] = ()) -> list[str]:
    """A table with a line for each combination of choices and each method, and a note on how to read it."""
    names = choices(rows, varied)
    lines = [Line((*key[:-1], title_of(key[-1])), group) for key, group in group_rows(rows, names).items()]
    errors = (*IN_CM, Column("worst RMS", write_worst()), *OF_ACCEPTED)
    columns = (RUNS, *DRIVEN, *errors, HEADINGS, *also, *FOLDED, TRAIN)
    follow = [name for name in varied if names and name not in names and not is_seed(name)]
    dependent = [f"Dependent settings: {'; '.join(_tell(rows, names, name) for name in follow)}."] if follow else []
    table = tabulate_lines([*shorten(names), "method"], lines, columns)
    return [table, *dependent, NOTE, *explain_accepted(rows)]


def report_networks(rows: Sequence[Row], varied: Sequence[str]) -> list[str]:
    """The same, with how much the answer changes when an image is turned."""
    return [*report(rows, varied, (TURNED,)), TURNED_NOTE]


def draw(rows: Sequence[Row], varied: Sequence[str], folder: Path) -> Picture:
    """Draw RMS (filled) and median (open) of every run, with a line for each group."""
    names = choices(rows, varied)
    groups = {describe_group(key, names): group for key, group in group_rows(rows, names).items()}
    picture = draw_dots(groups, (7.6, 1.2 + 0.32 * len(groups)))
    picture.axes[0].set_xlabel("error of the worst heading [cm]\nfilled: RMS, open: median")
    return picture


def draw_dots(lines: Mapping[str, Sequence[Row]], size: tuple[float, float]) -> Picture:
    """Draw RMS (filled) and median (open) of every method, with a line for each label."""
    picture = Picture(figsize=size, layout="constrained")
    axes = picture.add_subplot()
    placed = [(place, row) for place, rows in enumerate(lines.values()) for row in rows]
    for method in find_methods(row for _, row in placed):
        colour, title = colour_of(method), title_of(method)
        places = [place for place, row in placed if row["method"] == method]
        for name, inside, word in (("rms_m", colour, "RMS"), ("median_m", "none", "median")):
            values = [100 * row[name] for _, row in placed if row["method"] == method]
            axes.plot(values, places, "o", color=colour, mfc=inside, label=f"{title}, {word}")
    axes.set_yticks(range(len(lines)), list(lines))
    axes.set(xscale="log", xlabel="error of the worst heading [cm]", ylim=(len(lines) - 0.5, -0.5))
    count_by_decades(axes.xaxis)
    axes.grid(alpha=0.25, which="both")
    return picture


def draw_fields(rows: Sequence[Row], varied: Sequence[str], folder: Path) -> Picture:
    """Draw the error field of each group's run with the median RMS."""
    names = choices(rows, varied)
    groups = group_rows(rows, names)
    columns = min(3, len(groups))
    lines = -(-len(groups) // columns)
    picture = Picture(figsize=(4.6 * columns + 0.8, 3.3 * lines + 0.3), layout="constrained")
    panels = list(picture.subplots(lines, columns, squeeze=False).flat)
    for axes, (key, group) in zip(panels, groups.items(), strict=False):
        row = sorted(group, key=lambda row: row["rms_m"])[(len(group) - 1) // 2]
        print_error_field(axes, folder / "runs" / row["run"], row["method"])
        axes.set_title(f"{describe_group(key, names)}\nRMS {100 * row['rms_m']:.1f} cm", fontsize=9)
    for axes in panels[len(groups) :]:
        axes.set_axis_off()
    add_scale(picture, panels)
    return picture


def measure_networks(rows: Sequence[Row]) -> dict[str, Figure]:
    """RMS of each network trained with shifted images, as in the paper; and the effect of the padding."""
    groups = split_by(rows, NETWORK)
    shifted = {name: [row for row in group if row.get(SHIFT, True)] for name, group in groups.items()}
    figures = {
        name: mean_of(f"RMS, {name}", [row["rms_m"] for row in group], "cm") for name, group in shifted.items() if group
    }
    for name in ("spectral", "invariant"):
        if group := groups.get(name):
            figures[f"{name}_turned"] = mean_of(f"turned, {name}", [row["turn_spread_m"] for row in group], "mm")
    plain, paper = shifted.get("resnet_plain"), shifted.get("resnet_paper")
    if plain and paper:
        for name, column, word in (("plain_ratio", "rms_m", "RMS"), ("plain_turned", "turn_spread_m", "turned")):
            title = f"{word}, resnet_plain / resnet_paper"
            figures[name] = compare_means(title, plain, paper, column, at_least=True)
    return figures


def measure_strategies(rows: Sequence[Row]) -> dict[str, Figure]:
    """Ratios of the end-point strategy to the dense one: RMS of DeepGPS, and distance travelled."""
    rows = [row for row in rows if row["method"] == "deepgps"]
    dense = [row for row in rows if row[STRATEGY] == "dense"]
    counts = {row[SAMPLES] for row in dense}
    ends = [row for row in rows if row[STRATEGY] == "endpoint"]
    same = [row for row in ends if row[SAMPLES] in counts]
    fewer = [row for row in ends if row[SAMPLES] not in counts]
    pairs = {
        "travel_ratio": ("RMS, end-point / dense, equal travel", fewer, "rms_m"),
        "samples_ratio": ("RMS, end-point / dense, equal images", same, "rms_m"),
        "way_ratio": ("travel, end-point / dense, equal images", same, "distance_m"),
    }
    return {
        name: compare_means(title, group, dense, column, at_least=True)
        for name, (title, group, column) in pairs.items()
        if dense and group
    }


def add_turn_spread(run: Path, row: Row) -> Row:
    """A column for how much a trained network's prediction changes when an image is turned."""
    images = open_recording(run / "recording").test_observation
    some = np.linspace(0, len(images) - 1, min(TURNED_IMAGES, len(images))).round().astype(int)
    return {"turn_spread_m": measure_turn_spread(load_positioner(folder_of(run, row["method"])), images[some, 0])}


def measure_turn_spread(positioner: Positioner, images: np.ndarray) -> float:
    """RMS distance [m] of predictions from their mean over all turns of each image (n, rings, sectors, 3)."""
    turned = np.stack([np.roll(images, turn, axis=2) for turn in range(images.shape[2])], axis=1)
    return measure_heading_spread(positioner(turned.reshape(-1, *images.shape[1:])).reshape(*turned.shape[:2], 2))


def _tell(rows: Sequence[Row], names: Sequence[str], follows: str) -> str:
    """Values of a setting that follows from choices, each with them: ``learn.start paths (dense), ends (endpoint)``."""
    # the fewest leading choices from which the setting follows
    few = next(names[: k + 1] for k in range(len(names)) if choices(rows, [*names[: k + 1], follows])[-1] != follows)
    with_value: dict[str, dict[str, None]] = {}
    for row in rows:
        key = " ".join(str(row[name]) for name in few)
        with_value.setdefault(str(row[follows]), {})[key] = None
    return f"{follows} " + ", ".join(f"{value} ({'; '.join(keys)})" for value, keys in with_value.items())
