"""The report of seeds: how many maps are folded according to the truth, and according to the detector without it."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure as Picture

from deepgps.reports.table import tabulate
from deepgps.reports.targets import Figure, share_of, write
from deepgps.studies.table import ERRORS, Row, write_errors

# In maps of 8,000 images, 1 to 5 % of the neighbourhoods were flipped if the map was right, 21 to 47 % if folded.
FLIPPED = 0.1


def report(rows: Sequence[Row], varied: Sequence[str]) -> list[str]:
    """A table with a line for each kind of start, and a note on how to read it."""
    headings = ["start", "maps", "unfolded", "said to be", "flipped, median", "flipped, most", *ERRORS.values()]
    cells = []
    for title, group in _by_start(rows, varied).items():
        flipped = [row["flipped"] for row in group if row["flipped"] is not None]
        unfolded = str(sum(share <= FLIPPED for share in flipped)) if flipped else "-"
        said = sum(not row["fold_found"] for row in group)
        shares = [write(float(choose(flipped)) if flipped else None, "%") for choose in (np.median, np.max)]
        middle = {name: float(np.median([row[name] for row in group])) for name in ERRORS}
        cells.append([title, str(len(group)), unfolded, str(said), *shares, *write_errors(middle)])
    note = (
        f"A map is folded if it flips more than {write(FLIPPED, '%')} of the test grid's neighbourhoods; "
        "said to be: how many maps the detector reports as unfolded. Errors are medians over the maps."
    )
    return [tabulate(headings, cells), note]


def measure(rows: Sequence[Row]) -> dict[str, Figure]:
    """Share of unfolded maps, except random starts, which are meant to fold; and the detector's rates over all maps."""
    rows = [row for row in rows if row["fold_found"] is not None and row["flipped"] is not None]
    own = [not is_folded(row) for row in rows if row.get("learn.start") != "random"]
    folded = [row["fold_found"] for row in rows if is_folded(row)]
    right = [row["fold_found"] for row in rows if not is_folded(row)]
    return {
        "unfolded": share_of(f"unfolded, of {len(own)} maps without random starts", own),
        "found": share_of(f"folds found, of {len(folded)}", folded),
        "false_alarms": share_of(f"false alarms, of {len(right)} unfolded maps", right, at_least=False),
    }


def draw(rows: Sequence[Row], varied: Sequence[str], folder: Path) -> Picture:
    """Draw what the detector measures over the truth, with a point for each map."""
    picture = Picture(figsize=(9, 4), layout="constrained")
    signs = {"length_error_fraction": "length errors", "overlap_fraction": "overlap"}
    for index, (sign, title) in enumerate(signs.items()):
        axes = picture.add_subplot(1, 2, index + 1)
        for start, group in _by_start(rows, varied).items():
            known = [row for row in group if row["flipped"] is not None]
            flipped, said = ([100 * row[name] for row in known] for name in ("flipped", sign))
            axes.plot(flipped, said, "o", alpha=0.6, label=start)
        axes.axvline(100 * FLIPPED, color="#999999", linestyle=":")
        axes.set(xlabel="flipped (truth) [%]", ylabel=f"{title} (detector) [%]", xlim=(0, 50))
        axes.set_ylim(bottom=0)
        axes.grid(alpha=0.25)
        if index == 0:
            axes.legend(frameon=False, fontsize=8)
    return picture


def is_folded(row: Row) -> bool:
    """Whether a map is folded according to the truth."""
    return row["flipped"] > FLIPPED


def count_folded(rows: Sequence[Row]) -> str:
    """The number of maps that are folded according to the truth; a dash if there was no test grid to judge by."""
    known = [row for row in rows if row["flipped"] is not None]
    return str(sum(map(is_folded, known))) if known else "-"


def _by_start(rows: Sequence[Row], varied: Sequence[str]) -> dict[str, list[Row]]:
    groups: dict[str, list[Row]] = {}
    for row in rows:
        if row["fold_found"] is not None:
            title = ", ".join(f"{name} {row[name]}" for name in varied if name != "learn.seed")
            groups.setdefault(title or "all", []).append(row)
    return groups
