"""A report's tables and figures, made of its rows: select, group, take the mean, write."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from math import floor, isfinite, log10
from typing import Any

import numpy as np

from deepgps.config.methods import title_of
from deepgps.reports.table import tabulate
from deepgps.reports.targets import FORMS, Figure, middle_of, ratio_of, share_of, unit_of
from deepgps.studies.reports.record import (
    CHOICES,
    ERRORS,
    EVERY_ROW,
    VARIED_SETTINGS,
    StudyReport,
    Table,
    Target,
    Where,
)
from deepgps.studies.table import Row, is_seed, shorten, split_by, split_by_label

TAKES = {
    **{name: getattr(np, name) for name in ("mean", "median", "std", "max", "min")},
    "q90": lambda values: np.quantile(values, 0.9),
    "first": lambda values: values[0],
}
RISING_FIGURES = {"seen", "accepted"}
HEADINGS = {
    **{"rms_m": "RMS", "p95_m": "p95", "samples": "images", "distance_m": "travel", "fold_found": "said"},
    **{"heading_spread_m": "headings", "relative_rms": "RMS / side", "misplaced": "off"},
    **{
        "rms_accepted_m": "RMS of accepted",
        "max_accepted_m": "max of accepted",
        "map_rms_m": "map",
    },
    **{"error_95": "95 % [cm]", "added_95": "95 % of added [cm]"},
    **{"success_0_1m": "at 0.1 m", "success_0_2m": "at 0.2 m", "late_success_0_1m": "late", "spl": "SPL"},
}
"""Headings of columns that are not their names."""
WORDS = {"max": "most", "min": "least", "q90": "90 %"}
DIGITS, MIN_PLAIN = 3, 1e-4  # Significant digits of a cell; smaller numbers have an exponent
FLIP_LIMIT = 0.1
"""Share of flipped neighbourhoods from which a map is folded. In maps of 8,000 images, 1 to 5 % of the neighbourhoods
were flipped if the map was right, 21 to 47 % if it was folded."""
ACCEPTED_NOTE = (
    "Accepted: share of the images. A position is among the accepted where any of its headings is, with the error of "
    "the worst of these."
)


def prepare(report: StudyReport, rows: Sequence[Row], varied: Sequence[str]) -> list[Row]:
    """The rows that a report is made of: measured rows, with whether their map is folded according to the truth."""
    rows = [{**row, "folded": None if row.get("flipped") is None else row["flipped"] > FLIP_LIMIT} for row in rows]
    return report.prepare(rows, varied) if report.prepare else rows


def write_blocks(report: StudyReport, rows: Sequence[Row], varied: Sequence[str]) -> list[str]:
    """A report's tables, what else it says, and how to read it, as blocks of Markdown; rows are prepared."""
    blocks = [block for table in report.tables for block in write_table(table, rows, varied)]
    more = report.more(rows, varied) if report.more else []
    shown = any(" accepted" in table.columns for table in report.tables)
    note = [report.note] if report.note else []
    explained = [ACCEPTED_NOTE] if shown and any(row.get("accepted") is not None for row in rows) else []
    return [*blocks, *more, *note, *explained]


def write_table(table: Table, rows: Sequence[Row], varied: Sequence[str]) -> list[str]:
    """A table as blocks of Markdown, with its heading, or one for each of its sections."""
    rows = pick(rows, table.where)
    if not rows:
        return []
    if table.section is None:
        return [*([f"## {table.title}"] if table.title else []), _tabulate(table, rows, varied)]
    sections = split_by(rows, table.section).items()
    return [
        block
        for name, some in sections
        for block in (f"## {name[:1].upper()}{name[1:]}", _tabulate(table, some, varied))
    ]


def measure(report: StudyReport, rows: Sequence[Row]) -> dict[str, Figure]:
    """The figures of a report, by name, from prepared rows."""
    figures = {}
    for target in report.targets:
        chosen = pick(rows, target.where)
        for group in group_by(chosen, target.per.split()).values() if target.per else [chosen]:
            if figure := _measure(target, group, rows):
                figures[_fill(target.name, group)] = figure
    return figures


