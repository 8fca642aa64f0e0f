"""How much of the floor a drive has seen, without a map of the room: the estimate of Good and Turing.

The probability that a new draw is of a kind not seen before is about the number of kinds seen once, over the number of
draws (I. J. Good, Biometrika 40, 1953). A draw is a cell of the floor that a segment passes.
"""

import numpy as np

CELL_M = 0.25
"""Side of a cell [m]."""


def expect_new(places: np.ndarray, segment: np.ndarray) -> float:
    """Share of the cells on the way of one more segment that no earlier one passed, to be expected.

    Args:
        places: Position of each reading (R, 2) [m].
        segment: Its segment (R,).
    """
    visits = _list_visits(places, segment)
    _, counts = np.unique(visits[:, :2], axis=0, return_counts=True)
    return float((counts == 1).sum() / len(visits))


def measure_new(places: np.ndarray, segment: np.ndarray, known: np.ndarray) -> float:
    """The same share, measured on segments that are held out; ``known`` (N, 2) [m] are the positions before."""
    visits = _list_visits(places, segment)[:, :2]
    before = {tuple(cell) for cell in _find_cells(known).tolist()}
    return float(np.mean([tuple(cell) not in before for cell in visits.tolist()]))


def _list_visits(places: np.ndarray, segment: np.ndarray) -> np.ndarray:
    """Cell and segment (V, 3) of each visit; a segment visits a cell once."""
    return np.unique(np.column_stack([_find_cells(places), segment]), axis=0)


def _find_cells(places: np.ndarray) -> np.ndarray:
    return np.floor(places / CELL_M).astype(np.int64)
