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
VARIED_SETTINGS, CHOICES = "*varied", "*choices"
"""In place of a column: all settings that vary in the study; the same without seeds, which only repeat runs."""
EVERY_ROW: Where = {}


class Table(NamedTuple):
    """A table with a line for each combination of values.

    A cell is the mean of a line's values, the number of those that are true, or the first text; a column may name what
    is taken instead, as in ``rms_m:max``. ``rms_m/base`` is the mean of rms_m by that of base_rms_m, and ``runs``
    counts rows. A column without any value is left out. Headings are in ``render.HEADINGS``, units in ``targets``.
    """

    by: str  # Columns whose values make the lines, separated by spaces
    columns: str  # The other columns, separated by spaces
    where: Where = EVERY_ROW  # The rows that it is made of
    section: str | None = None  # A column of which each value has a table of its own, with the value as its heading
    title: str | None = None  # Its heading, where it has no sections
    across: str | None = None  # A column whose values each have the columns ``each``, side by side
    each: str = ""  # These columns
    summary: str = ""  # Last lines for each method: any of mean, std and worst
    take: str = "mean"  # What is taken of values in place of their mean
    length: str = "cm"  # Unit of lengths


class Target(NamedTuple):
    """A figure that a study can set a target for, or that the paper has.

    Name and title may hold columns in braces, also {label}, the method in words, and {count}, the number of values.
    """

    name: str  # Its name in a study's ``target`` and ``paper``
    title: str  # What it measures
    of: str  # A column as in a table; what is taken is the mean, median, share, count, or ratio of the means of all
    where: Where = EVERY_ROW  # The rows that it is measured on
    base: Where | None = None  # Other rows, by whose mean the mean of these is divided
    each: str | None = None  # A column; the mean of the worst of its groups counts
    per: str = ""  # Columns of which each combination has a figure, separated by spaces
    at_least: bool = False  # Whether a target is a minimum rather than a maximum
    unit: str | None = None  # One of ``targets.FORMS``; none: that of the column
    base_of: str | None = None  # Their column; none: the same


class Dots(NamedTuple):
    """A line for each case, errors along a logarithmic axis: runs small, their mean large, the paper's a diamond."""

    line: str  # Columns that make a case, separated by spaces
    panel: str | None = None  # A column of which each value has a panel
    # Title of a panel, and the columns drawn filled and open [m]
    marks: tuple[tuple[str, str, str], ...] = (("", "rms_m", "median_m"),)
    words: str = "filled: RMS, open: median"  # What filled and open mean
    clean: Where | None = None  # Rows of each method whose means are drawn as lines through all cases
    cross: Where | None = None  # Rows whose first error is crossed out


class Curves(NamedTuple):
    """A curve for each method along an axis, with a band from the least to the greatest of the seeds."""

    panel: str  # A column of which each value has a panel
    axis: str  # The column along which curves run
    label: str | None = None  # What the axis is, in words or in a column of this name; None: the panel's name
    of: str = "rms_m"  # The values, drawn times 100
    unit: str = "error [cm]"  # Their unit
    also: Mapping[str, str] = EVERY_ROW  # Other columns of the methods that have them, and their words
    lines: Mapping[str, str] = EVERY_ROW  # Columns that all methods share, and what each of them is
    even: bool = False  # Whether the values of the axis are evenly spaced
    where: Where = EVERY_ROW  # The rows that are drawn


class Scatter(NamedTuple):
    """A point for each row, with the interval of the second value, and a line where both values are equal."""

    x: str  # Columns along the two axes
    y: str
    by: str  # The column that gives the colour
    labels: tuple[str, str]
    bars: tuple[str, str]  # Columns of the lower and upper ends of intervals of the second
    panel: str | None = None  # A column of which each value has a panel
    factor: float = 100.0  # By which values are multiplied
    where: Where = EVERY_ROW  # The rows that are drawn


class Fields(NamedTuple):
    """The error field of the run with the median RMS of each case, and the errors at the ends of the colours [m]."""

    by: str
    scale_m: tuple[float, float] = (0.01, 1.0)


Picture = Dots | Curves | Scatter | Fields


@dataclass(frozen=True)
class StudyReport:
    """One report."""

    tables: tuple[Table, ...]  # Its tables, in order
    note: str = ""  # How to read them
    # (measured rows, names that vary) -> the rows that all else is made of
    prepare: Callable[[Sequence[Row], Sequence[str]], list[Row]] | None = None
    # (prepared rows, names that vary) -> further blocks of text, below the tables
    more: Callable[[Sequence[Row], Sequence[str]], list[str]] | None = None
    targets: Sequence[Target] = ()  # Figures with targets
    pictures: Mapping[str, Picture] = field(default_factory=dict)  # By file name
    # "module:function", modules from this package, which may need torch; see ``report.AddColumns``
    columns: str | None = None
    # (the study's ``set``, its drives as seed and settings) -> seeds and settings of the runs
    draw_runs: Callable | None = None
    varies: tuple[str, ...] = ()  # Settings that must vary in the study's cases or axes, by dotted name


GRID = "Errors on the test grid, for the worst heading of each position; aligned on training samples, never scaled. "
ERRORS = "rms_m median_m p95_m max_m"  # The errors that every report shows
PAPERS_ERRORS = {"rms_m": "RMS", "median_m": "median", "max_m": "max"}  # The errors in the paper's tables, in words
ACCEPTED_ERRORS = "rms_accepted_m max_accepted_m accepted"
"""The errors of what a method accepts, and the share of images that it accepts."""
RATIOS = "rms_m/base median_m/base p95_m/base max_m/base"
