"""A table and sentences, written as Markdown or printed in the terminal."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

Column = tuple[str, str, Callable[[Any], str]]  # Heading of a column, key of its figures, and how one is written


def write_hundredths(value: float) -> str:
    """A length [m] in centimetres, or a share in per cent."""
    return f"{100 * value:.1f}"


def write_centimetres(value: float) -> str:
    """A length [m] in centimetres, from 100 on without decimals."""
    return f"{100 * value:.0f}" if value >= 0.9995 else f"{100 * value:.1f}"


def choose(columns: Sequence[Column], figures: Iterable[Mapping[str, Any]]) -> list[Column]:
    """The columns that any of these figures has."""
    known = {key for one in figures for key, value in one.items() if value is not None}
    return [column for column in columns if column[1] in known]


def head(columns: Sequence[Column]) -> list[str]:
    """The headings of columns."""
    return [heading for heading, _, _ in columns]


def fill(columns: Sequence[Column], figures: Mapping[str, Any], unknown: str = "-") -> list[str]:
    """The cells of a row with these figures."""
    return [unknown if figures.get(key) is None else write(figures[key]) for _, key, write in columns]


def tabulate(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table with aligned columns, numbers right-aligned; readable as plain text."""
    columns = list(zip(headings, *rows, strict=True))
    widths = [max(map(len, column)) for column in columns]
    numbers = [all(cell[:1] in "0123456789-" for cell in column[1:]) for column in columns]
    rule = ["-" * (width - right) + ":" * right for width, right in zip(widths, numbers, strict=True)]
    cells = (zip(row, widths, numbers, strict=True) for row in (headings, rule, *rows))
    lines = ([text.rjust(width) if right else text.ljust(width) for text, width, right in row] for row in cells)
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def print_table(
    console: Console, headings: Sequence[str], rows: Sequence[Sequence[str]], title: str | None = None, bold: str = ""
) -> None:
    """Print a table whose first column is text and whose others are numbers; units in brackets are below their heading.

    Rows whose first cell is ``bold`` are printed in bold.
    """
    table = Table(box=box.SIMPLE_HEAD, title=title, title_justify="left", padding=0, show_edge=False)
    for index, heading in enumerate(headings):
        # a unit below the name keeps the table within 80 columns; escaped, since rich reads [cm] as a style
        name = escape(heading.replace(" [", "\n["))
        table.add_column(name, justify="right" if index else "left", no_wrap=index == 0)
    for row in rows:
        table.add_row(*map(escape, row), style="bold" if row[0] == bold else None)
    console.print(table)


def say(console: Console, *sentences: str, style: str | None = None) -> None:
    """Print sentences as they are, each on a line."""
    for sentence in sentences:
        console.print(sentence, style=style, markup=False, highlight=False, soft_wrap=True)
