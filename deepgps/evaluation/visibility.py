"""Visibility: how much of a room's floor straight drives from a place reach."""

import numpy as np
from scipy import ndimage

from sim.occupancy import FreeSpace

RAYS = 180


def measure_visible(space: FreeSpace, points: np.ndarray) -> np.ndarray:
    """Share of the reachable floor that straight drives from each point reach.

    Rays are followed from the point to the first cell where the robot does not fit; a ray of length r represents a
    sector of area ``pi r^2 / rays`` (the isovist of Benedikt 1979, with the robot's centre in place of an eye).

    Args:
        space: Where the robot fits.
        points: Places (C, 2) [m].

    Returns:
        Shares (C,) from 0 to 1; 0 for a place where the robot does not fit.
    """
    angle = 2 * np.pi * (np.arange(RAYS) + 0.5) / RAYS
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    # Distance of each cell from where the robot does not fit: a ray may skip it in one step. The padding is occupied.
    clear = np.asarray(ndimage.distance_transform_edt(np.pad(space.free, 1))) * space.cell_m
    start, direction = np.repeat(points, RAYS, axis=0), np.tile(direction, (len(points), 1))
    length, going = np.zeros(len(start)), np.arange(len(start))
    while len(going):
        place = start[going] + length[going, None] * direction[going]
        column, row = (np.rint((place - space.origin) / space.cell_m).astype(int) + 1).T
        gap = clear[row.clip(0, clear.shape[0] - 1), column.clip(0, clear.shape[1] - 1)]
        going, gap = going[gap > 0.0], gap[gap > 0.0]
        length[going] += np.maximum(gap - space.cell_m, space.cell_m / 2)
    length = length.reshape(len(points), RAYS)
    return np.minimum(np.pi * np.square(length).mean(axis=1) / (space.reachable.sum() * space.cell_m**2), 1.0)
