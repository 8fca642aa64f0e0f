"""Runs of equal numbers: where the readings of each segment start and end."""

import numpy as np


def find_starts(segment: np.ndarray) -> np.ndarray:
    """Index of the first reading of each reading's segment (R,), for segments (R,) in the order driven."""
    first = np.flatnonzero(np.r_[True, segment[1:] != segment[:-1]])
    return np.repeat(first, np.diff(np.r_[first, len(segment)]))


def find_lasts(start: np.ndarray) -> np.ndarray:
    """Index of the last reading of each segment (S,), from the result of ``find_starts`` (R,)."""
    return np.flatnonzero(np.r_[start[1:] != start[:-1], True])
