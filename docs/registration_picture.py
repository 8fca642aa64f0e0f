"""Draws ``docs/pictures/registration.png``: how one image of a run finds its place.

``.venv/bin/deepgps run demo --out runs/demo``, then ``.venv/bin/python -m docs.registration_picture runs/demo``.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from deepgps.positioner.kriging import find_nearest, krige
from deepgps.positioner.pixels import grey, turn
from deepgps.positioner.positioner import RegistrationPositioner
from deepgps.positioner.stored_positioner import load_positioner
from sim.alignment import fit_robust_alignment
from sim.recording.format import open_recording, open_truth

CELL, HEADING = 333, 1  # The test image
HIDDEN_SECTORS = slice(20, 32)  # Sectors that a grey figure hides
BLUE, RED, GREEN = "#0b62d6", "#c2255c", "#1a936f"


def draw(run: Path, target: Path) -> None:
    """Draw the picture of a run with the method ``registration``."""
    recording, truth = open_recording(run / "recording"), open_truth(run / "recording")
    positioner = load_positioner(run / "registration")
    assert isinstance(positioner, RegistrationPositioner) and positioner.appearance is not None
    known, of_images = positioner.known, positioner.known.pixels
    assert of_images is not None
    image = recording.test_observation[CELL, HEADING][None].copy()
    image[:, :, HIDDEN_SECTORS] = 127
    found, features = positioner.register(image), positioner.appearance.features.apply(image).numpy()
    pixels = of_images.register(grey(image), found.position, known.tree, known.kernel)
    near = find_nearest(known.tree, pixels.position, 12)[1]
    flat = of_images.images.reshape(len(known.places), -1)
    seen = krige(pixels.position, known.places, near, known.kernel).predict(flat)[:, 0]
    shape = of_images.images.shape[1:]
    turned = turn(grey(image), pixels.yaw - of_images.heading)[0][0]
    alignment = fit_robust_alignment(known.places, truth.pose[positioner.index, :2], "SE2")
    figure, axes = plt.subplot_mosaic([["map", "query"], ["map", "seen"], ["map", "weight"]], figsize=(12, 6.2))
    starts = known.places[known.find_starts(features)[0]]
    draw_map(axes["map"], *(alignment.apply(some) for some in (known.places, starts, found.mode[0])))
    axes["map"].plot(*truth.test_pose[CELL, HEADING, :2], "+", color="black", ms=16, mew=2, label="truth")
    axes["map"].legend(loc="lower center", bbox_to_anchor=(0.5, 1.02), ncols=2, frameon=False)
    parts = {
        "query": (turned, "the image, turned to the common heading; a figure hides a part", "gray", 255.0),
        "seen": (seen.reshape(shape), "what its place predicts, from twelve training images", "gray", 255.0),
        "weight": (pixels.weight[0], "weight of each pixel: where image and prediction agree", "viridis", 1.0),
    }
    for name, (part, title, colours, largest) in parts.items():
        axes[name].imshow(part, cmap=colours, aspect="auto", vmin=0.0, vmax=largest)
        axes[name].set_title(title, fontsize=11)
        axes[name].set_axis_off()
    figure.tight_layout()
    figure.savefig(target, dpi=110)


def draw_map(axes: Axes, places: np.ndarray, starts: np.ndarray, modes: np.ndarray) -> None:
    """Draw training images (N, 2), starts (S, 2) and modes (M, 2) [m]."""
    axes.plot(*places.T, ".", color="#c8ccd4", ms=1.5, zorder=0)
    axes.plot(*starts.T, "o", color=BLUE, ms=7, mfc="none", mew=1.5, label="starts: images most alike")
    axes.plot(*modes[1:].T, "x", color=RED, ms=9, mew=2, label="other modes")
    axes.plot(*modes[0], "o", color=GREEN, ms=9, label="the answer")
    axes.set_aspect("equal")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")


if __name__ == "__main__":
    draw(Path(sys.argv[1]), Path(__file__).parent / "pictures" / "registration.png")