def pick(rows: Iterable[Row], where: Where) -> list[Row]:
    """The rows in which columns have these values; see ``Where``."""
    return [row for row in rows if all(_fits(row.get(name), wanted) for name, wanted in where.items())]


def group_by(rows: Iterable[Row], names: Sequence[str]) -> dict[tuple, list[Row]]:
    """Rows by the values of some columns, in the order of their first occurrence."""
    return split_by_label(rows, lambda row: tuple(row[name] for name in names))


def add_base(rows: Sequence[Row], where: Where, same: Sequence[str], names: str = ERRORS) -> list[Row]:
    """Rows with columns ``base_<name>``: means over the rows with these values that are the same in some columns."""
    bases = {
        key: {f"base_{name}": take(group, name) for name in names.split()}
        for key, group in group_by(pick(rows, where), same).items()
    }
    none = dict.fromkeys(f"base_{name}" for name in names.split())
    return [{**row, **bases.get(tuple(row[one] for one in same), none)} for row in rows]


def take(rows: Sequence[Row], column: str, default: str = "mean") -> Any:
    """What a column takes of some rows; see ``Table``. None: no row has a value."""
    if column == "runs":
        return len(rows)
    name, how, over = _split(column)
    if over:
        pairs = [(row[name], base) for row in rows if row.get(name) is not None and (base := row.get(f"base_{name}"))]
        if not pairs:
            return None
        ours, theirs = np.array(pairs, float).T
        return TAKES[default](ours / theirs) if not how and default != "mean" else ours.mean() / theirs.mean()
    values = [row[name] for row in rows if row.get(name) is not None]
    if not values:
        return None
    if not how and isinstance(values[0], bool | np.bool_):
        return int(np.sum(values))
    if default == "max" and name in RISING_FIGURES:
        default = "min"
    result = TAKES[how or ("first" if isinstance(values[0], str) else default)](values)
    is_whole = isinstance(values[0], int | np.integer) and float(result).is_integer()
    return int(result) if is_whole else result


def resolve(names: str, varied: Sequence[str]) -> list[str]:
    """Names of columns, with those that vary in place of ``VARIED_SETTINGS`` and ``CHOICES``."""
    stand_for = {VARIED_SETTINGS: list(varied), CHOICES: [name for name in varied if not is_seed(name)]}
    return list(dict.fromkeys(one for name in names.split() for one in stand_for.get(name, [name])))


def write_value(value: Any, unit: str = "") -> str:
    """A cell: a number with three digits, or as it is if it is whole; a dash for none."""
    if value is None or isinstance(value, str):
        return value or "-"
    factor = FORMS[unit][0] if unit in FORMS else 1
    if isinstance(value, int | np.integer) and factor == 1:
        return str(value)
    number = float(f"{factor * value:.{DIGITS - 1}e}")
    if not number or not isfinite(number):
        return f"{number:g}"
    if abs(number) < MIN_PLAIN:
        return f"{number:.{DIGITS - 1}e}"
    return f"{number:.{max(0, DIGITS - 1 - floor(log10(abs(number))))}f}"


def _tabulate(table: Table, rows: Sequence[Row], varied: Sequence[str]) -> str:
    names = resolve(table.by, varied)
    lines = [
        ([_write_key(*pair) for pair in zip(names, key, strict=True)], group, table.take)
        for key, group in group_by(rows, names).items()
    ]
    for word in table.summary.split():
        for method, group in split_by(rows, "method").items():
            first = [word, *[""] * (len(names) - 2), title_of(method)]
            lines.append((first, group, "max" if word == "worst" else word))
    columns: list[tuple[str, str, Where]] = [("", column, EVERY_ROW) for column in table.columns.split()]
    if (across := table.across) is not None:
        for value in split_by([row for row in rows if across in row], across):
            head = f"{_write_key(across, value)}: "
            columns += [(head, column, {across: value}) for column in table.each.split()]
    units = [_unit_of(column, table.length) for _, column, _ in columns]
    cells = [
        [
            write_value(take(pick(group, only), column, how), unit)
            for (_, column, only), unit in zip(columns, units, strict=True)
        ]
        for _, group, how in lines
    ]
    shown = [place for place in range(len(columns)) if any(line[place] != "-" for line in cells)]
    keys = [name if "." in name else name.replace("_", " ") for name in shorten(names)]
    headings = [f"{columns[place][0]}{_head(columns[place][1], table.length)}" for place in shown]
    body = [[*line[0], *(row[place] for place in shown)] for line, row in zip(lines, cells, strict=True)]
    return tabulate([*keys, *headings], body)


