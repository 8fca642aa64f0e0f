"""Coverage: how much of the floor has a training image near enough to know it, and which part was missed."""

from typing import Any

import numpy as np
from scipy.spatial import KDTree

SEEN_WITHIN_M = 0.25
OFF_CENTRE = 0.25
"""Distance from the middle of the room, as a fraction of half its extent, from which a part has a direction."""


def measure_coverage(cells: np.ndarray, samples: np.ndarray) -> dict[str, Any]:
    """Count test positions (C, 2) [m], and those with a training sample (N, 2) [m] near enough to have been seen; name
    the part of the room in which most of the others are."""
    seen = find_seen(cells, samples)
    part = name_part(cells, ~seen)
    return {
        "reachable_cells": len(cells),
        "cells_seen": int(seen.sum()),
        **({"missed": part} if part else {}),
    }


def find_seen(places: np.ndarray, samples: np.ndarray) -> np.ndarray:
    """Whether places (C, 2) [m] have a training sample (N, 2) [m] within ``SEEN_WITHIN_M``: (C,)."""
    return KDTree(samples).query(places)[0] <= SEEN_WITHIN_M


def name_part(cells: np.ndarray, chosen: np.ndarray) -> str | None:
    """The part of the room, with north along +y, in which the chosen (C,) of the positions (C, 2) [m] lie on average.

    None if there are none, or if they lie all around the middle.
    """
    if not chosen.any():
        return None
    low, high = cells.min(axis=0), cells.max(axis=0)
    x, y = (cells[chosen].mean(axis=0) - (low + high) / 2) / np.maximum((high - low) / 2, 1e-9)
    north = "north" if y > OFF_CENTRE else "south" if y < -OFF_CENTRE else ""
    east = "east" if x > OFF_CENTRE else "west" if x < -OFF_CENTRE else ""
    return "-".join(filter(None, (north, east))) or None
