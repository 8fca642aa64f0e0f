"""The reports "plain", "compare", "curves": runs side by side, or means over their seeds."""

from collections.abc import Sequence

import numpy as np

from deepgps.config.methods import title_of
from deepgps.studies.reports.record import (
    ACCEPTED_ERRORS,
    CHOICES,
    ERRORS,
    GRID,
    VARIED_SETTINGS,
    Curves,
    Dots,
    Fields,
    StudyReport,
    Table,
    Target,
)
from deepgps.studies.reports.render import add_base
from deepgps.studies.table import CASE, Row, choices, describe, is_seed, mean, split_by, split_by_label, varied_in

NO_CHANGE = "no change"  # A case with the settings that most cases share
CHANCE = 0.975  # Quantile of an interval of 95 %
CASES = Table(CASE, "error_m error_95 median_m added_m added_95 accepted runs", section="title")
CASES_NOTE = (
    "Error: RMS of the images that a method accepts, or of all where it accepts none, mean over seeds with its "
    "interval of 95 %. Added: by how much the median of all images is more than that of the first case with the same "
    "seed; of accepted images, the cases accept others."
)
COMPARE = Table(
    f"{CHOICES} method",
    f"runs samples distance_m {ERRORS} rms_m:max paper_rms_m paper_bound_m relative_rms {ACCEPTED_ERRORS} "
    "heading_spread_m folded fold_found train_s",
)
NOTE = (
    f"Means over runs that differ only in their seeds. {GRID}Headings: RMS distance of the predictions at one position "
    "from their mean. Folded: maps that flip more than a tenth of the neighbourhoods; said: maps that the detector, "
    "which does not use the truth, reports as folded."
)
WORDS = "filled: RMS of accepted, open: median of all"
OF_CASES = {
    "errors": Dots(CASE, marks=(("", "error_m", "median_m"),), words=WORDS),
    "error_fields": Fields(f"{CASE} method"),
}
SAMPLES = "drive.samples"
AXES = {"encoder.step_noise": "noise w per gap between readings", SAMPLES: "training images"}
# The paper on DeepGPS: its RMS is below this share of the room's side (Sec. V-A); its RMS at a value [m] (V-B).
PAPER_SHARE = {"encoder.step_noise": 0.02}
PAPER_RMS: dict[str, dict[float, float]] = {SAMPLES: {1000: 0.04}}
KNEE = 1.25


def find_cases(rows: Sequence[Row], varied: Sequence[str]) -> list[Row]:
    """Rows with the case's name, its error, what it adds to the first one's median [m], and intervals as text [cm]."""
    named = [
        {
            **row,
            CASE: name,
            "title": title_of(row["method"]),
            "error_m": row["rms_m"] if row["rms_accepted_m"] is None else row["rms_accepted_m"],
        }
        for row, name in zip(rows, name_cases(rows, varied), strict=True)
    ]
    same = ["method", *(name for name in named[0] if is_seed(name))]
    based = add_base(named, {CASE: named[0][CASE]}, same, "median_m")
    for row in based:
        first = row[CASE] == named[0][CASE] or row["base_median_m"] is None
        row["added_m"] = None if first else row["median_m"] - row["base_median_m"]
    for group in split_by_label(based, lambda row: (row[CASE], row["method"])).values():
        found = {
            f"{name}_95": write_interval([row[f"{name}_m"] for row in group], least)
            for name, least in (("error", 0.0), ("added", -np.inf))
        }
        for row in group:
            row.update(found)
    return based


def name_cases(rows: Sequence[Row], varied: Sequence[str]) -> list[str]:
    """The name of each row's case: its own, or its settings without those that the first and another case share."""
    names = [name for name in varied if name != CASE and not is_seed(name)]
    first, points = rows[0], {tuple(row[name] for name in names) for row in rows}
    usual = {name for place, name in enumerate(names) if sum(point[place] == first[name] for point in points) > 1}
    told = ([name for name in names if name not in usual or row[name] != first[name]] for row in rows)
    return [row.get(CASE) or (describe(row, some) if some else NO_CHANGE) for row, some in zip(rows, told, strict=True)]


def find_interval(values: Sequence[float | None]) -> tuple[float, float] | None:
    """The interval of 95 % of a mean; None: fewer than two values."""
    from scipy.stats import t  # here, since a study can be checked without it

    known = np.array([value for value in values if value is not None])
    if len(known) < 2:
        return None
    half = t.ppf(CHANCE, len(known) - 1) * known.std(ddof=1) / len(known) ** 0.5
    return float(known.mean() - half), float(known.mean() + half)


