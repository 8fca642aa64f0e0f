"""The report "compare": means over seeds of runs and rooms, for each combination of other settings and each method."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib.figure import Figure as Picture

from deepgps.config.methods import colour_of, title_of
from deepgps.reports.field_plot import add_scale, print_error_field
from deepgps.reports.style import count_by_decades
from deepgps.reports.table import tabulate
from deepgps.studies.grouping import choices, describe, group_rows, shorten
from deepgps.studies.reports.seeds import count_folded
from deepgps.studies.table import (
    ACCEPTED_NOTE,
    ERRORS,
    Row,
    choose_accepted,
    is_seed,
    mean,
    write_accepted,
    write_errors,
)

NOTE = (
    "Means over runs that differ only in their seeds. Errors on the test grid, for the worst heading of each position; "
    "aligned on training samples, never scaled. Headings: RMS distance of the predictions at one position from their "
    "mean. Folded: maps that flip more than a tenth of the neighbourhoods; said: maps that the detector, which does "
    "not use the truth, reports as folded."
)


def report(rows: Sequence[Row], varied: Sequence[str], also: Mapping[str, str] | None = None) -> list[str]:
    """A table with a line for each group, and a note on how to read it.

    Args:
        rows: Measured rows.
        varied: Names that vary.
        also: Headings of additional columns [m], which are written in centimetres.
    """
    more = {"heading_spread_m": "headings [cm]", **(also or {})}
    names = choices(rows, varied)
    kinds, accepted = shorten(names), choose_accepted(rows)
    ours = [
        "runs",
        "images",
        "travel [m]",
        *ERRORS.values(),
        "worst RMS",
        *accepted.values(),
        *more.values(),
        "folded",
        "said",
        "train [s]",
    ]
    cells = []
    for key, group in group_rows(rows, names).items():
        *kind, method = key
        means = {name: mean(group, name) for name in ("samples", "distance_m", *ERRORS, "train_s")}
        worst = f"{100 * max(row['rms_m'] for row in group):.1f}"
        spreads = ["-" if group[0][name] is None else f"{100 * mean(group, name):.3g}" for name in more]
        finder = group[0]["fold_found"] is not None
        folded = [count_folded(group), str(sum(row["fold_found"] for row in group) if finder else "-")]
        driven = [f"{means['samples']:.0f}", f"{means['distance_m']:.0f}"]
        errors = [*write_errors(means), worst, *write_accepted(group, accepted)]
        figures = [*driven, *errors, *spreads, *folded, f"{means['train_s']:.0f}"]
        cells.append([*kind, title_of(method), str(len(group)), *figures])
    follow = [name for name in varied if names and name not in names and not is_seed(name)]
    dependent = [f"Dependent settings: {'; '.join(_tell(rows, names, name) for name in follow)}."] if follow else []
    return [tabulate([*kinds, "method", *ours], cells), *dependent, NOTE, *([ACCEPTED_NOTE] if accepted else [])]


def draw(rows: Sequence[Row], varied: Sequence[str], folder: Path) -> Picture:
    """Draw RMS (filled) and median (open) of every run, with a line for each group."""
    names = choices(rows, varied)
    groups = group_rows(rows, names)
    picture = Picture(figsize=(7.6, 1.2 + 0.32 * len(groups)), layout="constrained")
    axes = picture.add_subplot()
    for place, (key, group) in enumerate(groups.items()):
        colour = colour_of(key[-1])
        for name, inside in (("rms_m", colour), ("median_m", "none")):
            axes.plot([100 * row[name] for row in group], [place] * len(group), "o", color=colour, mfc=inside)
    axes.set_yticks(range(len(groups)), [describe(key, names) for key in groups])
    axes.set(xscale="log", ylim=(len(groups) - 0.5, -0.5))
    axes.set_xlabel("error of the worst heading [cm]\nfilled: RMS, open: median")
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
        axes.set_title(f"{describe(key, names)}\nRMS {100 * row['rms_m']:.1f} cm", fontsize=9)
    for axes in panels[len(groups) :]:
        axes.set_axis_off()
    add_scale(picture, panels)
    return picture


def _tell(rows: Sequence[Row], names: Sequence[str], follows: str) -> str:
    """Values of a setting that follows from choices, each with them: ``learn.start paths (dense), ends (endpoint)``."""
    # the fewest leading choices from which the setting follows
    few = next(names[: k + 1] for k in range(len(names)) if choices(rows, [*names[: k + 1], follows])[-1] != follows)
    with_value: dict[str, dict[str, None]] = {}
    for row in rows:
        key = " ".join(str(row[name]) for name in few)
        with_value.setdefault(str(row[follows]), {})[key] = None
    return f"{follows} " + ", ".join(f"{value} ({'; '.join(keys)})" for value, keys in with_value.items())
