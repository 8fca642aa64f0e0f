"""The reports "seeds", "maps" and "concave": folded maps, initial maps, and rooms without straight drives."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib.colors import Normalize
from matplotlib.figure import Figure as Picture

from deepgps.config.methods import colour_of, title_of
from deepgps.evaluation.error_field import find_rms, read_fields
from deepgps.evaluation.measures import measure_visible
from deepgps.reports.plots import add_scale, count_by_decades, print_error_field
from deepgps.reports.table import tabulate
from deepgps.reports.targets import Figure, median_of, share_of, write
from deepgps.studies.reports.columns import FLIPPED, IN_CM, Column, Line, form, is_folded, tabulate_lines
from deepgps.studies.reports.compare import report as report_comparison
from deepgps.studies.reports.rooms import name_room
from deepgps.studies.table import Row, split_by, split_by_label
from sim.recording.format import open_truth

MIRRORED_M2 = 0.1
"""A map is mirrored in part if the largest connected patch that it turns over has more than this area [m^2]."""
NOISE, SLIP = "encoder.step_noise", "encoder.slip_per_m"
SEEDS_NOTE = (
    f"A map is folded if it flips more than {write(FLIPPED, '%')} of the test grid's neighbourhoods; "
    "said to be: how many maps the detector reports as unfolded. Errors are medians over the maps."
)
MAPS_NOTE = (
    "RMS errors of the initial map at the training images, after a rigid alignment, and the error that the map's own "
    "covariance expects. NEES / 2: squared error over that covariance; 1 if the covariance is right, larger if the map "
    f"is too sure. Mirrored: maps with a connected patch of more than {MIRRORED_M2:g} m2 of reversed neighbourhoods. "
    "Methods without a map by compass are left out."
)
SHAPE = "room.shape"
EDGES = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 1.0)
"""Edges of the bins of reach, as shares of the floor, into which positions are sorted."""
LITTLE, BINS = 2, len(EDGES) - 1
"""Number of leading bins that count as reaching little of the room, and of all bins."""
CONCAVE_NOTE = (
    "Reach: share of the accessible floor that the robot can reach from a position by one straight drive. Positions "
    "of all rooms are pooled; errors are for the worst heading. PoseNet learns from true positions, so errors that "
    "both methods make are not due to a lack of straight paths."
)


def is_mirrored(row: Row) -> bool:
    """Whether a connected patch of the map larger than ``MIRRORED_M2`` is turned over."""
    return row["map_flipped_m2"] > MIRRORED_M2


def _write_flipped(take):
    def write_share(line: Line) -> str:
        flipped = _list_flipped(line.rows)
        return write(float(take(flipped)) if flipped else None, "%")

    return write_share


def _count_unfolded(line: Line) -> str:
    flipped = _list_flipped(line.rows)
    return str(sum(share <= FLIPPED for share in flipped)) if flipped else "-"


MAPS = Column("maps", lambda line: str(len(line.rows)))
OF_SEEDS = (
    MAPS,
    Column("unfolded", _count_unfolded),
    Column("said to be", lambda line: str(sum(not row["fold_found"] for row in line.rows))),
    Column("flipped, median", _write_flipped(np.median)),
    Column("flipped, most", _write_flipped(np.max)),
    *IN_CM,
)
OF_ENCODERS = (
    MAPS,
    Column("RMS, median [cm]", form("map_rms_m", ".2f", 100)),
    Column("RMS, worst [cm]", lambda line: form("map_rms_m", ".2f", 100)(line._replace(take=np.max))),
    Column("expected [cm]", form("map_expected_rms_m", ".2f", 100)),
    Column("NEES / 2", form("map_nees", ".2f")),
    Column("mirrored", lambda line: f"{sum(map(is_mirrored, line.rows))} of {len(line.rows)}"),
)
OF_MAPS = (
    Column("RMS [cm]", form("map_rms_m", ".2f", 100)),
    Column("expected [cm]", form("map_expected_rms_m", ".2f", 100)),
    Column("NEES / 2", form("map_nees", ".2f")),
    Column("mirrored [m2]", form("map_flipped_m2", ".2f")),
)


def report_seeds(rows: Sequence[Row], varied: Sequence[str]) -> list[str]:
    """A table with a line for each kind of start, and a note on how to read it."""
    starts = _group_starts(rows, varied).items()
    return [
        tabulate_lines(["start"], [Line((name,), group, take=np.median) for name, group in starts], OF_SEEDS),
        SEEDS_NOTE,
    ]


def measure_seeds(rows: Sequence[Row]) -> dict[str, Figure]:
    """Share of unfolded maps, except random starts, which are meant to fold; and the detector's rates over all maps."""
    rows = [row for row in rows if row["fold_found"] is not None and row["flipped"] is not None]
    own = [not is_folded(row) for row in rows if row.get("learn.start") != "random"]
    folded, right = ([row["fold_found"] for row in rows if is_folded(row) == wrong] for wrong in (True, False))
    return {
        "unfolded": share_of(f"unfolded, of {len(own)} maps without random starts", own),
        "found": share_of(f"folds found, of {len(folded)}", folded),
        "false_alarms": share_of(f"false alarms, of {len(right)} unfolded maps", right, at_least=False),
    }


