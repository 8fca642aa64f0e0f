"""The report of initial maps by compass: their errors before any training, beside what they expect of themselves."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure as Picture

from deepgps.reports.style import count_by_decades
from deepgps.reports.table import tabulate
from deepgps.reports.targets import Figure, median_of
from deepgps.studies.reports.rooms import name_room
from deepgps.studies.table import Row, split_by

MIRRORED_M2 = 0.1
"""A map is mirrored in part if the largest connected patch that it turns over has more than this area [m^2]."""
NOISE, SLIP = "encoder.step_noise", "encoder.slip_per_m"
NOTE = (
    "RMS errors of the initial map at the training images, after a rigid alignment, and the error that the map's own "
    "covariance expects. NEES / 2: squared error over that covariance; 1 if the covariance is right, larger if the map "
    f"is too sure. Mirrored: maps with a connected patch of more than {MIRRORED_M2:g} m2 of reversed neighbourhoods. "
    "Methods without a map by compass are left out."
)


def report(rows: Sequence[Row], varied: Sequence[str]) -> list[str]:
    """A line for each encoder over all rooms, a note, and a line for each map."""
    rows = _take_maps(rows)
    headings = ["encoder", "maps", "RMS, median [cm]", "RMS, worst [cm]", "expected [cm]", "NEES / 2", "mirrored"]
    cells = []
    for name, group in _split(rows).items():
        rms, expected, nees = ([row[f"map_{part}"] for row in group] for part in ("rms_m", "expected_rms_m", "nees"))
        errors = [f"{100 * value:.2f}" for value in (np.median(rms), max(rms), np.median(expected))]
        mirrored = f"{sum(map(is_mirrored, group))} of {len(group)}"
        cells.append([name, str(len(group)), *errors, f"{np.median(nees):.2f}", mirrored])
    places = [name for name in varied if name not in (NOISE, SLIP)]
    columns = ["room", "seed", "encoder", "RMS [cm]", "expected [cm]", "NEES / 2", "mirrored [m2]"]
    each = [
        [
            *(name_room(row, places), str(row["seed"]), _name(row)),
            *(f"{100 * row[f'map_{part}']:.2f}" for part in ("rms_m", "expected_rms_m")),
            *(f"{row['map_nees']:.2f}", f"{row['map_flipped_m2']:.2f}"),
        ]
        for row in rows
    ]
    return [tabulate(headings, cells), NOTE, tabulate(columns, each)]


def measure(rows: Sequence[Row]) -> dict[str, Figure]:
    """How many maps are mirrored in part; and for each encoder the median RMS and NEES / 2."""
    rows = _take_maps(rows)
    mirrored = sum(map(is_mirrored, rows))
    figures = {"mirrored": Figure(f"maps mirrored in part, of {len(rows)}", mirrored, "count")}
    for name, group in _split(rows).items():
        for part, title, unit in (("rms_m", "RMS of the map", "cm"), ("nees", "NEES / 2", "")):
            values = [row[f"map_{part}"] for row in group]
            figures[f"{part} {name}"] = median_of(f"{title}, {name}", values, unit)
    return figures


def draw(rows: Sequence[Row], varied: Sequence[str], folder: Path) -> Picture:
    """Draw each map's error against the error that it expects of itself, a colour for each encoder."""
    picture = Picture(figsize=(5.5, 5), layout="constrained")
    axes = picture.add_subplot()
    for name, group in _split(_take_maps(rows)).items():
        errors = 100 * np.array([(row["map_expected_rms_m"], row["map_rms_m"]) for row in group])
        axes.plot(*errors.T, "o", alpha=0.7, label=name)
    limits = np.array([axes.get_xlim(), axes.get_ylim()])
    ends = [max(limits.min(), 0.05), limits.max()]
    axes.plot(ends, ends, color="0.6", lw=1, zorder=0, label="as expected")
    axes.set(xscale="log", yscale="log", xlabel="expected RMS error [cm]", ylabel="RMS error [cm]")
    for axis in (axes.xaxis, axes.yaxis):
        count_by_decades(axis)
    axes.grid(alpha=0.25, which="both")
    axes.legend(frameon=False)
    return picture


def is_mirrored(row: Row) -> bool:
    """Whether a connected patch of the map larger than ``MIRRORED_M2`` is turned over."""
    return row["map_flipped_m2"] > MIRRORED_M2


def _take_maps(rows: Sequence[Row]) -> list[Row]:
    """The rows of methods with a map by compass; others know no error of theirs."""
    return [row for row in rows if row["map_rms_m"] is not None]


def _split(rows: Sequence[Row]) -> dict[str, list[Row]]:
    return split_by([{**row, "encoder": _name(row)} for row in rows], "encoder")


def _name(row: Row) -> str:
    noise, slip = row.get(NOISE) or 0.0, row.get(SLIP) or 0.0
    faults = [f"{word} {value:g}" for word, value in (("w", noise), ("slip", slip)) if value]
    return ", ".join(faults) or "exact"
