"""The picture of diagnoses: each quantity as found, with its interval, over what it is."""

from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure

from deepgps.studies.reports.diagnose import QUANTITIES, holds
from deepgps.studies.table import Row

UNITS = {"track_m": " [m]", "slip_per_m": " [m]"}
"""Units of the quantities that have one."""
HELD, MISSED = "#2a6f97", "#d1495b"


def draw(rows: Sequence[Row], varied: Sequence[str], folder: Path) -> Figure:
    """Draw found over true for each quantity; intervals that do not hold are red."""
    picture = Figure(figsize=(12, 6), layout="constrained")
    for number, (name, title) in enumerate(QUANTITIES.items()):
        axes = picture.add_subplot(2, 4, number + 1)
        true = [row[f"{name}_true"] for row in rows]
        low, high = min(true), max(true)
        axes.plot([low, high], [low, high], color="#999999", linewidth=0.8)
        for held, colour in ((True, HELD), (False, MISSED)):
            some = [row for row in rows if holds(row, name) == held]
            x, y = [row[f"{name}_true"] for row in some], [row[name] for row in some]
            bars = [[row[name] - row[f"{name}_low"] for row in some], [row[f"{name}_high"] - row[name] for row in some]]
            if some:
                label = "interval holds" if held else "does not"
                axes.errorbar(x, y, bars, fmt="o", color=colour, markersize=3, linewidth=0.8, alpha=0.7, label=label)
        axes.set(title=title + UNITS.get(name, ""), xlabel="set", ylabel="found")
        axes.grid(alpha=0.25)
        if number == 0:
            axes.legend(frameon=False, fontsize=8)
    return picture
