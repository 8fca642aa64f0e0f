"""The rows of a bench: each a figure with its target and that of a naive baseline, as a table and as a file."""

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rich import box
from rich.markup import escape
from rich.table import Table

from deepgps.reports.targets import judge
from sim.errors import InputError
from sim.files.json_files import read_json, write_json

SCHEMA = 2
KEPT = Path("runs") / "bench"


@dataclass(frozen=True)
class Row:
    """One figure.

    Attributes:
        name: Name of the figure in files.
        title: What the figure measures, in words.
        value: The measured value; none: not measured.
        unit: Unit of value, target and naive.
        target: The required value; none: the figure is only shown.
        at_least: Whether the target is a minimum rather than a maximum.
        naive: The same figure for the naive baseline, measured in the same bench.
        note: What the naive baseline is, or how the figure was measured.
    """

    name: str
    title: str
    value: float | None
    unit: str
    target: float | None = None
    at_least: bool = False
    naive: float | None = None
    note: str = ""

    @property
    def verdict(self) -> str:
        """The verdict on the target: met, missed, not measured, or empty without a target."""
        return judge(self.value, self.target, self.at_least)


def tabulate(rows: Sequence[Row], before: dict[str, float | None] | None = None) -> Table:
    """A table for the terminal, with the figures of an earlier bench by name if there is one."""
    table = Table(box=box.SIMPLE_HEAD, show_edge=False, padding=(0, 1, 0, 0))
    table.add_column("figure")
    for heading in ("measured", "target", "verdict", "naive", *(["before"] if before is not None else [])):
        table.add_column(heading, justify="left" if heading == "verdict" else "right", no_wrap=True)
    for row in rows:
        sign = ">= " if row.at_least else "<= "
        target = "" if row.target is None else sign + write_value(row.target, row.unit)
        earlier = [] if before is None else [write_value(before.get(row.name), row.unit)]
        style = {"missed": "red", "met": "green"}.get(row.verdict, "yellow")
        cells = [write_value(row.value, row.unit), target, f"[{style}]{row.verdict}[/{style}]"]
        table.add_row(escape(row.title), *cells, write_value(row.naive, row.unit), *earlier)
    return table


def list_notes(rows: Sequence[Row]) -> list[str]:
    """The notes on the figures, a line for each different note, after the titles of the rows that share it."""
    titles: dict[str, list[str]] = {}
    for row in rows:
        titles.setdefault(row.note, []).append(row.title)
    return [f"{', '.join(names)}: {note}" for note, names in titles.items() if note]


def write_value(value: float | None, unit: str) -> str:
    """A figure to three digits, or a dash."""
    if value is None:
        return "-"
    digits = 2 if value == 0.0 else max(0, min(4, 2 - math.floor(math.log10(abs(value)))))
    return f"{value:,.{digits}f} {unit}".rstrip()


def write_bench(path: Path, rows: Sequence[Row], head: dict[str, Any]) -> None:
    """Write a bench: ``head``, which describes how it was made, and its rows with their verdicts."""
    write_json(path, {"schema": SCHEMA, **head, "rows": [{**asdict(row), "verdict": row.verdict} for row in rows]})


def read_bench(path: Path) -> dict[str, float | None]:
    """Figures of a bench by name; raises InputError if the file is missing or no bench."""
    if not path.is_file():
        raise InputError(f"bench {path}: no such file")
    if not is_bench(path.read_bytes()):
        raise InputError(f"{path} is no bench: deepgps bench writes one")
    bench = read_json(path)
    if bench["schema"] != SCHEMA:
        raise InputError(f"{path}: schema {bench['schema']!r}, but this version reads schema {SCHEMA}")
    return {row["name"]: row["value"] for row in bench["rows"]}


def is_bench(data: bytes) -> bool:
    """Whether these are the contents of a bench file."""
    try:
        bench = json.loads(data)
        return "schema" in bench and all({"name", "value"} <= set(row) for row in bench["rows"])
    except (ValueError, KeyError, TypeError, RecursionError):
        return False


def find_before(against: str | None) -> dict[str, float | None] | None:
    """Figures to compare with, of the last bench that was kept or of a file; raises InputError if there is none."""
    if against is None:
        return None
    if against != "last":
        return read_bench(Path(against))
    kept = sorted(KEPT.glob("*.json"))
    if not kept:
        raise InputError(f"--against last: no earlier bench was kept in {KEPT}")
    return read_bench(kept[-1])
