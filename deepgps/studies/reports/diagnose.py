"""The report of diagnoses: which faults were named, whether intervals hold, and how exact the wheels are known."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure as Picture

from deepgps.config.scenario import Scenario
from deepgps.diagnosis.store import FILE
from deepgps.reports.table import tabulate
from deepgps.reports.targets import Figure, median_of, share_of
from deepgps.studies.plan import Plan
from deepgps.studies.table import Row, read_setting
from sim.files.checksums import read_json

FAULTS = ("radius", "wheel", "track", "slip", "step_noise", "ticks", "dropout", "stuck")
ALIKE, NONE = "both radii alike", "none"
QUANTITIES = {
    "track_m": "track width",
    "reading_ratio": "readings, right over left",
    "wheel_ratio": "radius, right over left",
    "step_noise": "noise of a gap",
    "slip_per_m": "slip in a metre",
    "dropout": "readings lost",
    "stuck_fraction": "gaps with a stuck wheel",
}
"""Quantities with an interval; ticks are counted."""
UNITS = {"track_m": " [m]", "slip_per_m": " [m]"}
"""Units of the quantities that have one."""
HELD, MISSED = "#2a6f97", "#d1495b"
NOTE = (
    "Faults of one recording, alone: rows are what was set, columns what was diagnosed; a recording with two findings "
    "counts in two columns. A fault below the smallest size that its diagnosis states (ticks shorter than 2 mm) is not "
    "one that must be found. Both radii wrong alike by e make turns by the wheels 1 + e too large, as a track width "
    "that is wrong by 1 / (1 + e) does: the two are one and the same to every sensor of the robot, so the finding "
    "`track` names both, and counts as right for either. Nothing else may be found there."
)


def gather_diagnoses(plans: Sequence[Plan], failures: Mapping[str, str], folder: Path) -> list[Row]:
    """A row for each recording: its settings, each quantity as it is and as it was found, and the faults."""
    names = list(dict.fromkeys(name for plan in plans for name in plan.varied))
    rows = []
    for plan in plans:
        failure = failures.get(plan.run)
        found = {} if failure else read_json(folder / "runs" / plan.run / FILE)
        row: Row = {"run": plan.run, "recording": plan.recording, "seed": plan.scenario.seed}
        row |= {name: read_setting(plan.scenario, name) for name in names}
        row |= {"set": " ".join(list_set(plan.scenario)), "found": None, "must": None, "failure": failure}
        row |= {f"{name}{part}": None for name in QUANTITIES for part in ("", "_low", "_high", "_true")}
        if not failure:
            row["found"] = " ".join(fault["fault"] for fault in found["faults"])
            row["must"] = " ".join(list_must(plan.scenario, found))
            for name, true in tell_truth(plan.scenario, found["odometry"]).items():
                estimate = found["quantities"][name]
                row |= {name: estimate["value"], f"{name}_true": true}
                row |= {f"{name}_{part}": estimate[part] for part in ("low", "high")}
        rows.append(row)
    return rows


def tell_truth(scenario: Scenario, odometry: Mapping[str, float]) -> dict[str, float]:
    """What can be known of each quantity, from the settings: ``track_m`` in the metres of the readings."""
    encoder, wheel = scenario.encoder, scenario.robot.wheel_radius_error
    read_m = 1.0 + (encoder.radius_error_left + encoder.radius_error_right) / 2.0
    track_m = odometry["track_m"] / (1.0 + encoder.track_error)
    return {
        "track_m": track_m * read_m / (1.0 + wheel / 2.0),
        "reading_ratio": (1.0 + encoder.radius_error_right) / (1.0 + encoder.radius_error_left),
        "wheel_ratio": 1.0 / (1.0 + wheel),
        "step_noise": encoder.step_noise,
        "slip_per_m": encoder.slip_per_m,
        "dropout": encoder.dropout,
        "stuck_fraction": encoder.stuck_fraction,
    }


def list_set(scenario: Scenario) -> list[str]:
    """Names of the faults that were set; ``ALIKE`` for both radii."""
    encoder = scenario.encoder
    if encoder.radius_error_left and encoder.radius_error_left == encoder.radius_error_right:
        return ["alike"]
    there = {
        "radius": encoder.radius_error_left or encoder.radius_error_right,
        "wheel": scenario.robot.wheel_radius_error,
        "track": encoder.track_error,
        "slip": encoder.slip_per_m,
        "step_noise": encoder.step_noise,
        "ticks": encoder.ticks_per_rev != type(encoder)().ticks_per_rev,
        "dropout": encoder.dropout,
        "stuck": encoder.stuck_fraction,
    }
    return [name for name, value in there.items() if value]


def list_must(scenario: Scenario, found: Mapping[str, Any]) -> list[str]:
    """The faults that were set above the smallest size that the diagnosis states."""
    encoder, least = scenario.encoder, found["smallest"]
    size = {
        "alike": abs(encoder.radius_error_left),
        "radius": abs(encoder.radius_error_left or encoder.radius_error_right),
        "wheel": abs(scenario.robot.wheel_radius_error),
        "track": abs(encoder.track_error),
        "slip": encoder.slip_per_m,
        "step_noise": encoder.step_noise,
        "ticks": found["quantities"]["tick_m"]["value"],
        "dropout": encoder.dropout,
        "stuck": encoder.stuck_fraction,
    }
    return [name for name in list_set(scenario) if size[name] > least.get(name, least["track"])]


def report(rows: Sequence[Row], varied: Sequence[str]) -> list[str]:
    """The confusion table, the pairs of faults, and the intervals."""
    blocks = ["## What was found", tabulate(*confuse(rows)), NOTE]
    if pairs := [row for row in rows if len(row["set"].split()) > 1]:
        lines = [[row["set"], row["found"] or NONE, _describe_pair(row)] for row in pairs]
        blocks += ["## Two faults at a time", tabulate(["set", "found", "missed or wrong"], lines)]
    return [*blocks, "## Intervals and errors", tabulate(*judge_intervals(rows)), EXPLAIN]


EXPLAIN = (
    "Intervals are of 95 %. With fault: recordings in which the quantity is not what a perfect wheel has. Errors are "
    "relative for track width and ratios, and of the quantity itself elsewhere; those of slip and of the noise of a "
    "gap grow with them, and the track width is less exact where turns by the wheels are themselves noisy."
)


def confuse(rows: Sequence[Row]) -> tuple[list[str], list[list[str]]]:
    """Recordings with at most one fault, by what was set and what was found."""
    columns = [*FAULTS, NONE]
    lines = []
    for name in ("", "alike", *FAULTS):
        group = [row for row in rows if row["set"] == name]
        if group:
            found = [row["found"].split() or [NONE] for row in group]
            counts = [sum(column in one for one in found) for column in columns]
            title = {"": NONE, "alike": ALIKE}.get(name, name)
            below = sum(1 for row in group if name and name != "alike" and not row["must"])
            lines.append([title, str(len(group)), *(str(count) if count else "-" for count in counts), str(below)])
    return ["set", "recordings", *columns, "too small"], lines


def judge_intervals(rows: Sequence[Row]) -> tuple[list[str], list[list[str]]]:
    """For each quantity, how often its interval holds, and how large the errors are."""
    lines = []
    for name, title in QUANTITIES.items():
        held, faulty = [holds(row, name) for row in rows], [holds(row, name) for row in rows if _is_off(row, name)]
        errors = [_error(row, name) for row in rows]
        form = "{:.3f} %" if name in {"track_m", "reading_ratio", "wheel_ratio"} else "{:.2g}"
        scale = 100 if "%" in form else 1
        some = [form.format(scale * value) for value in (np.median(errors), np.quantile(errors, 0.9), max(errors))]
        share = f"{100 * np.mean(faulty):.1f} % of {len(faulty)}" if faulty else "-"
        lines.append([title, f"{100 * np.mean(held):.1f} % of {len(held)}", share, *some])
    return ["quantity", "interval holds", "with fault", "error, median", "90 %", "largest"], lines


def measure(rows: Sequence[Row]) -> dict[str, Figure]:
    """Recall and precision above the stated size, false alarms, intervals, and errors of track width and ratios."""
    must = [(_accept(name), row["found"].split()) for row in rows for name in row["must"].split() if name != "alike"]
    every = [(name, row["found"].split()) for row in rows for name in row["set"].split() if name != "alike"]
    every_finding = [(name, _list_right(row)) for row in rows for name in row["found"].split()]
    none = [row for row in rows if not row["set"]]
    alike = [row for row in rows if row["set"] == "alike"]
    held = [np.mean([holds(row, name) for row in rows]) for name in QUANTITIES]
    track = [_error(row, "track_m") for row in rows]
    ratio = [max(_error(row, "reading_ratio"), _error(row, "wheel_ratio")) for row in rows]
    return {
        "recall": share_of(f"found, of {len(must)} faults", [a in b for a, b in must]),
        "recall_all": share_of(
            f"the same with those too small to be detected, {len(every)}", [a in b for a, b in every]
        ),
        "precision": share_of(f"right, of {len(every_finding)} findings", [a in b for a, b in every_finding]),
        "false_alarms": Figure(
            f"alarms in {len(none)} without faults", sum(bool(row["found"]) for row in none), "count"
        ),
        "false_alarms_alike": Figure(
            f"alarms but for the scale of turns, in {len(alike)} with both radii alike",
            sum(bool(set(row["found"].split()) - {"track"}) for row in alike),
            "count",
        ),
        "coverage_least": Figure("intervals hold, least of all quantities", float(min(held)), "%", at_least=True),
        "coverage_most": Figure("intervals hold, most of all quantities", float(max(held)), "%"),
        "track_error": median_of("track width, median error", track, "%"),
        "ratio_error": median_of("ratios of the wheels, median error", ratio, "%"),
    }


def draw(rows: Sequence[Row], varied: Sequence[str], folder: Path) -> Picture:
    """Draw found over true for each quantity; intervals that do not hold are red."""
    picture = Picture(figsize=(12, 6), layout="constrained")
    for number, (name, title) in enumerate(QUANTITIES.items()):
        axes = picture.add_subplot(2, 4, number + 1)
        true = [row[f"{name}_true"] for row in rows]
        low, high = min(true), max(true)
        axes.plot([low, high], [low, high], color="#999999", linewidth=0.8)
        for held, colour in ((True, HELD), (False, MISSED)):
            some = [row for row in rows if holds(row, name) == held]
            x, y = [row[f"{name}_true"] for row in some], [row[name] for row in some]
            bars = [[row[name] - row[f"{name}_low"] for row in some], [row[f"{name}_high"] - row[name] for row in some]]
            if some:
                label = "interval holds" if held else "does not"
                axes.errorbar(x, y, bars, fmt="o", color=colour, markersize=3, linewidth=0.8, alpha=0.7, label=label)
        axes.set(title=title + UNITS.get(name, ""), xlabel="set", ylabel="found")
        axes.grid(alpha=0.25)
        if number == 0:
            axes.legend(frameon=False, fontsize=8)
    return picture


def holds(row: Row, name: str) -> bool:
    """Whether an interval contains the truth, but for rounding errors."""
    return row[f"{name}_low"] - 1e-9 <= row[f"{name}_true"] <= row[f"{name}_high"] + 1e-9


def _error(row: Row, name: str) -> float:
    relative = name in {"track_m", "reading_ratio", "wheel_ratio"}
    return abs(row[name] - row[f"{name}_true"]) / (row[f"{name}_true"] if relative else 1.0)


def _is_off(row: Row, name: str) -> bool:
    kinds = {"track_m": "track alike radius wheel", "reading_ratio": "radius", "wheel_ratio": "wheel"}
    kinds |= {"step_noise": "step_noise", "slip_per_m": "slip", "dropout": "dropout", "stuck_fraction": "stuck"}
    return bool(set(kinds[name].split()) & set(row["set"].split()))


def _accept(name: str) -> str:
    return "track" if name == "alike" else name


def _list_right(row: Row) -> list[str]:
    return [_accept(name) for name in row["set"].split()]


def _describe_pair(row: Row) -> str:
    missed = set(row["must"].split()) - set(row["found"].split())
    wrong = set(row["found"].split()) - set(_list_right(row))
    return (
        ", ".join([*(f"{name} missed" for name in sorted(missed)), *(f"{name} wrong" for name in sorted(wrong))]) or "-"
    )
