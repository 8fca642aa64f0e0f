"""The figures by which a study is judged, with their targets and the paper's figures."""

from collections.abc import Mapping
from dataclasses import dataclass

from deepgps.figures.markdown import tabulate

# unit -> factor, digits, suffix
FORMS = {
    "cm": (100, 1, " cm"),
    "mm": (1000, 2, " mm"),
    "s": (1, 0, " s"),
    "%": (100, 1, " %"),
    "": (1, 2, ""),
    "count": (1, 0, ""),
}


@dataclass(frozen=True)
class Figure:
    """One figure that may have a target.

    Attributes:
        title: What it measures.
        value: Its value in metres, in seconds or as a ratio; none: there was nothing to compute it from.
        unit: The unit in which it is written, one of ``FORMS``.
        at_least: Whether a target is a minimum rather than a maximum.
        worst: The worst of the values behind it, where meaningful.
    """

    title: str
    value: float | None
    unit: str
    at_least: bool = False
    worst: float | None = None


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
                write(figure.worst, figure.unit),
                "-" if wanted is None else sign + write(wanted, figure.unit),
                judge(figure.value, wanted, figure.at_least) or "-",
                write(paper.get(name), figure.unit),
            ]
        )
    return tabulate(["figure", "measured", "worst", "target", "verdict", "paper"], rows)


def judge(value: float | None, target: float | None, at_least: bool = False) -> str:
    """The verdict on a target: met, missed, not measured, or empty without a target."""
    if target is None:
        return ""
    if value is None:
        return "not measured"
    met = value >= target if at_least else value <= target
    return "met" if met else "missed"


def write(value: float | None, unit: str) -> str:
    """A value in its unit, or a dash; a value too small for the digits is written as "< ..." rather than as zero."""
    if value is None:
        return "-"
    factor, digits, after = FORMS[unit]
    least = 10**-digits
    if 0 < abs(factor * value) < least / 2:
        return f"< {least:g}{after}"
    return f"{factor * value:.{digits}f}{after}"