def _head(column: str, length: str) -> str:
    name, how, over = _split(column)
    unit = _unit_of(column, length)
    words = HEADINGS.get(name, name.removesuffix("_m").removesuffix("_s").replace("_", " "))
    return (
        f"{words}{' / base' if over else ''}{f', {WORDS.get(how, how)}' if how else ''}{f' [{unit}]' if unit else ''}"
    )


def _unit_of(column: str, length: str) -> str:
    name, _, over = _split(column)
    unit = "" if over else unit_of(name)
    return length if unit == "cm" else unit


def _split(column: str) -> tuple[str, str, bool]:
    """A column's name, what is taken of it, and whether it is divided by that of the base."""
    column, _, base = column.partition("/")
    name, _, how = column.partition(":")
    return name, how, base == "base"


def _write_key(name: str, value: Any) -> str:
    if name == "method":
        return title_of(value)
    return "-" if value is None else f"{value:g}" if isinstance(value, float) else str(value)


def _fits(value: Any, wanted: Any) -> bool:
    if callable(wanted):
        return bool(wanted(value))
    return value in wanted if isinstance(wanted, tuple) else value == wanted


def _measure(target: Target, group: Sequence[Row], rows: Sequence[Row]) -> Figure | None:
    name, how, over = _split(target.of)
    group = [row for row in group if row.get(name) is not None]
    if over or how == "ratio":
        group = [row for row in group if row.get(f"base_{name}")]
    if not group and (how != "share" or target.per):
        return None
    values, title, at_least = [row[name] for row in group], _fill(target.title, group), target.at_least
    unit = target.unit if target.unit is not None else "" if over or target.base is not None else unit_of(name)
    if target.each is not None:
        return _measure_worst(target, group, unit)
    if target.base is not None:
        base = take(pick(rows, target.base), target.base_of or name)
        return None if base is None else Figure(title, float(np.mean(values) / base), unit, at_least)
    summarise: Mapping[str, Callable[[], Figure]] = {
        "": lambda: middle_of(title, np.mean, values, unit, at_least),
        "median": lambda: middle_of(title, np.median, values, unit, at_least),
        "share": lambda: share_of(title, values, at_least),
        "count": lambda: Figure(title, sum(values), "count", at_least),
        "ratio": lambda: ratio_of(title, values, [row[f"base_{name}"] for row in group]),
    }
    return summarise[how]()


def _measure_worst(target: Target, rows: Sequence[Row], unit: str) -> Figure:
    """The mean of the worst group, and the worst of all values."""
    choose = min if target.at_least else max
    means = [(float(take(group, target.of)), group) for group in split_by(rows, str(target.each)).values()]
    value, group = choose(means, key=lambda one: one[0])
    single = choose(float(take([row], target.of)) for row in rows)
    worst = None if isinstance(rows[0][_split(target.of)[0]], bool) else single
    return Figure(_fill(target.title, group, len(rows)), value, unit, target.at_least, worst)


def _fill(template: str, rows: Sequence[Row], count: int | None = None) -> str:
    """A name or title with the values of the rows' columns, which are the same in all."""
    row = rows[0] if rows else {}
    label = title_of(row["method"]) if "method" in row else ""
    return template.format(**{**row, "label": label, "count": len(rows) if count is None else count})
