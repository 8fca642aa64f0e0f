"""The report of networks: which ones give a position the same answer whichever way the robot faces."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from deepgps.config.methods import folder_of
from deepgps.evaluation.evaluate import measure_heading_spread
from deepgps.positioner.positioner import Positioner
from deepgps.positioner.stored_positioner import load_positioner
from deepgps.reports.targets import Figure, mean_of
from deepgps.studies import grouping
from deepgps.studies.reports import compare
from deepgps.studies.table import Row, mean
from sim.recording.format import open_recording

NETWORK, SHIFT = "learn.network.architecture", "learn.train.shift"
IMAGES = 30
NOTE = (
    "Turned: RMS distance from their mean of the predictions for one test image turned by every whole number of "
    "sectors; unlike the spread over headings, it excludes the effects of rendering."
)


def report(rows: Sequence[Row], varied: Sequence[str]) -> list[str]:
    """A table with a line for each network, with and without shifted images in training; and a note on it."""
    return [*compare.report(rows, varied, {"turn_spread_m": "turned [cm]"}), NOTE]


def measure(rows: Sequence[Row]) -> dict[str, Figure]:
    """RMS of each network trained with shifted images, as in the paper; and the effect of the padding."""
    groups = {key[0]: group for key, group in grouping.group_rows(rows, [NETWORK]).items()}
    shifted = {name: [row for row in group if row.get(SHIFT, True)] for name, group in groups.items()}
    figures = {}
    for name, group in shifted.items():
        if group:
            figures[name] = mean_of(f"RMS, {name}", [row["rms_m"] for row in group], "cm")
    for name in ("spectral", "invariant"):
        if group := groups.get(name):
            figures[f"{name}_turned"] = mean_of(f"turned, {name}", [row["turn_spread_m"] for row in group], "mm")
    if shifted.get("resnet_plain") and shifted.get("resnet_paper"):
        for name, column, title in (("plain_ratio", "rms_m", "RMS"), ("plain_turned", "turn_spread_m", "turned")):
            plain, paper = (mean(shifted[one], column) for one in ("resnet_plain", "resnet_paper"))
            figures[name] = Figure(f"{title}, resnet_plain / resnet_paper", plain / paper, "", at_least=True)
    return figures


def add_turn_spread(run: Path, row: Row) -> Row:
    """A column for how much a trained network's prediction changes when an image is turned."""
    images = open_recording(run / "recording").test_observation
    some = np.linspace(0, len(images) - 1, min(IMAGES, len(images))).round().astype(int)
    return {"turn_spread_m": measure_turn_spread(load_positioner(folder_of(run, row["method"])), images[some, 0])}


def measure_turn_spread(positioner: Positioner, images: np.ndarray) -> float:
    """RMS distance [m] of predictions from their mean over all turns of each image (n, rings, sectors, 3)."""
    turned = np.stack([np.roll(images, turn, axis=2) for turn in range(images.shape[2])], axis=1)
    return measure_heading_spread(positioner(turned.reshape(-1, *images.shape[1:])).reshape(*turned.shape[:2], 2))
