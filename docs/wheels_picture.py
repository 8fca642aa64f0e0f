"""Draw the picture of the page "What a real robot's wheels do" from a clone of github.com/sousarbarb/optiodom:
``.venv/bin/python -m docs.wheels_picture optiodom/data/diff``.
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from deepgps.evaluation.wheels import (
    LENGTHS_M,
    SPACING_M,
    Model,
    Wheels,
    list_errors,
    measure_spread,
    measure_wheels,
    read_run,
)
from deepgps.reports.plots import count_by_decades, to_png
from deepgps.reports.wheels_page import ENCODER_COLOUR, TRUE_COLOUR
from docs.pictures import PICTURES, reduce
from sim.files.atomic import write_bytes
from sim.rng import stream
from sim.sensors.encoder import disturb

ASSUMED, TICKS_PER_REV = (0.042, 0.042, 0.2), 43.7 * 64
DAY_LETTERS = 8  # Letters of a file's name that are its day
LONG_GAPS = 8  # Gaps of the simulator in the length over which headings are compared


def simulate(model: Model, gaps: int) -> tuple[np.ndarray, np.ndarray]:
    """Errors of lengths [mm] and headings [degrees] over some gaps of the simulator, and the tracker's noise."""
    settings, radius_m = model.make_settings(model, TICKS_PER_REV), model.left_m
    rng, way = stream(0, "wheels_picture"), np.arange(20_000 * gaps + 1)[:, None] * np.full(2, SPACING_M / radius_m)
    angle, _ = disturb(way, settings, radius_m, rng)
    error = np.diff((angle - way)[::gaps], axis=0) * radius_m
    noise = rng.standard_normal(error.shape)
    along = error.mean(axis=1) + model.tracker_m * noise[:, 0]
    return 1000 * along, np.degrees((error[:, 1] - error[:, 0]) / model.track_m + model.tracker_rad * noise[:, 1])


def draw_wheels(wheels: Wheels) -> Figure:
    """Errors of gaps, measured and simulated, their growth with length, and errors of headings."""
    figure = Figure(figsize=(12, 3.6), layout="constrained")
    short, growth, long = figure.subplots(1, 3)
    along = 1000 * list_errors(wheels.gaps[SPACING_M])["along"][0]
    drift = np.degrees(list_errors(wheels.gaps[SPACING_M * LONG_GAPS])["straight"][0])
    _compare(short, along, simulate(wheels.model, 1)[0], f"error of a gap of {100 * SPACING_M:g} cm [mm]")
    label = f"error of the heading over {100 * SPACING_M * LONG_GAPS:g} cm [degrees]"
    _compare(long, drift, simulate(wheels.model, LONG_GAPS)[1], label)
    lengths, band = 100 * np.array(LENGTHS_M), wheels.intervals["length_per_m"]
    measured = [1000 * measure_spread(list_errors(gaps)["along"][0]) for gaps in wheels.gaps.values()]
    modelled = [1000 * wheels.model.expect_spread(length) for length in LENGTHS_M]
    growth.plot(lengths, measured, "o", color=ENCODER_COLOUR, label="measured")
    growth.plot(lengths, modelled, color=TRUE_COLOUR, label="model: wheels and tracker")
    wheels_alone = (1000 * end * np.sqrt(LENGTHS_M) for end in (band.low, band.high))
    growth.fill_between(lengths, *wheels_alone, color=TRUE_COLOUR, alpha=0.3, lw=0, label="wheels alone")
    growth.axhline(1000 * wheels.model.tracker_m, color="#888888", ls="--", lw=1, label="tracker alone")
    growth.set(xscale="log", yscale="log", xlabel="length of a gap [cm]", ylabel="spread of its error [mm]")
    for axis in (growth.xaxis, growth.yaxis):
        count_by_decades(axis)
    growth.legend(frameon=False, fontsize=8)
    return figure


def _compare(axes: Axes, measured: np.ndarray, simulated: np.ndarray, label: str) -> None:
    bins = np.linspace(-4.0, 4.0, 49 if len(measured) > 1000 else 25) * measure_spread(measured)
    axes.hist(measured, bins=bins, density=True, color=ENCODER_COLOUR, alpha=0.7, label="measured")
    axes.hist(simulated, bins=bins, density=True, histtype="step", color=TRUE_COLOUR, lw=1.6, label="simulated")
    axes.set(xlabel=label, yticks=[])
    axes.legend(frameon=False, fontsize=8)


if __name__ == "__main__":
    files = sorted(Path(sys.argv[1]).rglob("*_run-??.csv"))
    runs = [read_run(file, TICKS_PER_REV, ASSUMED) for file in files]
    measured = measure_wheels(runs, [file.name[:DAY_LETTERS] for file in files], ASSUMED)
    write_bytes(PICTURES / "real_wheels.png", reduce(to_png(draw_wheels(measured))))
