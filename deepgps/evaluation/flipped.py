"""Flipped parts of a map: neighbourhoods that the map turns over, as a fold does; measured against the truth."""

import numpy as np
from scipy import ndimage

PATCH_SPACING_M = 0.1
"""Side of the cells on which patches are measured [m]."""


def measure_flipped(truth: np.ndarray, predicted: np.ndarray, spacing_m: float) -> float:
    """Share of a map that is flipped, as by a fold: 0 for a correct map, at most a half.

    Args:
        truth: Test positions (C, 2) [m] on a grid.
        predicted: One prediction for each (C, 2) [m]; the share is invariant to rigid motions and reflections of all.
        spacing_m: Spacing of the grid [m].

    Returns:
        The share of neighbourhoods (a position, its right and its upper neighbour) with the rarer orientation.
    """
    area = _measure_areas(np.rint((truth - truth.min(axis=0)) / spacing_m).astype(int), predicted)
    area = area[np.isfinite(area)]
    return float(min((area > 0).mean(), (area < 0).mean())) if len(area) else 0.0


def measure_flipped_patch(truth: np.ndarray, positions: np.ndarray) -> float:
    """Area [m^2] of the largest connected patch of flipped neighbourhoods in a map of scattered positions.

    The map's displacement is averaged in cells of ``PATCH_SPACING_M``; cells without a position have no neighbourhood.

    Args:
        truth: True positions (n, 2) [m].
        positions: The map's positions (n, 2) [m], aligned with the truth.
    """
    cell, number = np.unique(np.floor(truth / PATCH_SPACING_M).astype(int), axis=0, return_inverse=True)
    number = number.ravel()
    away = np.stack([np.bincount(number, axis) for axis in (positions - truth).T], axis=1)
    centre = PATCH_SPACING_M * cell + away / np.bincount(number)[:, None]
    flipped = _measure_areas(cell - cell.min(axis=0), centre) < 0.0
    patch = np.zeros(flipped.shape, np.int32)
    ndimage.label(flipped, output=patch)
    return float(np.bincount(patch[flipped]).max(initial=0) * PATCH_SPACING_M**2)


def _measure_areas(cell: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Signed areas (columns, rows) of the neighbourhoods of cells (C, 2) that lie at (C, 2) [m]; NaN: incomplete."""
    table = np.full((*(cell.max(axis=0) + 2), 2), np.nan)  # a margin, so that the last cells have missing neighbours
    table[tuple(cell.T)] = place
    right, up = (table[1:, :-1] - table[:-1, :-1], table[:-1, 1:] - table[:-1, :-1])
    return right[..., 0] * up[..., 1] - right[..., 1] * up[..., 0]
