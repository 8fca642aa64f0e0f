"""``python -m docs.shorten FOLDER...``: published studies as short pages; ``table.parquet`` beside each has every run.

A page keeps at most ten rows and eight columns: the report's first table if it is short, or its means, and the figures
that have a verdict, if they fit. Otherwise it keeps the summary.
"""

import re
import sys
from collections.abc import Sequence
from pathlib import Path

from deepgps.reports.table import tabulate

ROWS, COLUMNS = 10, 8
LESSER_COLUMNS = (
    *("runs", "images", "outputs", "RMS, most [cm]", "said", "train [s]", "RMS / side [%]", "RMS / base"),
    *("seen [%]", "flipped [%]", "unlabelled", "unlabelled, test", "labels rms [cm]", "stored million", "p95 [cm]"),
    *("headings [cm]", "max of accepted [cm]", "accepted [%]", "RMS of accepted [cm]", "travel [m]", "max [cm]"),
)
"""Columns that a page can do without, the least important first."""
Table = list[list[str]]


def shorten(report: str) -> str:
    """The page of a study's report, without the lines that say where it was made."""
    blocks = report.strip().split("\n\n")
    tables = [_read(block) for block in blocks if block.startswith("|")]
    summary = _read(blocks[blocks.index("## Summary") + 1])
    judged = [summary[0], *(row for row in summary[1:] if {"met", "missed"} & set(row))]
    first = _drop_columns(_drop_rows(tables[0]))
    if len(first) > ROWS + 1 or len(first[0]) > COLUMNS:
        chosen = [summary if len(summary) <= ROWS + 1 else judged[: ROWS + 1]]
    else:
        chosen = [first, *([judged] if 1 < len(judged) <= ROWS + 3 - len(first) - 1 else [])]
    cells = (cell for table in chosen for cell in [*table[0], *(row[0] for row in table[1:])])
    headings = {cell.split(" [")[0].lower() for cell in cells}
    notes = [_drop_sentences(block, headings) for block in blocks[2:] if block[0] not in "#|"]
    title = [block for block in blocks[2:3] if block[0] == "#" and chosen[0] is first]
    page = [*blocks[:2], *title, *(tabulate(table[0], table[1:]) for table in chosen), *filter(None, notes)]
    name = blocks[0].strip("# ").replace("-full", " --full").replace("-tiny", " --tiny")
    link = f"Every run is in [table.parquet](table.parquet); `deepgps study {name}` writes the complete report."
    return "\n\n".join([*page, link]) + "\n"


def _read(block: str) -> Table:
    """The cells of a Markdown table, without the rule."""
    lines = [[cell.strip() for cell in line.strip("|").split("|")] for line in block.splitlines()]
    return [lines[0], *lines[2:]]


def _drop_rows(table: Table) -> Table:
    """The means of a long table, or what there is."""
    means = [row for row in table[1:] if row[0].split()[0] in {"mean", "worst", "paper"}]
    if len(table) <= ROWS + 1 or not means:
        return table
    kept = [index for index in range(len(table[0])) if any(row[index] for row in means)]
    return [[row[index] for index in kept] for row in [table[0], *means]]


def _drop_columns(table: Table) -> Table:
    lost = [name for name in LESSER_COLUMNS if name in table[0]][: max(0, len(table[0]) - COLUMNS)]
    kept = [index for index, name in enumerate(table[0]) if name not in lost]
    return [[row[index] for index in kept] for row in table]


def _drop_sentences(note: str, headings: set[str]) -> str:
    """A note without what it says of columns that are gone, and without sign tests but against baselines."""
    if re.match(r"Of \d+ rooms", note):
        return note if "than PoseNet in" in note or "than Nearest neighbour in" in note else ""
    kept, keep = [], True
    for sentence in re.split(r"(?<=[.;]) ", note):
        if label := re.match(r"([\w ]{3,30}):", sentence):  # what follows a label belongs to it
            keep = any(label[1].lower() in heading for heading in headings)
        if keep and not sentence.startswith("in brackets"):
            kept.append(sentence)
    return f"{' '.join(kept)[:-1]}." if kept else ""


def main(folders: Sequence[str]) -> None:
    """Shorten the page of each folder."""
    for folder in map(Path, folders):
        page = folder / "table.md"
        text = page.read_text(encoding="utf-8")
        at = text.index("\n\n", text.rindex("\n|")) + 2  # the last table is followed by doubts and the origin
        rest = re.sub(r"^- .*\n+", "", text[at:], flags=re.MULTILINE)  # runs that doubt are counted, and not listed
        page.write_text(f"{shorten(text[:at])}\n{rest}", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