def draw_seeds(rows: Sequence[Row], varied: Sequence[str], folder: Path) -> Picture:
    """Draw what the detector measures over the truth, with a point for each map."""
    picture = Picture(figsize=(9, 4), layout="constrained")
    signs = {"length_error_fraction": "length errors", "overlap_fraction": "overlap"}
    for index, (sign, title) in enumerate(signs.items()):
        axes = picture.add_subplot(1, 2, index + 1)
        for start, group in _group_starts(rows, varied).items():
            known = [row for row in group if row["flipped"] is not None]
            flipped, said = ([100 * row[name] for row in known] for name in ("flipped", sign))
            axes.plot(flipped, said, "o", alpha=0.6, label=start)
        axes.axvline(100 * FLIPPED, color="#999999", linestyle=":")
        axes.set(xlabel="flipped (truth) [%]", ylabel=f"{title} (detector) [%]", xlim=(0, 50))
        axes.set_ylim(bottom=0)
        axes.grid(alpha=0.25)
        if index == 0:
            axes.legend(frameon=False, fontsize=8)
    return picture


def report(rows: Sequence[Row], varied: Sequence[str]) -> list[str]:
    """A line for each encoder over all rooms, a note, and a line for each map."""
    rows = _take_maps(rows)
    encoders = [Line((name,), group, take=np.median) for name, group in split_by_label(rows, _name_encoder).items()]
    places = [name for name in varied if name not in (NOISE, SLIP)]
    maps = [Line((name_room(row, places), str(row["seed"]), _name_encoder(row)), [row]) for row in rows]
    table = tabulate_lines(["encoder"], encoders, OF_ENCODERS)
    return [table, MAPS_NOTE, tabulate_lines(["room", "seed", "encoder"], maps, OF_MAPS)]


def measure(rows: Sequence[Row]) -> dict[str, Figure]:
    """How many maps are mirrored in part; and for each encoder the median RMS and NEES / 2."""
    rows = _take_maps(rows)
    mirrored = sum(map(is_mirrored, rows))
    figures = {"mirrored": Figure(f"maps mirrored in part, of {len(rows)}", mirrored, "count")}
    for name, group in split_by_label(rows, _name_encoder).items():
        for part, title, unit in (("rms_m", "RMS of the map", "cm"), ("nees", "NEES / 2", "")):
            values = [row[f"map_{part}"] for row in group]
            figures[f"{part} {name}"] = median_of(f"{title}, {name}", values, unit)
    return figures


def draw(rows: Sequence[Row], varied: Sequence[str], folder: Path) -> Picture:
    """Draw each map's error against the error that it expects of itself, a colour for each encoder."""
    picture = Picture(figsize=(5.5, 5), layout="constrained")
    axes = picture.add_subplot()
    for name, group in split_by_label(_take_maps(rows), _name_encoder).items():
        errors = 100 * np.array([(row["map_expected_rms_m"], row["map_rms_m"]) for row in group])
        axes.plot(*errors.T, "o", alpha=0.7, label=name)
    limits = np.array([axes.get_xlim(), axes.get_ylim()])
    ends = [max(limits.min(), 0.05), limits.max()]
    axes.plot(ends, ends, color="0.6", lw=1, zorder=0, label="as expected")
    axes.set(xscale="log", yscale="log", xlabel="expected RMS error [cm]", ylabel="RMS error [cm]")
    for axis in (axes.xaxis, axes.yaxis):
        count_by_decades(axis)
    axes.grid(alpha=0.25, which="both")
    axes.legend(frameon=False)
    return picture


def add_reach(run: Path, row: Row) -> Row:
    """A column for each bin of reach: the errors of all its positions [m]."""
    field = read_fields(run)[row["method"]]
    part = np.digitize(measure_visible(open_truth(run / "recording").free_space, field.truth), EDGES[1:-1])
    return {f"errors_{number}_m": field.error[part == number].astype(np.float32) for number in range(BINS)}


def pool(rows: Sequence[Row], parts: Sequence[int] = range(BINS)) -> np.ndarray:
    """Errors (n,) [m] of all positions of these rows in these bins of reach."""
    return np.concatenate([np.asarray(row[f"errors_{part}_m"], float) for row in rows for part in parts])


