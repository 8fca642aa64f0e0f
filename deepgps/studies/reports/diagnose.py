"""The report "diagnose": recordings with faults that are drawn, and which were named, how well, and how exactly."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from deepgps.config.scenario import Scenario
from deepgps.studies.reports.record import Scatter, StudyReport, Table, Target
from deepgps.studies.table import Point, Row
from sim.errors import InputError, quote
from sim.rng import stream

LIMITS: dict[str, tuple[float, float]] = {
    "encoder.radius_error_left": (0.01, 0.1),
    "encoder.radius_error_right": (0.01, 0.1),
    "encoder.track_error": (0.02, 0.1),
    "encoder.slip_per_m": (0.005, 0.1),
    "encoder.step_noise": (0.02, 0.3),
    "encoder.ticks_per_rev": (4, 256),
    "encoder.dropout": (0.1, 0.6),
    "encoder.stuck_fraction": (0.05, 0.5),
}
"""Smallest and largest strength in the study ``encoder``; errors may have either sign."""
BOTH_RADII = ("encoder.radius_error_left", "encoder.radius_error_right")
SHORTER_TENTHS = (10, 9, 8, 7, 6)  # Lengths of the recordings without faults, in tenths of the drive
SINGLE_FAULT_DRIVES, FAULT_PAIR_DRIVES = 11, 2  # Recordings of each drive with one fault, and with two
WHEEL = "robot.wheel_radius_error"
FAULTS = ("radius", "wheel", "track", "slip", "step_noise", "ticks", "dropout", "stuck")
EQUAL_RADII = "both radii alike"
QUANTITIES = {
    "track_m": ("track width [m]", ("track", "alike", "radius", "wheel")),
    "reading_ratio": ("readings, right over left", ("radius",)),
    "wheel_ratio": ("radius, right over left", ("wheel",)),
    "step_noise": ("noise of a gap", ("step_noise",)),
    "slip_per_m": ("slip in a metre [m]", ("slip",)),
    "dropout": ("readings lost", ("dropout",)),
    "stuck_fraction": ("gaps with a stuck wheel", ("stuck",)),
}
"""Quantities with an interval, in words, and the faults that change them; ticks are counted."""
RELATIVE_QUANTITIES = ("track_m", "reading_ratio", "wheel_ratio")  # Quantities whose errors are relative
NOTE = (
    "Faults of one recording, alone: rows are what was set, columns what was diagnosed; a recording with two findings "
    "counts in two columns. A fault below the smallest size that its diagnosis states (ticks shorter than 2 mm) is not "
    "one that must be found. Both radii wrong alike by e make turns by the wheels 1 + e too large, as a track width "
    "that is wrong by 1 / (1 + e) does: the two are one and the same to every sensor of the robot, so the finding "
    "`track` names both, and counts as right for either. Nothing else may be found there.\n\n"
    "Intervals are of 95 %. With fault: recordings in which the quantity is not what a perfect wheel has. Errors are "
    "relative for track width and ratios, and of the quantity itself elsewhere; those of slip and of the noise of a "
    "gap grow with them, and the track width is less exact where turns by the wheels are themselves noisy."
)


def draw_runs(common: Mapping[str, Any], drives: Sequence[tuple[int, Point]]) -> list[tuple[int, Point]]:
    """Seeds and settings of all recordings, from the settings common to all and the seed and settings of each drive.

    A drive with equal wheels gives five recordings without faults, five with radii that are wrong alike, eleven with
    one fault and two with two; one with unequal wheels a recording with this fault alone, and one with a second fault.
    """
    samples, runs, single = common.get("drive.samples"), list[tuple[int, Point]](), 0
    if type(samples) is not int or any("drive.samples" in drive for _, drive in drives):
        raise InputError(f"report diagnose needs drive.samples to be a whole number in set alone, not {quote(samples)}")
    for number, (seed, drive) in enumerate(drives):
        rng = stream(seed, "diagnose", number)

        def add(faults: Point, seed: int = seed, drive: Point = drive, add: Callable = runs.append) -> None:
            add((seed, {**drive, **faults}))

        if drive.get(WHEEL):
            add({})
            add(_draw(rng, _choose(rng, 1)))
            continue
        for tenths in SHORTER_TENTHS:
            add({"drive.samples": samples * tenths // 10})
        for _ in range(len(SHORTER_TENTHS)):
            add(dict.fromkeys(BOTH_RADII, _draw(rng, BOTH_RADII[:1])[BOTH_RADII[0]]))
        for _ in range(SINGLE_FAULT_DRIVES):
            add(_draw(rng, [list(LIMITS)[single % len(LIMITS)]]))
            single += 1
        for _ in range(FAULT_PAIR_DRIVES):
            add(_draw(rng, _choose(rng, 2)))
    return runs


def _choose(rng: np.random.Generator, count: int) -> list[str]:
    names = [name for name in LIMITS if name != BOTH_RADII[int(rng.integers(2))]]
    return [names[place] for place in rng.choice(len(names), count, replace=False)]


def _draw(rng: np.random.Generator, names: Sequence[str]) -> Point:
    drawn: Point = {}
    for name in names:
        low, high = LIMITS[name]
        value = float(np.exp(rng.uniform(np.log(low), np.log(high))))
        sign = int(rng.choice((-1, 1))) if "error" in name else 1
        drawn[name] = round(value) if isinstance(low, int) else round(sign * value, 5)
    return drawn


def describe(scenario: Scenario, found: Mapping[str, Any]) -> Row:
    """Columns of a recording: the faults set and found, and each quantity as it is and as ``diagnosis.json`` has it."""
    row: Row = {
        "set": " ".join(list_set(scenario)),
        "found": " ".join(fault["fault"] for fault in found["faults"]),
        "must": " ".join(list_must(scenario, found)),
    }
    for name, true in tell_truth(scenario, found["odometry"]).items():
        estimate = found["quantities"][name]
        row |= {name: estimate["value"], f"{name}_true": true}
        row |= {f"{name}_{end}": estimate[end] for end in ("low", "high")}
    return row


def tell_truth(scenario: Scenario, odometry: Mapping[str, float]) -> dict[str, float]:
    """What can be known of each quantity, from the settings: ``track_m`` in the metres of the readings."""
    encoder, wheel = scenario.encoder, scenario.robot.wheel_radius_error
    read_m = 1.0 + (encoder.radius_error_left + encoder.radius_error_right) / 2.0
    track_m = odometry["track_m"] / (1.0 + encoder.track_error)
    return {
        "track_m": track_m * read_m / (1.0 + wheel / 2.0),
        "reading_ratio": (1.0 + encoder.radius_error_right) / (1.0 + encoder.radius_error_left),
        "wheel_ratio": 1.0 / (1.0 + wheel),
        **{name: getattr(encoder, name) for name in ("step_noise", "slip_per_m", "dropout", "stuck_fraction")},
    }


def list_set(scenario: Scenario) -> list[str]:
    """Names of the faults that were set; alike for both radii."""
    return [name for name, size in _size_faults(scenario).items() if size]


def list_must(scenario: Scenario, found: Mapping[str, Any]) -> list[str]:
    """The faults that were set above the smallest size that the diagnosis states."""
    size, least = _size_faults(scenario), found["smallest"]
    size["ticks"] *= found["quantities"]["tick_m"]["value"]
    return [name for name in list_set(scenario) if size[name] > least.get(name, least["track"])]


def _size_faults(scenario: Scenario) -> dict[str, float]:
    """The size of each fault; of ticks, whether there are fewer."""
    encoder = scenario.encoder
    left, right = encoder.radius_error_left, encoder.radius_error_right
    return {
        "alike": abs(left) if left == right else 0.0,
        "radius": abs(left or right) if left != right else 0.0,
        "wheel": abs(scenario.robot.wheel_radius_error),
        "track": abs(encoder.track_error),
        "slip": encoder.slip_per_m,
        "step_noise": encoder.step_noise,
        "ticks": float(encoder.ticks_per_rev != type(encoder)().ticks_per_rev),
        "dropout": encoder.dropout,
        "stuck": encoder.stuck_fraction,
    }


def judge(rows: Sequence[Row], varied: Sequence[str]) -> list[Row]:
    """Rows of recordings, of each quantity of them, and of each fault: that must be found, was set, and was found."""
    judged = []
    for row in sorted(rows, key=lambda row: ("", "alike", *FAULTS, row["set"]).index(row["set"])):
        made, found, must = (row[name].split() for name in ("set", "found", "must"))
        right, alike = ["track" if name == "alike" else name for name in made], made == ["alike"]
        wrong = [f"{name} missed" for name in sorted({*must} - {*found})]
        wrong += [f"{name} wrong" for name in sorted({*found} - {*right})]
        quantities = {name: _judge_quantity(row, name, made) for name in QUANTITIES}
        recording = {
            **{
                "kind": "recording",
                "faults": len(made),
                "set": {"": "none", "alike": EQUAL_RADII}.get(row["set"], row["set"]),
            },
            **{"found": ", ".join(found) or "none", "missed_or_wrong": ", ".join(wrong) or "-"},
            **{name: name in (found or ["none"]) for name in (*FAULTS, "none")},
            "too_small": bool(made) and not alike and not must,
            "alarm": bool({*found} - {"track"} if alike else found),
            "ratio_error": max(quantities[name]["error"] for name in ("reading_ratio", "wheel_ratio")),
        }
        judged += [recording, *quantities.values()]
        for kind, names, among in (("must", must, found), ("set", made, found), ("finding", found, right)):
            judged += [{"kind": kind, "right": name in among} for name in names if name != "alike"]
    return judged


def _judge_quantity(row: Row, name: str, made: Sequence[str]) -> Row:
    value, low, high, true = (row[f"{name}{part}"] for part in ("", "_low", "_high", "_true"))
    holds, (title, faults) = low - 1e-9 <= true <= high + 1e-9, QUANTITIES[name]  # but for rounding errors
    is_off = bool({*faults} & {*made})
    return {
        **{"kind": "quantity", "quantity": title, "value": value, "low": low, "high": high, "true": true},
        **{"interval_holds": holds, "held": "interval holds" if holds else "does not", "with_fault": is_off},
        "holds_with_fault": holds if is_off else None,
        "error": abs(value - true) / (true if name in RELATIVE_QUANTITIES else 1.0),
    }


def _list_targets() -> list[Target]:
    none, alike = {"kind": "recording", "faults": 0}, {"kind": "recording", "set": EQUAL_RADII}
    must, made, finding, quantity = ({"kind": kind} for kind in ("must", "set", "finding", "quantity"))
    small = "the same with those too small to be detected, {count}"
    scale = "alarms but for the scale of turns, in {count}"
    least, most = "intervals hold, least of all quantities", "intervals hold, most of all quantities"
    track, ratio = "track width, median error", "ratios of the wheels, median error"
    return [
        Target("recall", "found, of {count} faults", "right:share", must, at_least=True),
        Target("recall_all", small, "right:share", made, at_least=True),
        Target("precision", "right, of {count} findings", "right:share", finding, at_least=True),
        Target("false_alarms", "alarms in {count} without faults", "alarm:count", none),
        Target("false_alarms_alike", f"{scale} with both radii alike", "alarm:count", alike),
        Target("coverage_least", least, "interval_holds:mean", quantity, each="quantity", at_least=True),
        Target("coverage_most", most, "interval_holds:mean", quantity, each="quantity"),
        Target("track_error", track, "error:median", {"quantity": QUANTITIES["track_m"][0]}, unit="%"),
        Target("ratio_error", ratio, "ratio_error:median", {"kind": "recording"}, unit="%"),
    ]


_SINGLE_FAULTS = Table(
    "set", f"runs {' '.join(FAULTS)} none too_small", {"kind": "recording", "faults": (0, 1)}, title="What was found"
)
_PAIRS = Table(
    "set found missed_or_wrong",
    "runs",
    {"kind": "recording", "faults": lambda count: count > 1},
    title="Two faults at a time",
)
_INTERVALS = Table(
    "quantity",
    "runs interval_holds:mean with_fault holds_with_fault:mean error:median error:q90 error:max",
    {"kind": "quantity"},
    title="Intervals and errors",
)
_FINDINGS = Scatter(
    "true",
    "value",
    "held",
    ("set", "found"),
    ("low", "high"),
    "quantity",
    factor=1.0,
    where={"kind": "quantity"},
)
REPORTS = {
    "diagnose": StudyReport(
        (_SINGLE_FAULTS, _PAIRS, _INTERVALS),
        NOTE,
        judge,
        targets=_list_targets(),
        pictures={"diagnose": _FINDINGS},
        draw_runs=draw_runs,
        columns="from_runs:add_diagnosis",
    )
}
