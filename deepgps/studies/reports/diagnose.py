"""The report "diagnose": which faults were named, whether intervals hold, and how exact the wheels are known."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from deepgps.config.scenario import Scenario
from deepgps.studies.diagnose_runs import draw_runs
from deepgps.studies.reports.record import Scatter, StudyReport, Table, Target
from deepgps.studies.table import Plan, Row, read_setting
from sim.files.checksums import read_json

FAULTS = ("radius", "wheel", "track", "slip", "step_noise", "ticks", "dropout", "stuck")
ALIKE = "both radii alike"
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
RELATIVE = ("track_m", "reading_ratio", "wheel_ratio")
"""Quantities whose errors are relative."""
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


def gather_diagnoses(plans: Sequence[Plan], failures: Mapping[str, str], folder: Path) -> list[Row]:
    """A row for each recording: its settings, each quantity as it is and as it was found, and the faults."""
    from deepgps.diagnosis.store import FILE

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
                "set": {"": "none", "alike": ALIKE}.get(row["set"], row["set"]),
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
        "error": abs(value - true) / (true if name in RELATIVE else 1.0),
    }


def _list_targets() -> list[Target]:
    none, alike = {"kind": "recording", "faults": 0}, {"kind": "recording", "set": ALIKE}
    must, made, finding, quantity = ({"kind": kind} for kind in ("must", "set", "finding", "quantity"))
    small, scale = (
        "the same with those too small to be detected, {count}",
        "alarms but for the scale of turns, in {count}",
    )
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


_ALONE = Table(
    "set",
    f"runs {' '.join(FAULTS)} none too_small",
    {"kind": "recording", "faults": (0, 1)},
    title="What was found",
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
_FOUND = Scatter(
    (("true", "value", ""),),
    "held",
    ("set", "found"),
    "quantity",
    ("low", "high"),
    equal=True,
    factor=1.0,
    where={"kind": "quantity"},
)
REPORTS = {
    "diagnose": StudyReport(
        (_ALONE, _PAIRS, _INTERVALS),
        NOTE,
        judge,
        targets=_list_targets(),
        pictures={"diagnose": _FOUND},
        draw_runs=draw_runs,
        gather=gather_diagnoses,
        fixes=("drive.samples",),
    ),
}
