"""The report "encoder": what faults cost as they grow, what theory predicts for them, and which encoder is enough."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Picture

from deepgps.config.methods import colour_of, title_of
from deepgps.evaluation.error_field import read_fields
from deepgps.reports.plots import count_by_decades, draw_band
from deepgps.reports.run_report import read_metrics
from deepgps.reports.table import tabulate
from deepgps.reports.targets import Figure, compare_means, mean_of
from deepgps.studies.reports.columns import Column, Line, form, is_folded, tabulate_lines
from deepgps.studies.table import Row, find_methods, mean, split_by, split_by_label, varied_in
from sim.sensors.encoder import FAULTS
from sim.settings import EncoderSettings, RobotSettings

Names = tuple[str, ...]
UNEQUAL_WHEELS = "robot.wheel_radius_error"
PERFECT = {
    **{f"encoder.{name}": value for name, value in EncoderSettings().model_dump().items()},
    UNEQUAL_WHEELS: RobotSettings().wheel_radius_error,
}
"""Settings of encoders and wheels, and their values without faults."""
FEWER_IS_WORSE = "encoder.ticks_per_rev"
TITLES: dict[Names, str] = {
    (FEWER_IS_WORSE,): "ticks per revolution",
    ("encoder.radius_error_left",): "error of one wheel's radius",
    **{tuple(f"encoder.{name}" for name in fault.settings): fault.title for fault in FAULTS},
    (UNEQUAL_WHEELS,): "left wheel larger by this part: the robot curves",
}
NOISE, STUCK = "encoder.step_noise", "encoder.stuck_fraction"
STRONG = {"w": (NOISE, 0.3), "radius": ("encoder.radius_error_left", 0.01), "slip": ("encoder.slip_per_m", 0.1)}
"""Faults under which the compass is compared with DeepGPS, which ignores turns, by the names of the figures."""
STUCK_HALF, CURVES = 0.5, (0.01, 0.03)
NEAR_M = (0.02, 0.05)
"""Errors that count as good enough, for two kinds of builders [m]."""
EXPECTED = "map_expected_rms_m"
"""Column for the RMS that an initial map expects of itself [m]; None: the method's map knows none."""
PART = 0.8
"""The part of the test positions whose errors must be good enough."""
CHOICE = (
    f"The strongest fault at which at least {100 * PART:g} % of the test positions, each at its worst heading, are "
    "still within this distance of the truth (mean over seeds). RMS is not the criterion, since it is dominated by a "
    "few positions with large errors that no encoder can reduce."
)
NOTE = (
    "RMS in centimetres for the worst heading of each test position: mean, minimum and maximum over seeds. Near: share "
    f"of the test positions with errors within {100 * NEAR_M[0]:g} cm. Aligned on training samples, never scaled. "
    "Segment: RMS error of the lengths of complete segments, measured and predicted by theory (rounding is uniform "
    "within a tick; the error from w grows with the root of the number of gaps, slip with the root of the distance "
    "travelled, a radius error in proportion to it; a stuck encoder halves the distance). The error that remains "
    "without faults is due to the wheels creeping on the floor. A map can be more accurate than its segments because "
    "many segments cross each place and their errors average out. It is less accurate if all segments have the same "
    "error, or if segments are so accurate that the network and poorly covered places limit the map."
)
EXPLAIN = (
    "Rounding should hardly matter while a tick is short compared with the spacing of images, since the phases of the "
    "ticks differ.",
    "A radius error on both wheels enlarges the map by the same fraction, and an error on one wheel by half of it. The "
    "position error is that fraction of the distance from the middle of the room, and only the scale of the map shows "
    "it; no method without known positions can detect it.",
    "Distances along segments depend neither on the track width nor on turns, so errors in these affect only dead "
    "reckoning. Faults that make the wheels differ corrupt the dead-reckoned path and, if the path drifts farther than "
    "loop closures can correct, also the map that starts from it.",
    "When readings are lost, DeepGPS loses their images, but the distances between the remaining ones stay correct. "
    "PoseNet still learns from all images, but the features that both methods use are chosen along the segments, whose "
    "images are then farther apart.",
)


