"""The report of encoders: what each fault costs, beside what theory expects of it, and which encoder is good enough."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Picture

from deepgps.markdown import tabulate
from deepgps.report import method_title, read_metrics
from deepgps.studies.table import Row, mean, split_by, varied_in
from deepgps.style import LINES, count_by_decades
from deepgps.targets import Figure
from sim.settings import EncoderSettings

ENOUGH_M = 0.02
"""The RMS that decides which encoder is good enough [m]."""
CHOICE = (
    f"Up to where the RMS of at least every other drive stays within {100 * ENOUGH_M:g} cm. Not the mean: where one "
    "drive missed a nook, no encoder mends it."
)
PERFECT = EncoderSettings()
Names = tuple[str, ...]
TITLES: dict[Names, str] = {
    ("ticks_per_rev",): "ticks per revolution",
    ("gap_noise",): "noise w of each gap",
    ("slip_per_m",): "slip after a metre [m]",
    ("radius_error_left",): "error of one wheel's radius",
    ("radius_error_left", "radius_error_right"): "error of both wheels' radius",
    ("track_error",): "error of the track width",
    ("lost",): "part of the readings lost",
    ("stuck",): "part of the drive that one encoder sticks",
}
FEWER_IS_WORSE = "ticks_per_rev"
NOTE = (
    "RMS of the worst heading of each test position in centimetres, means over the seeds; aligned on training samples, "
    "never scaled. Segment: RMS error of the length of whole segments, measured and as theory expects it (uniform "
    "rounding within a tick, w growing with the root of the number of gaps, slip with the root of the way, radius in "
    "proportion, a stuck encoder taking half of the way). Where a map does better than its segments, many of them "
    "cross each place and their errors average; where it does worse, all err alike."
)
EXPLAIN = (
    "Rounding should hardly matter while a tick is short beside the spacing of images: the phases of ticks differ.",
    "A radius that is wrong on both wheels makes the map larger by as much, which costs that part of the distance from "
    "the middle of the room; it shows in the scale alone, and no method without positions can know better.",
    "Distances along segments know neither track width nor turns: only methods that use turns can be hurt by it.",
    "Lost readings are images lost to DeepGPS, and the distances of the others stay right; PoseNet learns from all.",
)


class Sweep(NamedTuple):
    """Rows in which one fault grows, from none.

    Attributes:
        names: Settings of the encoder that grow together.
        rows: What was measured, at each value, of all methods and seeds.
    """

    names: Names
    rows: list[Row]

    @property
    def title(self) -> str:
        """What grows, in words."""
        return TITLES.get(self.names, " and ".join(self.names))

    def by_value(self, method: str) -> dict[float, list[Row]]:
        """Rows of a method by the value of the fault, the least fault first."""
        rows = split_by([row for row in self.rows if row["method"] == method], f"encoder.{self.names[0]}")
        sign = -1 if self.names[0] == FEWER_IS_WORSE else 1
        return dict(sorted(rows.items(), key=lambda one: sign * abs(one[0])))


def report(rows: Sequence[Row], varied: Sequence[str]) -> list[str]:
    """A page to decide from: what is good enough, then each fault, pairs of faults, and what theory says."""
    methods, sweeps = _methods(rows), find_sweeps(rows)
    enough = tabulate(*choose_encoders(sweeps, methods))
    blocks = [f"## Which encoder keeps the RMS at {100 * ENOUGH_M:g} cm", enough, CHOICE]
    for sweep in sweeps:
        blocks += [f"## {_capital(sweep.title)}", tabulate(*tabulate_sweep(sweep, methods))]
    for pair in find_pairs(rows):
        title = " with ".join(TITLES.get((name,), name) for name in pair)
        blocks += [f"## {_capital(title)}", tabulate(*_tabulate_pair(rows, pair))]
    return [*blocks, "## What theory says", NOTE, "\n".join(f"- {sentence}" for sentence in EXPLAIN)]


def measure(rows: Sequence[Row]) -> dict[str, Figure]:
    """RMS at w = 0.10, and at 16 and 4 ticks relative to a perfect encoder, of both ways to learn."""
    figures = {}
    for method, prefix in (("deepgps", ""), ("deepgps_aware", "aware_")):
        title = method_title(method)
        for sweep in find_sweeps(rows):
            found = sweep.by_value(method)
            if sweep.names == ("gap_noise",) and 0.1 in found:
                group = found[0.1]
                worst = max(row["rms_m"] for row in group)
                figures[f"{prefix}rms_w"] = Figure(f"RMS at w = 0.10, {title}", mean(group, "rms_m"), "cm", worst=worst)
            for ticks in (16, 4) if sweep.names == (FEWER_IS_WORSE,) else ():
                if ticks in found and PERFECT.ticks_per_rev in found:
                    ratio = mean(found[ticks], "rms_m") / mean(found[PERFECT.ticks_per_rev], "rms_m")
                    figures[f"{prefix}ticks_{ticks}"] = Figure(f"RMS at {ticks} ticks / perfect, {title}", ratio, "")
    return figures


def add_distances(run: Path, row: Row) -> Row:
    """Errors of whole segments, measured and expected, and how many segments were wrong and doubted."""
    return read_metrics(run)["distances"]


def find_sweeps(rows: Sequence[Row]) -> list[Sweep]:
    """Every fault that grows alone, with the rows of no fault."""
    changed = {_changed(row) for row in rows}
    perfect = [row for row in rows if not _changed(row)]
    alone = [names for names in TITLES if names in changed]
    # both radii grow together only where they are the same
    return [
        Sweep(
            names, [*perfect, *(row for row in rows if _changed(row) == names and len(set(_values(row, names))) == 1)]
        )
        for names in alone
    ]


def find_pairs(rows: Sequence[Row]) -> list[Names]:
    """Every two faults that grow against one another."""
    pairs = sorted({names for row in rows if len(names := _changed(row)) == 2})
    return [pair for pair in pairs if pair not in TITLES]


def choose_encoders(sweeps: Sequence[Sweep], methods: Sequence[str]) -> tuple[list[str], list[list[str]]]:
    """For each fault, the strongest measured up to which the median of the seeds stays within ``ENOUGH_M``."""
    lines = [
        [sweep.title, *(_strongest(sweep.by_value(method), sweep.names[0]) for method in methods)] for sweep in sweeps
    ]
    return ["fault", *(method_title(method) for method in methods)], lines


def tabulate_sweep(sweep: Sweep, methods: Sequence[str]) -> tuple[list[str], list[list[str]]]:
    """A line for each value: errors of segments, of every method, the map's scale, and the segments doubted."""
    lines = []
    perfect = {method: mean(next(iter(sweep.by_value(method).values())), "rms_m") for method in methods}
    for value, group in sweep.by_value(methods[0]).items():
        segment = [f"{100 * mean(group, name):.2f}" for name in ("segment_rms_m", "segment_expected_m")]
        errors = []
        for method in methods:
            some = [row["rms_m"] for row in sweep.by_value(method)[value]]
            ratio = f"{np.mean(some) / perfect[method]:.2f}"
            errors.append(f"{100 * np.mean(some):.1f} ({100 * min(some):.1f} to {100 * max(some):.1f}), {ratio}")
        doubted = " / ".join(f"{mean(group, name):.0f}" for name in ("wrong_doubted", "segments_wrong"))
        lines.append([f"{value:g}", *segment, *errors, f"{mean(group, 'scale'):.4f}", doubted])
    heads = [f"{method_title(method)} (of seeds), times" for method in methods]
    scale = f"scale of {method_title(methods[0])}"
    return [sweep.names[0], "segment [cm]", "expected [cm]", *heads, scale, "found / wrong"], lines


