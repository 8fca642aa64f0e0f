"""Runs of equal values: where the readings of each segment start and end, and where a mask is true."""

from collections.abc import Sequence

import numpy as np


def find_starts(segment: np.ndarray) -> np.ndarray:
    """Index of the first reading of each reading's segment (R,), for segments (R,) in the order driven."""
    first = np.flatnonzero(np.r_[True, segment[1:] != segment[:-1]])
    return np.repeat(first, np.diff(np.r_[first, len(segment)]))


def find_lasts(start: np.ndarray) -> np.ndarray:
    """Index of the last reading of each segment (S,), from the result of ``find_starts`` (R,)."""
    return np.flatnonzero(np.r_[start[1:] != start[:-1], True])


def find_stretches(mask: np.ndarray) -> np.ndarray:
    """First and last index of each stretch (n, 2) in which a mask (N,) is true."""
    edge = np.diff(np.r_[0, mask.astype(int), 0])
    return np.stack([np.flatnonzero(edge > 0), np.flatnonzero(edge < 0) - 1], axis=1)


def fill_stretches(stretches: Sequence[Sequence[int]], size: int) -> np.ndarray:
    """The mask (size,) that is true in these stretches alone, as ``find_stretches`` gives them."""
    mask = np.zeros(size, bool)
    for first, last in stretches:
        mask[first : last + 1] = True
    return mask