def report_concave(rows: Sequence[Row], varied: Sequence[str]) -> list[str]:
    """A table with a line for each shape and method, then one with a line for each bin of reach."""
    groups = split_by(rows, "method")
    headings = ["reach", "positions"]
    headings += [f"{title_of(name)}, {title} [cm]" for title in ("RMS", "median") for name in groups]
    cells = []
    for part, (low, high) in enumerate(pairwise(EDGES)):
        errors = [pool(group, [part]) for group in groups.values()]
        if len(errors[0]):
            figures = [f"{100 * one:.1f}" for one in (*map(find_rms, errors), *map(np.median, errors))]
            cells.append([f"{100 * low:.0f}-{100 * high:.0f} %", str(len(errors[0])), *figures])
    return [*report_comparison(rows, varied), tabulate(headings, cells), CONCAVE_NOTE]


def measure_concave(rows: Sequence[Row]) -> dict[str, Figure]:
    """How much larger each method's RMS is where little is reached than elsewhere, and in two rooms than in one."""
    figures = {}
    for method, group in split_by(rows, "method").items():
        little, rest = pool(group, range(LITTLE)), pool(group, range(LITTLE, BINS))
        title = f"{title_of(method)}, RMS where reach is below {write(EDGES[LITTLE], '%')} / elsewhere"
        ratio = find_rms(little) / find_rms(rest) if len(little) and len(rest) else None
        figures[f"{method}_little"] = Figure(title, ratio, "")
        shapes = split_by(group, SHAPE)
        if {"two_rooms", "rectangle"} <= set(shapes):
            two, one = (find_rms(pool(shapes[name])) for name in ("two_rooms", "rectangle"))
            title = f"{title_of(method)}, RMS in two rooms / in a rectangle"
            figures[f"{method}_two_rooms"] = Figure(title, two / one, "")
    return figures


def draw_concave(rows: Sequence[Row], varied: Sequence[str], folder: Path) -> Picture:
    """Draw RMS (filled) and median (open) by how much of the floor is reached."""
    middles = [50 * (low + high) for low, high in pairwise(EDGES)]
    picture = Picture(figsize=(6.4, 3.8), layout="constrained")
    axes = picture.add_subplot()
    for method, group in split_by(rows, "method").items():
        errors = {middle: error for part, middle in enumerate(middles) if len(error := pool(group, [part]))}
        colour, title = colour_of(method), title_of(method)
        rms, median = ([100 * take(error) for error in errors.values()] for take in (find_rms, np.median))
        axes.plot(list(errors), rms, "o-", color=colour, label=f"{title}, RMS")
        axes.plot(list(errors), median, "o--", color=colour, mfc="none", label=f"{title}, median")
    axes.set(yscale="log", xlim=(0, 100), ylabel="error of the worst heading [cm]")
    axes.set_xlabel("share of the floor reached by straight drives [%]")
    count_by_decades(axes.yaxis)
    axes.grid(alpha=0.25, which="both")
    axes.legend(frameon=False, fontsize=8)
    return picture


def draw_shapes(rows: Sequence[Row], varied: Sequence[str], folder: Path) -> Picture:
    """Draw a room of each shape: how much of it each position reaches, and DeepGPS's error there."""
    shapes = split_by([row for row in rows if row["method"] == "deepgps"], SHAPE)
    picture = Picture(figsize=(9.6, 2.9 * len(shapes) + 0.2), layout="constrained")
    panels = picture.subplots(len(shapes), 2, squeeze=False, sharex=True, sharey=True)
    dots = None
    for (left, right), (shape, (row, *_)) in zip(panels, shapes.items(), strict=True):
        run = folder / "runs" / row["run"]
        field = print_error_field(right, run, "deepgps")
        right.set_title(f"{shape}: RMS {100 * row['rms_m']:.1f} cm", fontsize=9)
        visible = measure_visible(open_truth(run / "recording").free_space, field.truth)
        dots = left.scatter(*field.truth.T, s=6, c=100 * visible, norm=Normalize(0, 100), cmap="viridis", linewidths=0)
        left.set_title(f"{shape}: reach", fontsize=9)
        left.set(aspect="equal", ylabel="y [m]")
    if dots is not None:
        label = "share of the floor reached [%]"
        picture.colorbar(dots, ax=list(panels[:, 0]), shrink=0.5, label=label, location="left")
    add_scale(picture, list(panels[:, 1]))
    return picture


def _list_flipped(rows: Sequence[Row]) -> list[float]:
    return [row["flipped"] for row in rows if row["flipped"] is not None]


def _group_starts(rows: Sequence[Row], varied: Sequence[str]) -> Mapping[str, list[Row]]:
    names = [name for name in varied if name != "learn.seed"]
    ours = [row for row in rows if row["fold_found"] is not None]
    return split_by_label(ours, lambda row: ", ".join(f"{name} {row[name]}" for name in names) or "all")


def _take_maps(rows: Sequence[Row]) -> list[Row]:
    return [row for row in rows if row["map_rms_m"] is not None]


def _name_encoder(row: Row) -> str:
    noise, slip = row.get(NOISE) or 0.0, row.get(SLIP) or 0.0
    faults = [f"{word} {value:g}" for word, value in (("w", noise), ("slip", slip)) if value]
    return ", ".join(faults) or "exact"
