"""The figures by which a study is judged, with their intervals, their targets and the paper's figures."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from deepgps.reports.table import tabulate

LEVEL, MIN_VALUES, RESAMPLES = 0.95, 5, 9999  # Of intervals; with fewer values than this, a figure has none

# unit -> factor, digits, suffix
FORMS = {
    "cm": (100, 1, " cm"),
    "mm": (1000, 2, " mm"),
    "s": (1, 0, " s"),
    "%": (100, 1, " %"),
    "": (1, 2, ""),
    "count": (1, 0, ""),
}
SUFFIXES = {"_m": "cm", "_s": "s"}
SHARES = (
    *("relative_rms", "relative_median", "seen", "flipped", "accepted", "misplaced", "turned"),
    *("radius_68_holds", "radius_95_holds", "grid_68", "grid_95", "use_68", "use_95", "within_2_cm", "within_5_cm"),
    *("success_0_1m", "success_0_2m", "runs_without_collision", "carried_success_0_2m", "late_success_0_1m"),
    *("refused", "large_refused", "images", "right_share", "interval_holds", "holds_with_fault", "map_too_large"),
    *("unseen", "unseen_low", "unseen_high", "unseen_true"),
)
UNITS = {"distance_m": "m", **dict.fromkeys(SHARES, "%")}  # Units of columns that their ends do not tell


@dataclass(frozen=True)
class Figure:
    """One figure that may have a target."""

    title: str  # What it measures
    value: float | None  # Its value in metres, in seconds or as a ratio; none: there was nothing to compute it from
    unit: str  # The unit in which it is written, one of ``FORMS``
    at_least: bool = False  # Whether a target is a minimum rather than a maximum
    worst: float | None = None  # The worst of the values behind it, where meaningful
    interval: tuple[float, float] | None = None  # Its 95 % interval, where there are enough values behind it


def middle_of(title: str, middle: Callable, values: Sequence[float], unit: str, at_least: bool = False) -> Figure:
    """The mean or median of values, such as one for each room, with the worst of them and an interval by bootstrap."""
    worst = min(values) if at_least else max(values)
    return Figure(title, float(middle(values)), unit, at_least, float(worst), _resample(middle, values))


def share_of(title: str, held: Sequence[bool], at_least: bool = True) -> Figure:
    """In what share of the cases something held, with Wilson's score interval; without cases there is no value."""
    from scipy import stats  # here, since it is slow to import and a study is checked without it

    if not held:
        return Figure(title, None, "%", at_least)
    count = sum(map(bool, held))
    found = stats.binomtest(count, len(held)).proportion_ci(LEVEL, "wilson")
    interval = (float(found.low), float(found.high)) if len(held) >= MIN_VALUES else None
    return Figure(title, count / len(held), "%", at_least, interval=interval)


def ratio_of(title: str, ours: Sequence[float], theirs: Sequence[float]) -> Figure:
    """The ratio of two means over the same cases, such as rooms, with that of the worst case."""
    value, worst = float(np.mean(ours) / np.mean(theirs)), float(np.max(np.divide(ours, theirs)))
    interval = _resample(lambda ours, theirs, axis: ours.mean(axis=axis) / theirs.mean(axis=axis), ours, theirs)
    return Figure(title, value, "", worst=worst, interval=interval)


def _resample(middle: Callable, *values: Sequence[float]) -> tuple[float, float] | None:
    """Interval of a figure by drawing its cases again (percentile bootstrap, Efron 1979)."""
    if len(values[0]) < MIN_VALUES:
        return None
    drawn = np.random.default_rng(0).integers(len(values[0]), size=(RESAMPLES, len(values[0])))
    found = middle(*(np.asarray(one, float)[drawn] for one in values), axis=1)
    low, high = np.quantile(found, [(1.0 - LEVEL) / 2, (1.0 + LEVEL) / 2])
    return float(low), float(high)


def tabulate_targets(figures: Mapping[str, Figure], target: Mapping[str, float], paper: Mapping[str, float]) -> str:
    """A Markdown table of figures by name, with the targets and the paper's figures of the same names."""
    rows = []
    for name, figure in figures.items():
        wanted = target.get(name)
        sign = ">= " if figure.at_least else "<= "
        rows.append(
            [
                figure.title,
                write(figure.value, figure.unit),
                "-" if figure.interval is None else " to ".join(write(end, figure.unit) for end in figure.interval),
                write(figure.worst, figure.unit),
                "-" if wanted is None else sign + write(wanted, figure.unit),
                judge(figure.value, wanted, figure.at_least) or "-",
                write(paper.get(name), figure.unit),
            ]
        )
    return tabulate(["figure", "measured", "95 % interval", "worst", "target", "verdict", "paper"], rows)


def judge(value: float | None, target: float | None, at_least: bool = False) -> str:
    """The verdict on a target: met, missed, not measured, or empty without a target."""
    if target is None:
        return ""
    if value is None:
        return "not measured"
    met = value >= target if at_least else value <= target
    return "met" if met else "missed"


def unit_of(column: str) -> str:
    """The unit in which a study's column is written."""
    return UNITS.get(column) or next((unit for end, unit in SUFFIXES.items() if column.endswith(end)), "")


def write(value: float | None, unit: str) -> str:
    """A value in its unit, or a dash; a value too small for the digits is written as "< ..." rather than as zero."""
    if value is None:
        return "-"
    factor, digits, after = FORMS[unit]
    least = 10**-digits
    if 0 < abs(factor * value) < least / 2:
        return f"< {least:g}{after}"
    return f"{factor * value:.{digits}f}{after}"
