"""Where training images were taken: floor without any near it, and the number of images in each cell of the floor."""

import numpy as np
import rerun as rr
from matplotlib import colormaps

from deepgps.evaluation.coverage import find_seen
from deepgps.viewer.scene import LAYER_M, lift
from sim.occupancy import FreeSpace

COVERAGE, DENSITY = "world/not_covered", "world/images_per_cell"
CELL_M = 0.25
UNSEEN = (232, 37, 79)


def log_coverage(stream: rr.RecordingStream, place: np.ndarray, space: FreeSpace) -> None:
    """Log the reachable floor too far from every training image, and the number of images in each cell.

    Args:
        stream: The recording.
        place: True positions of the training images (n, 2) [m].
        space: Where the robot fits.
    """
    row, column = np.nonzero(space.reachable)
    floor = space.origin + np.stack([column, row], axis=1) * space.cell_m
    unseen = floor[~find_seen(floor, place)]
    stream.log(COVERAGE, make_tiles(unseen, space.cell_m, 2 * LAYER_M, np.array([UNSEEN], np.uint8)), static=True)
    cell, count = np.unique(np.floor(place / CELL_M).astype(int), axis=0, return_counts=True)
    colours = colormaps["viridis"](np.log(count) / max(np.log(count.max()), 1e-9))[:, :3]
    tiles = make_tiles((cell + 0.5) * CELL_M, 0.94 * CELL_M, 1.5 * LAYER_M, (255 * colours).astype(np.uint8))
    stream.log(DENSITY, tiles, rr.AnyValues(images=count), static=True)


def make_tiles(middle: np.ndarray, size_m: float, height_m: float, colours: np.ndarray) -> rr.Boxes3D:
    """Flat squares around points (n, 2) [m], high enough above the floor plan for the viewer to draw them over it."""
    return rr.Boxes3D(
        centers=lift(middle, height_m),
        half_sizes=[(size_m / 2, size_m / 2, 0.0005)],
        colors=colours,
        fill_mode="solid",
    )
