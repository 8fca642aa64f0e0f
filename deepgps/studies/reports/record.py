"""What a report of a study is, as data: its tables, figures with targets, pictures and text.

All of them take columns of the study's rows by name. A report may first ``prepare`` the rows: add columns in words, or
make several rows of one. This module imports nothing heavy, so that a study can be checked fast.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from deepgps.studies.table import Row

Where = Mapping[str, Any]
"""Rows in which columns have these values: one, several as a tuple, or those for which a function holds."""
VARIED, CHOICES = "*varied", "*choices"
"""In place of a column: all settings that vary in the study; the same without seeds, which only repeat runs."""
EVERY: Where = {}


class Table(NamedTuple):
    """A table with a line for each combination of values.

    A cell is the mean of a line's values, the number of those that are true, or the first text; a column may name what
    is taken instead, as in ``rms_m:max``. ``rms_m/base`` is the mean of rms_m by that of base_rms_m, and ``runs``
    counts rows. A column without any value is left out. Headings are in ``render.HEADINGS``, units in ``targets``.

    Attributes:
        by: Columns whose values make the lines, separated by spaces.
        columns: The other columns, separated by spaces.
        where: The rows that it is made of.
        section: A column of which each value has a table of its own, with the value as its heading.
        title: Its heading, where it has no sections.
        across: A column whose values each have the columns ``each``, side by side.
        each: These columns.
        summary: Last lines for each method: any of mean, std and worst.
        take: What is taken of values in place of their mean.
        length: Unit of lengths.
    """

    by: str
    columns: str
    where: Where = EVERY
    section: str | None = None
    title: str | None = None
    across: str | None = None
    each: str = ""
    summary: str = ""
    take: str = "mean"
    length: str = "cm"


class Target(NamedTuple):
    """A figure that a study can set a target for, or that the paper has.

    Name and title may hold columns in braces, also {label}, the method in words, and {count}, the number of values.

    Attributes:
        name: Its name in a study's ``target`` and ``paper``.
        title: What it measures.
        of: A column as in a table; what is taken is the mean, median, share, count, or ratio of the means of all.
        where: The rows that it is measured on.
        base: Other rows, by whose mean the mean of these is divided.
        base_of: Their column; none: the same.
        each: A column; the mean of the worst of its groups counts.
        per: Columns of which each combination has a figure, separated by spaces.
        at_least: Whether a target is a minimum rather than a maximum.
        unit: One of ``targets.FORMS``; none: that of the column.
    """

    name: str
    title: str
    of: str
    where: Where = EVERY
    base: Where | None = None
    each: str | None = None
    per: str = ""
    at_least: bool = False
    unit: str | None = None
    base_of: str | None = None


class Dots(NamedTuple):
    """A line for each case, with errors along a logarithmic axis: runs small, their mean large; the paper's a diamond.

    Attributes:
        line: Columns that make a case, separated by spaces.
        panel: A column of which each value has a panel.
        marks: Title of a panel, and the columns drawn filled and open [m].
        words: What filled and open mean.
        clean: Rows of each method whose means are drawn as lines through all cases.
        cross: Rows whose first error is crossed out.
    """

    line: str
    panel: str | None = None
    marks: tuple[tuple[str, str, str], ...] = (("", "rms_m", "median_m"),)
    words: str = "filled: RMS, open: median"
    clean: Where | None = None
    cross: Where | None = None


class Curves(NamedTuple):
    """A curve for each method along an axis, with a band from the least to the greatest of the seeds.

    Attributes:
        panel: A column of which each value has a panel.
        axis: The column along which curves run.
        label: What the axis is, in words or in a column of this name; None: the panel's name.
        of: The values, drawn times 100.
        unit: Their unit.
        also: Other columns of the methods that have them, and their words.
        lines: Columns that all methods share, and what each of them is.
        even: Whether the values of the axis are evenly spaced.
        where: The rows that are drawn.
    """

    panel: str
    axis: str
    label: str | None = None
    of: str = "rms_m"
    unit: str = "error [cm]"
    also: Mapping[str, str] = EVERY
    lines: Mapping[str, str] = EVERY
    even: bool = False
    where: Where = EVERY


class Scatter(NamedTuple):
    """A point for each row.

    Attributes:
        points: Columns along the two axes, and the title of each panel.
        by: The column that gives the colour.
        panel: A column of which each value has a panel, in place of the titles.
        bars: Columns of the lower and upper ends of intervals of the second.
        equal: Whether a line is drawn where both are equal.
        log: Whether both axes are logarithmic.
        limit: Where a vertical line is drawn.
        factor: By which values are multiplied.
        where: The rows that are drawn.
    """

    points: tuple[tuple[str, str, str], ...]
    by: str
    labels: tuple[str, str]
    panel: str | None = None
    bars: tuple[str, str] | None = None
    equal: bool = False
    log: bool = False
    limit: float | None = None
    factor: float = 100.0
    where: Where = EVERY


class Fields(NamedTuple):
    """The error field of the run with the median RMS of each case, and the errors at the ends of the colours [m]."""

    by: str
    scale_m: tuple[float, float] = (0.01, 1.0)


Picture = Dots | Curves | Scatter | Fields | str
"""A string names a function "module:function" (rows, the study's folder) -> a figure."""


@dataclass(frozen=True)
class StudyReport:
    """One report. Functions that need torch or matplotlib are named "module:function", modules from this package.

    Attributes:
        tables: Its tables, in order.
        note: How to read them.
        prepare: (measured rows, names that vary) -> the rows that all else is made of.
        more: (prepared rows, names that vary) -> further blocks of text, below the tables.
        targets: Figures with targets.
        pictures: By file name.
        columns: (run folder, row) -> the report's own columns in the study's table.
        draw_runs: (the study's ``set``, its drives as seed and settings) -> seeds and settings of the runs.
        gather: (plans, failures, the study's folder) -> rows, of a study whose runs are diagnosed and not trained.
        varies: Settings that must vary in the study's cases or axes, by dotted name.
        sets: Settings that the study must set, or vary.
        fixes: Settings that must be a number in the study's ``set``, and cannot vary.
        networks: Whether it needs methods that train a network.
        labels: Whether it needs recordings with labels from tags.
    """

    tables: tuple[Table, ...]
    note: str = ""
    prepare: Callable[[Sequence[Row], Sequence[str]], list[Row]] | None = None
    more: Callable[[Sequence[Row], Sequence[str]], list[str]] | None = None
    targets: Sequence[Target] = ()
    pictures: Mapping[str, Picture] = field(default_factory=dict)
    columns: str | None = None
    draw_runs: Callable | None = None
    gather: Callable | None = None
    varies: tuple[str, ...] = ()
    sets: tuple[str, ...] = ()
    fixes: tuple[str, ...] = ()
    networks: bool = False
    labels: bool = False


GRID = "Errors on the test grid, for the worst heading of each position; aligned on training samples, never scaled. "
ERRORS = "rms_m median_m p95_m max_m"
"""The errors that every report shows."""
PAPERS_ERRORS = {"rms_m": "RMS", "median_m": "median", "max_m": "max"}
"""The errors in the paper's tables, in words."""
ACCEPTED = "rms_accepted_m max_accepted_m accepted"
"""The errors of what a method accepts, and the share of images that it accepts."""
RATIOS = "rms_m/base median_m/base p95_m/base max_m/base"