def write_interval(values: Sequence[float | None], least: float) -> str | None:
    """The interval of 95 % of a mean, which cannot be below ``least`` [cm]; None: fewer than two values."""
    found = find_interval(values)
    return f"{max(100 * found[0], least):.2f} to {100 * found[1]:.2f}" if found else None


def rank_cases(rows: Sequence[Row], varied: Sequence[str]) -> list[str]:
    """A sentence for each method: the cases by what they add to the first one's median, most first."""
    sentences, added = [], [row for row in rows if row["added_m"] is not None]
    for title, group in split_by(added, "title").items():
        parts = []
        for case, some in sorted(split_by(group, CASE).items(), key=lambda pair: -mean(pair[1], "added_m")):
            interval = find_interval([row["added_m"] for row in some])
            unsure = interval is None or interval[0] <= 0.0 <= interval[1]
            parts.append(f"{case} {100 * mean(some, 'added_m'):+.2f}{' (not told apart)' * unsure}")
        sentences.append(f"**What adds most to {rows[0][CASE]}, {title}:** {', '.join(parts)} cm.")
    return sentences


def find_curves(rows: Sequence[Row], varied: Sequence[str]) -> list[Row]:
    """Rows with their curve's panel and place along the axis, the last setting that varies, and the paper's RMS."""
    *others, axis = varied_in(rows[0])
    names, last = choices(rows, others), max(row[axis] for row in rows)
    prepared = [
        {
            **{**row, "axis": row[axis], "axis_title": AXES.get(axis, axis), "axis_name": axis},
            **{"case": describe(row, names) if names else "", "at_end": row[axis] == last},
            "relative_median": row["median_m"] / row["shorter_side_m"],
            "paper_rms_m": PAPER_RMS.get(axis, {}).get(row[axis]),
            "paper_bound_m": PAPER_SHARE[axis] * row["shorter_side_m"] if axis in PAPER_SHARE else None,
        }
        for row in rows
    ]
    curves = split_by_label(prepared, lambda row: (row["method"], row["case"]))
    knees = {key: find_knee(curve, axis) for key, curve in curves.items()}
    return [{**row, "knee": knees[row["method"], row["case"]]} for row in prepared]


def find_knee(curve: Sequence[Row], axis: str) -> float | None:
    """The least value of the axis from which on the RMS (mean over seeds) is at most KNEE times the RMS at the end.

    None if no value exceeds that bound or only the last is within it: a line without a drop, or one that still falls,
    has no knee.
    """
    means = {value: mean(group, "rms_m") for value, group in sorted(split_by(curve, axis).items())}
    end = max(means)
    beyond = [value for value, rms in means.items() if rms > KNEE * means[end]]
    knee = min(value for value in means if value > max(beyond)) if beyond else end
    return knee if knee < end else None


def tell_knees(rows: Sequence[Row], varied: Sequence[str]) -> list[str]:
    """A sentence for each curve that has a knee."""
    known = [row for row in rows if row["knee"] is not None]
    curves = split_by_label(known, lambda row: (row["case"], row["axis_name"], row["method"], row["knee"]))
    return [
        f"The knee{f' of {case}' if case else ''}: {name} {knee:g}, the smallest value from which the RMS of "
        f"{title_of(method)} (mean over seeds) stays within {KNEE} times that at {max(row['axis'] for row in rows):g}."
        for case, name, method, knee in curves
    ]


def _list_targets_of_curves() -> list[Target]:
    words = {"rms_m": "RMS", "relative_rms": "RMS / side", "relative_median": "median / side"}
    end, per = {"at_end": True}, "method"
    return [
        *(
            Target(f"{{method}}_{of}", f"{{label}}, {title} at {{axis_name}} {{axis:g}}", of, end, each="case", per=per)
            for of, title in words.items()
        ),
        Target("{method}_knee", "{label}, knee of {axis_name}", "knee", each="case", per=per, unit="count"),
    ]


_CURVES = Curves(
    "case",
    "axis",
    "axis_title",
    also={"median_m": "median"},
    lines={"paper_bound_m": "paper: below this share of the side", "paper_rms_m": "paper's RMS"},
)
REPORTS = {
    "plain": StudyReport((Table(f"{VARIED_SETTINGS} method", f"{ERRORS} {ACCEPTED_ERRORS}"),)),
    "compare": StudyReport((CASES,), f"{GRID}{CASES_NOTE}", find_cases, rank_cases, pictures=OF_CASES),
    "curves": StudyReport((COMPARE,), NOTE, find_curves, tell_knees, _list_targets_of_curves(), {"curves": _CURVES}),
}