class Sweep(NamedTuple):
    """Rows in which one fault grows from zero.

    Attributes:
        names: Settings that grow together.
        rows: Measured rows of all methods and seeds, at each value.
    """

    names: Names
    rows: list[Row]

    @property
    def title(self) -> str:
        """The fault that grows, in words."""
        return TITLES[self.names]

    def by_value(self, method: str) -> dict[float, list[Row]]:
        """Rows of a method by the value of the fault, the smallest fault first."""
        rows = split_by([row for row in self.rows if row["method"] == method], self.names[0])
        sign = -1 if self.names[0] == FEWER_IS_WORSE else 1
        return dict(sorted(rows.items(), key=lambda one: sign * abs(one[0])))


def find_sweeps(rows: Sequence[Row]) -> list[Sweep]:
    """A sweep for every fault that grows alone, including the rows without any fault."""
    groups = split_by_label(rows, _list_changed)
    perfect = groups.get((), [])
    # both radii grow together only where they are the same
    return [
        Sweep(names, [*perfect, *(row for row in groups[names] if len(set(_values(row, names))) == 1)])
        for names in TITLES
        if names in groups
    ]


def find_pairs(rows: Sequence[Row]) -> list[Names]:
    """Every pair of faults that vary together but are not one sweep."""
    pairs = sorted({names for row in rows if len(names := _list_changed(row)) == 2})
    return [pair for pair in pairs if pair not in TITLES]


def split_by_values(rows: Sequence[Row], names: Names) -> dict[tuple[float, ...], list[Row]]:
    """Rows of a pair of faults by their values: both faults set, each of these values alone, and no fault."""
    both = [_values(row, names) for row in rows if _list_changed(row) == names]
    asked = [{PERFECT[name], *(values[place] for values in both)} for place, name in enumerate(names)]
    ours = [
        row
        for row in rows
        if set(_list_changed(row)) <= set(names)
        and all(value in known for value, known in zip(_values(row, names), asked, strict=True))
    ]
    return dict(sorted(split_by_label(ours, lambda row: _values(row, names)).items()))


def measure(rows: Sequence[Row]) -> dict[str, Figure]:
    """Both variants of DeepGPS at w = 0.10, 16 and 4 ticks; the compass beside DeepGPS, stuck, and on curves."""
    sweeps, figures = {sweep.names: sweep for sweep in find_sweeps(rows)}, {}

    def find(method: str, setting: str, value: float) -> list[Row]:
        """A method's rows in which this setting alone has this value; none if nothing else was measured."""
        return sweeps[setting,].by_value(method).get(value, []) if (setting,) in sweeps else []

    for method, prefix in (("deepgps", ""), ("deepgps_noise_aware", "aware_")):
        title, perfect = title_of(method), find(method, FEWER_IS_WORSE, PERFECT[FEWER_IS_WORSE])
        if group := find(method, NOISE, 0.1):
            figures[f"{prefix}rms_w"] = mean_of(f"RMS at w = 0.10, {title}", [row["rms_m"] for row in group], "cm")
        for ticks in (16, 4):
            if (group := find(method, FEWER_IS_WORSE, ticks)) and perfect:
                words = f"RMS at {ticks} ticks / perfect, {title}"
                figures[f"{prefix}ticks_{ticks}"] = compare_means(words, group, perfect, "rms_m")
    method = "deepgps_compass"
    title = title_of(method)
    for key, (setting, value) in STRONG.items():
        ours, alone = (find(name, setting, value) for name in (method, "deepgps"))
        if ours and alone:
            words = f"{title}: RMS / {title_of('deepgps')}'s, {TITLES[(setting,)]} {value:g}"
            figures[f"compass_{key}"] = compare_means(words, ours, alone, "rms_m")
    if stuck := find(method, STUCK, STUCK_HALF):
        words = f"{title}: RMS, one encoder stuck for half of the drive"
        figures["compass_stuck_rms_m"] = mean_of(words, [row["rms_m"] for row in stuck], "cm")
        words = f"{title}: maps folded of {len(stuck)}, one encoder stuck for half of the drive"
        figures["compass_stuck_folded"] = Figure(words, sum(map(is_folded, stuck)), "count")
    straight = find(method, UNEQUAL_WHEELS, 0.0)
    for value in CURVES:
        if (group := find(method, UNEQUAL_WHEELS, value)) and straight:
            words = f"{title}: median / without faults, left wheel larger by {100 * value:g} %"
            figures[f"compass_curves_{100 * value:g}"] = compare_means(words, group, straight, "median_m")
    return figures


