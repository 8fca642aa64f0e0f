"""The columns of a study's tables: each writes one cell of a line, from the rows of the study behind that line."""

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from deepgps.config.methods import title_of
from deepgps.reports.table import tabulate
from deepgps.reports.targets import write
from deepgps.studies.table import Row, mean

PAPERS_ERRORS = {"rms_m": "RMS", "median_m": "median", "max_m": "max"}
"""The errors in the paper's tables."""
ERRORS = {"rms_m": "RMS [cm]", "median_m": "median [cm]", "p95_m": "p95 [cm]", "max_m": "max [cm]"}
"""The errors that every report shows, with their headings."""
ACCEPTED = {"rms_accepted_m": "RMS of accepted [cm]", "max_accepted_m": "max of accepted [cm]", "accepted": "accepted"}
"""The errors of what a method accepts, and the share of images that it accepts."""
ACCEPTED_NOTE = (
    "Accepted: share of the images. A position is among the accepted where any of its headings is, with the error of "
    "the worst of these."
)
FLIPPED = 0.1
"""Share of flipped neighbourhoods from which a map is folded. In maps of 8,000 images, 1 to 5 % of the neighbourhoods
were flipped if the map was right, 21 to 47 % if it was folded."""
HIGH_IS_GOOD = {"seen", "accepted"}


class Line(NamedTuple):
    """One line of a table.

    Attributes:
        key: Its first cells.
        rows: The rows that it summarises.
        base: Rows with which they are compared.
        take: What is taken of several values, such as their mean.
    """

    key: tuple[str, ...]
    rows: Sequence[Row]
    base: Sequence[Row] = ()
    take: Callable[[Sequence[float]], Any] = np.mean


class Column(NamedTuple):
    """One column of a table: its heading, what writes its cells, and whether some rows need it (None: all do)."""

    heading: str
    write: Callable[[Line], str]
    is_needed: Callable[[Iterable[Row]], bool] | None = None


def tabulate_lines(keys: Sequence[str], lines: Iterable[Line], columns: Iterable[Column]) -> str:
    """A Markdown table of these lines; ``keys`` are the headings of their first cells."""
    lines = list(lines)
    rows = [row for line in lines for row in line.rows]
    shown = [column for column in columns if column.is_needed is None or column.is_needed(rows)]
    cells = [[*line.key, *(column.write(line) for column in shown)] for line in lines]
    return tabulate([*keys, *(column.heading for column in shown)], cells)


def take_value(line: Line, name: str) -> float | None:
    """The line's value of a study's column; None if some of its rows have none. The worst share is the least."""
    values = [value for row in line.rows if (value := row.get(name)) is not None]
    if len(values) < len(line.rows):
        return None
    return float((np.min if line.take is np.max and name in HIGH_IS_GOOD else line.take)(values))


def form(name: str, spec: str, factor: float = 1.0, unit: str = "") -> Callable[[Line], str]:
    """A writer of a value times a factor, or of a dash."""

    def write_value(line: Line) -> str:
        value = take_value(line, name)
        return "-" if value is None else f"{factor * value:{spec}}{unit}"

    return write_value


def in_unit(name: str, unit: str) -> Callable[[Line], str]:
    """A writer of a value in one of the units of targets."""
    return lambda line: write(take_value(line, name), unit)


def write_known(name: str, spec: str, factor: float = 1.0, unit: str = "") -> Callable[[Line], str]:
    """A writer of the mean over the rows that have a value."""

    def write_mean(line: Line) -> str:
        known = [row[name] for row in line.rows if row.get(name) is not None]
        return f"{factor * float(np.mean(known)):{spec}}{unit}" if known else "-"

    return write_mean


def write_ratio(name: str) -> Callable[[Line], str]:
    """A writer of a mean error in centimetres and, in brackets, its ratio to that of the base."""

    def write_both(line: Line) -> str:
        value = f"{100 * mean(line.rows, name):.1f}"
        return f"{value} ({mean(line.rows, name) / mean(line.base, name):.2f})" if line.base else value

    return write_both


def write_worst(name: str = "rms_m", spec: str = ".1f", factor: float = 100.0) -> Callable[[Line], str]:
    """A writer of the largest value."""
    return lambda line: f"{factor * max(row[name] for row in line.rows):{spec}}"


def have_accepted(rows: Iterable[Row]) -> bool:
    """Whether a method in these rows refuses images."""
    return any(row.get("accepted") is not None for row in rows)


def explain_accepted(rows: Iterable[Row]) -> list[str]:
    """The note on what is accepted, where a table has it."""
    return [ACCEPTED_NOTE] if have_accepted(rows) else []


def is_folded(row: Row) -> bool:
    """Whether a map is folded according to the truth."""
    return row["flipped"] > FLIPPED


def count_folded(line: Line) -> str:
    """The number of maps that are folded according to the truth; a dash if there was no test grid to judge by."""
    known = [row for row in line.rows if row["flipped"] is not None]
    return str(sum(map(is_folded, known))) if known else "-"


def count_said(line: Line) -> str:
    """The number of maps that the detector reports as folded; a dash where nothing can fold."""
    return "-" if line.rows[0]["fold_found"] is None else str(sum(row["fold_found"] for row in line.rows))


def lines_of_rows(rows: Iterable[Row], *names: str) -> list[Line]:
    """A line for each row, with the values of some columns and the method as its first cells."""
    return [Line((*(str(row[name]) for name in names), title_of(row["method"])), [row]) for row in rows]


def of_accepted(write_value: Callable[..., Callable[[Line], str]]) -> tuple[Column, ...]:
    """The columns of ``ACCEPTED``; ``write_value`` is ``form`` or ``write_known``."""
    units = {name: " %" if name == "accepted" else "" for name in ACCEPTED}
    return tuple(
        Column(title, write_value(name, ".1f", 100, units[name]), have_accepted) for name, title in ACCEPTED.items()
    )


RUNS = Column("runs", lambda line: str(len(line.rows)))
IN_CM = tuple(Column(title, form(name, ".1f", 100)) for name, title in ERRORS.items())
RATIOS = tuple(Column(title, write_ratio(name)) for name, title in ERRORS.items())
OF_ACCEPTED = of_accepted(write_known)
FOLDED = (Column("folded", count_folded), Column("said", count_said))
TRAIN = Column("train [s]", form("train_s", ".0f"))
