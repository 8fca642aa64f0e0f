"""The table with which images are compared: features of one training image for each small square of the map."""

import numpy as np
from scipy.spatial import KDTree

from deepgps.positioner.confidence import CHUNK, LEVELS, NEAREST, Confidence
from deepgps.positioner.heading_fit import thin_out
from deepgps.positioner.headings import find_nearest

CELL_M = 0.05
"""The table has one image for each square of the map with sides of this length [m]."""
COMPONENTS = 64
"""Features that are compared, the slowest; more tell no more."""


def make_table(features: np.ndarray, positions: np.ndarray, std: np.ndarray, rows: np.ndarray) -> Confidence:
    """The table of the observations ``rows`` (n,) of N; it accepts everything, and its radii are unknown.

    Args:
        features: Features of the images (N, K).
        positions: Positions that the method predicts for them (N, 2) [m].
        std: Standard deviation of the map at each of them, along one axis (N,) [m].
        rows: Which of them may come into the table (n,).
    """
    entry = rows[thin_out(positions[rows], CELL_M)]
    known, place = features[entry, :COMPONENTS], positions[entry]
    scale = np.maximum(np.abs(known).max(axis=0), 1e-12).astype(np.float32) / np.float32(127.0)
    middle = np.linalg.norm(place - place.mean(axis=0), axis=1).max()
    return Confidence(
        features=np.rint(known / scale).astype(np.int8),
        scale=scale,
        place=place.astype(np.float32),
        metres=_convert(known, place),
        map_std=std[entry].astype(np.float32),
        threshold_m=np.inf,
        usual_m=np.inf,
        refused=0.0,
        slope=np.full((len(LEVELS), 2), np.nan),
        reach_m=float(2.0 * middle),
    )


def _convert(known: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Median distance on the map over the distance in features (E,) [m], between each entry and those around it."""
    apart, around = find_nearest(KDTree(place), place, NEAREST)
    found = np.zeros(len(place), np.float32)
    for start in range(0, len(place), CHUNK):
        part = slice(start, start + CHUNK)
        unlike = np.linalg.norm(known[around[part]] - known[part, None], axis=2)
        other = (apart[part] > 0.0) & (unlike > 0.0)  # an entry is near itself
        ratio = np.divide(apart[part], unlike, out=np.full(unlike.shape, np.nan), where=other)
        seen = other.any(axis=1)
        found[part][seen] = np.nanmedian(ratio[seen], axis=1)
    return found