def _values(row: Row, names: Names) -> tuple[float, ...]:
    return tuple(row[name] for name in names)


def _list_changed(row: Row) -> Names:
    return tuple(sorted(name for name in varied_in(row) if name in PERFECT and row[name] != PERFECT[name]))


def report(rows: Sequence[Row], varied: Sequence[str]) -> list[str]:
    """A page for choosing encoders: what is good enough, then each fault, pairs of faults, and what theory says."""
    methods, sweeps, blocks = find_methods(rows), find_sweeps(rows), []
    for near in NEAR_M:
        title = f"## Which encoder keeps most of the room within {100 * near:g} cm"
        blocks += [title, choose_encoders(sweeps, methods, near)]
    blocks.append(CHOICE)
    for sweep in sweeps:
        blocks += [f"## {_capital(sweep.title)}", tabulate_sweep(sweep, methods)]
    for pair in find_pairs(rows):
        title = " with ".join(TITLES.get((name,), name) for name in pair)
        blocks += [f"## {_capital(title)}", _tabulate_pair(rows, pair)]
    return [*blocks, "## What theory says", NOTE, "\n".join(f"- {sentence}" for sentence in EXPLAIN)]


def add_errors(run: Path, row: Row) -> Row:
    """Columns for the part of test positions with small errors, errors of complete segments, and doubted segments."""
    error = read_fields(run)[row["method"]].error
    near = {name_part(near): float(np.mean(error <= near)) for near in NEAR_M}
    return {**near, **read_metrics(run)["distances"]}


def name_part(near_m: float) -> str:
    """The name of the column for the part of the test positions with errors of at most ``near_m`` [m]."""
    return f"within_{100 * near_m:g}_cm"


def choose_encoders(sweeps: Sequence[Sweep], methods: Sequence[str], near_m: float) -> str:
    """For each fault, the greatest measured strength up to which ``PART`` of the positions stay within ``near_m``."""
    cells = [
        [sweep.title, *(_strongest(sweep.by_value(method), sweep.names[0], name_part(near_m)) for method in methods)]
        for sweep in sweeps
    ]
    return tabulate(["fault", *map(title_of, methods)], cells)


def tabulate_sweep(sweep: Sweep, methods: Sequence[str]) -> str:
    """A line for each value: errors of segments and of every method, the map's scale, and segments doubted."""
    groups = {method: sweep.by_value(method) for method in methods}
    lines = [Line((f"{value:g}",), rows) for value, rows in groups[methods[0]].items()]
    columns = [
        Column("segment [cm]", form("segment_rms_m", ".2f", 100)),
        Column("expected [cm]", form("segment_expected_m", ".2f", 100)),
        *(
            Column(_head(method), lambda line, by=groups[method]: _write_errors(by[line.rows[0][sweep.names[0]]]))
            for method in methods
        ),
        Column(f"scale of {title_of(methods[0])}", form("scale", ".4f")),
        Column(
            "found / wrong",
            lambda line: " / ".join(f"{mean(line.rows, name):.0f}" for name in ("wrong_doubted", "segments_wrong")),
        ),
    ]
    return tabulate_lines([_last(sweep.names[0])], lines, columns)


def draw(rows: Sequence[Row], varied: Sequence[str], folder: Path) -> Picture:
    """Draw a panel for each fault: every method's RMS with a band of seeds, and segment errors next to theory's."""
    return _draw_panels(rows, _draw_errors, "error [cm]")


def draw_near(rows: Sequence[Row], varied: Sequence[str], folder: Path) -> Picture:
    """Draw a panel for each fault: the part of the test positions with small errors, with a band of seeds."""
    return _draw_panels(rows, _draw_near, f"positions within {100 * NEAR_M[0]:g} cm [%]")


