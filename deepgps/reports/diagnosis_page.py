"""The page of a diagnosis: what is wrong with these wheels, how sure that is, what to set, and what cannot be known."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from deepgps.diagnosis.diagnosis import Diagnosis, Estimate
from deepgps.diagnosis.findings import UNKNOWN, Finding, find_faults, list_smallest
from deepgps.reports.markdown import tabulate

ALL_WELL = "Nothing is wrong with these wheels, as far as the robot's own sensors can tell."
NOT_MEASURED = "Too little of the drive could be used to tell what is wrong with these wheels."
HEADINGS = ("quantity", "found", "95 % interval", "assumed", "detectable")


@dataclass(frozen=True)
class Quantity:
    """How an estimate is written: its title, unit, the unit's size, its decimals, and the fault that it shows."""

    title: str
    unit: str
    size: float
    decimals: int
    fault: str


QUANTITIES = {
    "track_m": Quantity("track width, with these radii", "mm", 1e-3, 2, "track"),
    "reading_ratio": Quantity("readings, right over left", "", 1.0, 4, "radius"),
    "wheel_ratio": Quantity("radius, right over left", "", 1.0, 4, "wheel"),
    "step_noise": Quantity("noise of a gap", "%", 1e-2, 2, "step_noise"),
    "slip_per_m": Quantity("slip in a metre", "mm", 1e-3, 2, "slip"),
    "tick_m": Quantity("tick", "mm", 1e-3, 2, "ticks"),
    "dropout": Quantity("readings lost", "%", 1e-2, 2, "dropout"),
    "stuck_fraction": Quantity("gaps with a stuck wheel", "%", 1e-2, 2, "stuck"),
}


def list_rows(diagnosis: Diagnosis) -> list[list[str]]:
    """A row for each quantity: its title, value, interval, what is assumed, and the smallest detectable fault."""
    least, odometry = list_smallest(diagnosis), diagnosis.odometry
    tick_m = 2 * np.pi * odometry["wheel_radius_m"] / odometry["ticks_per_rev"]
    assumed = {"track_m": odometry["track_m"], "reading_ratio": 1.0, "wheel_ratio": 1.0, "tick_m": tick_m}
    rows = []
    for name, quantity in QUANTITIES.items():
        estimate, smallest = diagnosis.quantities[name], least[quantity.fault]
        if quantity.fault == "track":
            smallest *= odometry["track_m"]
        off = "+-" if quantity.fault in {"track", "radius", "wheel"} else ""
        right = _write(assumed.get(name, 0.0), quantity)
        rows.append([quantity.title, *_tell(estimate, quantity), right, off + _write(smallest, quantity)])
    return rows


def write_markdown(diagnosis: Diagnosis) -> str:
    """The page in Markdown."""
    faults = find_faults(diagnosis)
    blocks = ["# What is wrong with these wheels", *_list_findings(diagnosis, faults)]
    blocks += [tabulate(HEADINGS, list_rows(diagnosis)), _say_how(diagnosis), UNKNOWN]
    return "\n\n".join(blocks) + "\n"


def print_diagnosis(diagnosis: Diagnosis, console: Console) -> None:
    """Print the page: faults, then the table, then what cannot be known."""
    faults = find_faults(diagnosis)
    well = not faults and _is_measured(diagnosis)
    for line in _list_findings(diagnosis, faults):
        console.print(line + "\n", style="green" if well else "yellow", markup=False, highlight=False, soft_wrap=True)
    table = Table(box=box.SIMPLE_HEAD, padding=0, show_edge=False)
    for index, heading in enumerate(HEADINGS):
        table.add_column(heading, justify="left" if index == 0 else "right")
    for row in list_rows(diagnosis):
        table.add_row(*row)
    console.print(table)
    for line in (_say_how(diagnosis), UNKNOWN):
        console.print(f"\n{line}", highlight=False, markup=False, soft_wrap=True)


def _is_measured(diagnosis: Diagnosis) -> bool:
    """Whether enough turns and images could be used to know the track width and the radii."""
    return diagnosis.track_m.known and diagnosis.wheel_ratio.known


def _list_findings(diagnosis: Diagnosis, faults: Sequence[Finding]) -> list[str]:
    if not faults:
        return [ALL_WELL if _is_measured(diagnosis) else NOT_MEASURED]
    return [
        f"{number}. {one.text}\n   Set: {one.cure}.\n   In the simulator: {one.setting}"
        for number, one in enumerate(faults, start=1)
    ]


def _say_how(diagnosis: Diagnosis) -> str:
    if not _is_measured(diagnosis):
        return f"Only {diagnosis.turns} turns and {diagnosis.pairs} pairs of images could be used: drive longer."
    return (
        f"By {diagnosis.turns} turns in place, {diagnosis.pairs} pairs of images of about one place, and the readings; "
        "the noise of a gap is found from the times of readings, so changes of the robot's speed add to it."
    )


def _tell(estimate: Estimate, quantity: Quantity) -> tuple[str, str]:
    if not estimate.known:
        return "-", "unknown"
    low, high = (_write(value, quantity, "") for value in (estimate.low, estimate.high))
    return _write(estimate.value, quantity), f"{low} to {high}"


def _write(value: float, quantity: Quantity, unit: str | None = None) -> str:
    unit = quantity.unit if unit is None else unit
    return f"{value / quantity.size:.{quantity.decimals}f} {unit}".strip()
