"""The report of encoders: what each fault costs, what theory predicts for it, and which encoder is good enough."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from deepgps.config.methods import title_of
from deepgps.evaluation.error_field import read_fields
from deepgps.reports.run_report import read_metrics
from deepgps.reports.table import tabulate
from deepgps.studies.reports.encoder_sweeps import (
    FEWER_IS_WORSE,
    TITLES,
    Names,
    Sweep,
    find_pairs,
    find_sweeps,
    split_by_values,
)
from deepgps.studies.table import Row, find_methods, mean, split_by

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


def report(rows: Sequence[Row], varied: Sequence[str]) -> list[str]:
    """A page for choosing encoders: what is good enough, then each fault, pairs of faults, and what theory says."""
    methods, sweeps, blocks = find_methods(rows), find_sweeps(rows), []
    for near in NEAR_M:
        title = f"## Which encoder keeps most of the room within {100 * near:g} cm"
        blocks += [title, tabulate(*choose_encoders(sweeps, methods, near))]
    blocks.append(CHOICE)
    for sweep in sweeps:
        blocks += [f"## {_capital(sweep.title)}", tabulate(*tabulate_sweep(sweep, methods))]
    for pair in find_pairs(rows):
        title = " with ".join(TITLES.get((name,), name) for name in pair)
        blocks += [f"## {_capital(title)}", tabulate(*_tabulate_pair(rows, pair))]
    return [*blocks, "## What theory says", NOTE, "\n".join(f"- {sentence}" for sentence in EXPLAIN)]


def add_errors(run: Path, row: Row) -> Row:
    """Columns for the part of test positions with small errors, errors of complete segments, and doubted segments."""
    error = read_fields(run)[row["method"]].error
    near = {name_part(near): float(np.mean(error <= near)) for near in NEAR_M}
    return {**near, **read_metrics(run)["distances"]}


def name_part(near_m: float) -> str:
    """The name of the column for the part of the test positions with errors of at most ``near_m`` [m]."""
    return f"within_{100 * near_m:g}_cm"


def choose_encoders(
    sweeps: Sequence[Sweep], methods: Sequence[str], near_m: float
) -> tuple[list[str], list[list[str]]]:
    """For each fault, the greatest measured strength up to which ``PART`` of the positions stay within ``near_m``."""
    lines = []
    for sweep in sweeps:
        found = [_strongest(sweep.by_value(method), sweep.names[0], name_part(near_m)) for method in methods]
        lines.append([sweep.title, *found])
    return ["fault", *(title_of(method) for method in methods)], lines


def tabulate_sweep(sweep: Sweep, methods: Sequence[str]) -> tuple[list[str], list[list[str]]]:
    """A line for each value: errors of segments and of every method, the map's scale, and segments doubted."""
    lines = []
    for value, group in sweep.by_value(methods[0]).items():
        segment = [f"{100 * mean(group, name):.2f}" for name in ("segment_rms_m", "segment_expected_m")]
        errors = [_write_errors(sweep.by_value(method)[value]) for method in methods]
        doubted = " / ".join(f"{mean(group, name):.0f}" for name in ("wrong_doubted", "segments_wrong"))
        lines.append([f"{value:g}", *segment, *errors, f"{mean(group, 'scale'):.4f}", doubted])
    heads = [f"{title_of(method)} (of seeds), near" for method in methods]
    scale = f"scale of {title_of(methods[0])}"
    return [_last(sweep.names[0]), "segment [cm]", "expected [cm]", *heads, scale, "found / wrong"], lines


def _write_errors(rows: Sequence[Row]) -> str:
    """RMS [cm]: mean, best and worst seed; and the part of the positions within the smaller distance."""
    low, high = (f"{100 * take(row['rms_m'] for row in rows):.1f}" for take in (min, max))
    return f"{100 * mean(rows, 'rms_m'):.1f} ({low} to {high}), {100 * mean(rows, name_part(NEAR_M[0])):.0f} %"


def _tabulate_pair(rows: Sequence[Row], pair: Names) -> tuple[list[str], list[list[str]]]:
    """Errors of every method with both faults, with each alone, and with none."""
    methods, lines = find_methods(rows), []
    for values, group in split_by_values(rows, pair).items():
        found = split_by(group, "method")
        lines.append([*(f"{value:g}" for value in values), *(_write_errors(found[method]) for method in methods)])
    return [*map(_last, pair), *(f"{title_of(method)} (of seeds), near" for method in methods)], lines


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


def _last(setting: str) -> str:
    """A setting's own name, which heads its column."""
    return setting.rpartition(".")[2]