def _write_errors(rows: Sequence[Row]) -> str:
    low, high = (f"{100 * take(row['rms_m'] for row in rows):.1f}" for take in (min, max))
    return f"{100 * mean(rows, 'rms_m'):.1f} ({low} to {high}), {100 * mean(rows, name_part(NEAR_M[0])):.0f} %"


def _tabulate_pair(rows: Sequence[Row], pair: Names) -> str:
    """Errors of every method with both faults, with each alone, and with none."""
    methods, cells = find_methods(rows), []
    for values, group in split_by_values(rows, pair).items():
        ours = split_by(group, "method")
        cells.append([*(f"{value:g}" for value in values), *(_write_errors(ours[method]) for method in methods)])
    return tabulate([*map(_last, pair), *map(_head, methods)], cells)


def _strongest(groups: Mapping[float, Sequence[Row]], name: str, part: str) -> str:
    good = []
    for value, group in groups.items():
        if mean(group, part) < PART:
            break
        good.append(value)
    if not good:
        return "none is enough"
    if len(good) == len(groups):
        return f"all, to {good[-1]:g}"
    return f"{good[-1]:g}" if name == FEWER_IS_WORSE or len(good) > 1 else "none tolerated"


def _capital(title: str) -> str:
    return title[0].upper() + title[1:]


def _head(method: str) -> str:
    return f"{title_of(method)} (of seeds), near"


def _last(setting: str) -> str:
    return setting.rpartition(".")[2]


def _draw_panels(rows: Sequence[Row], draw_one: Callable[[Axes, Sweep], None], ylabel: str) -> Picture:
    sweeps = find_sweeps(rows)
    columns = min(4, max(1, len(sweeps)))
    lines = max(1, -(-len(sweeps) // columns))
    picture = Picture(figsize=(3.3 * columns + 0.3, 2.9 * lines + 0.8), layout="constrained")
    panels = list(picture.subplots(lines, columns, squeeze=False, sharey=True).flat)
    for axes, sweep in zip(panels, sweeps, strict=False):
        draw_one(axes, sweep)
        axes.set_xlabel(sweep.title)
        axes.grid(alpha=0.25)
    for axes in panels[len(sweeps) :]:
        axes.set_axis_off()
    for axes in panels[::columns]:
        axes.set_ylabel(ylabel)
    named = {line.get_label(): line for axes in panels for line in axes.lines}
    picture.legend(list(named.values()), list(named), loc="outside upper center", frameon=False, fontsize=8, ncols=4)
    return picture


def _draw_errors(axes: Axes, sweep: Sweep) -> None:
    _draw_methods(axes, sweep, "rms_m")
    groups = sweep.by_value(find_methods(sweep.rows)[0])
    for name, style, label in (
        ("segment_expected_m", "k:", "one segment, theory"),
        ("segment_rms_m", "kx", "one segment, measured"),
    ):
        values = [100 * mean(group, name) for group in groups.values()]
        axes.plot(range(len(groups)), values, style, markersize=5, label=label)
    for method in find_methods(sweep.rows):
        groups = sweep.by_value(method)
        if all(row.get(EXPECTED) is not None for group in groups.values() for row in group):
            values = [100 * mean(group, EXPECTED) for group in groups.values()]
            label = f"{title_of(method)}: expected by its map"
            axes.plot(range(len(groups)), values, ":", color=colour_of(method), label=label)
    axes.set_yscale("log")
    count_by_decades(axes.yaxis)


def _draw_near(axes: Axes, sweep: Sweep) -> None:
    _draw_methods(axes, sweep, name_part(NEAR_M[0]))
    axes.axhline(100 * PART, color="k", linestyle=":", label="good enough")
    axes.set_ylim(0, 100)


def _draw_methods(axes: Axes, sweep: Sweep, name: str) -> None:
    """Draw each method's mean over seeds, times 100, and a band from the least to the greatest."""
    for method in find_methods(sweep.rows):
        groups, colour = sweep.by_value(method), colour_of(method)
        seeds = [[100 * row[name] for row in group] for group in groups.values()]
        place = range(len(groups))
        draw_band(axes, place, seeds, colour, title_of(method), marker=3)
        # evenly spaced: some faults grow by factors and others by steps
        axes.set_xticks(place, [f"{value:g}" for value in groups], fontsize=8)
