"""The plain report: every run and method as a line of its own."""

from collections.abc import Sequence

from deepgps.config.methods import title_of
from deepgps.reports.table import tabulate
from deepgps.studies.table import ACCEPTED_NOTE, ERRORS, Row, choose_accepted, write_accepted, write_errors


def report(rows: Sequence[Row], varied: Sequence[str]) -> list[str]:
    """A table with one line for each run and method."""
    accepted = choose_accepted(rows)
    cells = [
        [
            *(str(row[name]) for name in varied),
            title_of(row["method"]),
            *write_errors(row),
            *write_accepted([row], accepted),
        ]
        for row in rows
    ]
    return [
        tabulate([*varied, "method", *ERRORS.values(), *accepted.values()], cells),
        *([ACCEPTED_NOTE] if accepted else []),
    ]
