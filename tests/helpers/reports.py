"""Reading what reports of studies say."""

from collections.abc import Sequence

from deepgps.reports.targets import Figure
from deepgps.studies.catalog import REPORTS
from deepgps.studies.reports.render import measure, prepare, write_blocks
from deepgps.studies.table import Row


def read_cells(text: str, headings: bool = False) -> list[list[str]]:
    """The cells of all lines of Markdown tables."""
    lines = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines() if line.startswith("|")]
    lines = [line for line in lines if not set("".join(line)) <= set("-:")]
    return lines if headings else lines[1:]


def find_line(text: str, *first: str) -> list[str]:
    """The other cells of the one line that begins with these."""
    (line,) = [line for line in read_cells(text, headings=True) if tuple(line[: len(first)]) == first]
    return line[len(first) :]


def report_rows(name: str, rows: Sequence[Row], varied: Sequence[str] = ()) -> tuple[str, dict[str, Figure]]:
    """What a report says of measured rows, and its figures."""
    report = REPORTS[name]
    prepared = prepare(report, rows, varied)
    return "\n\n".join(write_blocks(report, prepared, varied)), measure(report, prepared)


def values_of(name: str, rows: Sequence[Row], varied: Sequence[str] = ()) -> dict[str, float | None]:
    """The values of a report's figures."""
    return {key: figure.value for key, figure in report_rows(name, rows, varied)[1].items()}