def draw(rows: Sequence[Row], varied: Sequence[str], folder: Path) -> Picture:
    """A panel for each fault: RMS of every method with a band of the seeds, and errors of segments beside theory's."""
    sweeps, methods = find_sweeps(rows), _methods(rows)
    columns = min(4, max(1, len(sweeps)))
    lines = max(1, -(-len(sweeps) // columns))
    picture = Picture(figsize=(3.3 * columns + 0.3, 2.9 * lines + 0.8), layout="constrained")
    panels = list(picture.subplots(lines, columns, squeeze=False, sharey=True).flat)
    for axes, sweep in zip(panels, sweeps, strict=False):
        _draw_sweep(axes, sweep, methods)
    for axes in panels[len(sweeps) :]:
        axes.set_axis_off()
    for axes in panels[::columns]:
        axes.set_ylabel("error [cm]")
    named = {line.get_label(): line for axes in panels for line in axes.lines}
    picture.legend(list(named.values()), list(named), loc="outside upper center", frameon=False, fontsize=8, ncols=4)
    return picture


def _draw_sweep(axes: Axes, sweep: Sweep, methods: Sequence[str]) -> None:
    for method in methods:
        groups, colour = sweep.by_value(method), LINES.get(method, "#555555")
        seeds = [[100 * row["rms_m"] for row in group] for group in groups.values()]
        place = range(len(groups))
        axes.plot(place, [np.mean(one) for one in seeds], "o-", color=colour, markersize=3, label=method_title(method))
        axes.fill_between(
            place, [min(one) for one in seeds], [max(one) for one in seeds], color=colour, alpha=0.15, lw=0
        )
    groups = sweep.by_value(methods[0])
    for name, style, label in (
        ("segment_expected_m", "k:", "one segment, theory"),
        ("segment_rms_m", "kx", "one segment, measured"),
    ):
        values = [100 * mean(group, name) for group in groups.values()]
        axes.plot(range(len(groups)), values, style, markersize=5, label=label)
    # what is measured stands side by side: values grow by factors in some faults and by steps in others
    axes.set_xticks(range(len(groups)), [f"{value:g}" for value in groups], fontsize=8)
    axes.set(xlabel=sweep.title, yscale="log")
    count_by_decades(axes.yaxis)
    axes.grid(alpha=0.25)


def _tabulate_pair(rows: Sequence[Row], pair: Names) -> tuple[list[str], list[list[str]]]:
    """RMS [cm] of every method where both faults are there, each alone, and none."""
    some = [row for row in rows if set(_changed(row)) <= set(pair)]
    lines = []
    for values, group in sorted(_by_values(some, pair).items()):
        found = split_by(group, "method")
        errors = [f"{100 * mean(found[method], 'rms_m'):.1f}" for method in _methods(rows)]
        lines.append([*(f"{value:g}" for value in values), *errors])
    return [*pair, *(f"{method_title(method)} [cm]" for method in _methods(rows))], lines


def _strongest(groups: Mapping[float, Sequence[Row]], name: str) -> str:
    good = []
    for value, group in groups.items():
        if np.median([row["rms_m"] for row in group]) > ENOUGH_M:
            break
        good.append(value)
    if not good:
        return "none is enough"
    if len(good) == len(groups):
        return f"all, to {good[-1]:g}"
    return f"{good[-1]:g}" if name == FEWER_IS_WORSE or len(good) > 1 else f"{good[-1]:g}, no more"


def _by_values(rows: Sequence[Row], names: Names) -> dict[tuple[float, ...], list[Row]]:
    groups: dict[tuple[float, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault(_values(row, names), []).append(row)
    return groups


def _values(row: Row, names: Names) -> tuple[float, ...]:
    return tuple(row[f"encoder.{name}"] for name in names)


def _changed(row: Row) -> Names:
    """Settings of the encoder that are not as they are by default."""
    names = [name.removeprefix("encoder.") for name in varied_in(row) if name.startswith("encoder.")]
    return tuple(sorted(name for name in names if row[f"encoder.{name}"] != getattr(PERFECT, name)))


def _capital(title: str) -> str:
    return title[0].upper() + title[1:]


def _methods(rows: Sequence[Row]) -> list[str]:
    return list(dict.fromkeys(row["method"] for row in rows))
