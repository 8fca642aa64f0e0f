"""Turns between segments: the second image that the robot takes after each turn in place, and what it knows of a turn.

Where one segment ends and the next begins, both share one observation, taken before the turn. The image after the turn
shows the same place under another heading, so the two tell the angle turned. It is no observation: it has no reading,
and no method learns positions from it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim.errors import InputError

KINDS = ("in_place", "backed_off", "relocated")
"""How the robot came from one segment to the next. in_place: it turned where the segment ended. backed_off: after a
contact or when it was wedged, it rolled back, so the next segment begins nearby. relocated: a person carried it, or it
drove an arc, of which a recording says nothing."""
NO_IMAGE = -1
FILE = "turns.npy"


@dataclass(frozen=True)
class Turns:
    """What the robot knows of the turns of a drive, in the order driven."""

    before: np.ndarray  # Last observation before each turn (T,)
    image: np.ndarray  # Turn image taken after it (T,), or -1: the observation of the first reading after it shows that
    after: np.ndarray  # Row of ``reading`` of the first reading after it (T,), in the segment that begins there
    kind: np.ndarray  # Number of its kind in ``KINDS`` (T,)

    @property
    def array(self) -> np.ndarray:
        """The turns as stored (T, 4) int64."""
        return np.column_stack([self.before, self.image, self.after, self.kind]).astype(np.int64)


def check_turns(array: np.ndarray, observations: int, images: int, segment: np.ndarray) -> None:
    """Raise InputError if turns (T, 4) do not fit a recording with so many observations and turn images.

    ``segment`` is that of each reading (R,).
    """
    if array.ndim != 2 or array.shape[1] != 4 or not np.issubdtype(array.dtype, np.integer):
        raise InputError(f"turns {array.shape} of {array.dtype}: must be integers (T, 4)")
    limits = {
        "observation": (0, observations),
        "turn observation": (NO_IMAGE, images),
        "row of readings": (1, len(segment)),
        "kind": (0, len(KINDS)),
    }
    for values, (name, (low, high)) in zip(array.T, limits.items(), strict=True):
        if wrong := values[(values < low) | (values >= high)].tolist():
            raise InputError(f"turns: {name} {wrong[0]} must be from {low} to {high - 1}")
    after = array[:, 2]
    if len(wrong := after[segment[after] == segment[after - 1]]):
        raise InputError(f"turns: no segment begins at row {wrong[0]} of readings")


def from_array(array: np.ndarray) -> Turns:
    """Turns of a stored array (T, 4)."""
    return Turns(*array.T)


def list_turns(segment: np.ndarray, observation: np.ndarray, kinds: Sequence[int] | np.ndarray) -> Turns:
    """Turns of a complete drive, each before a segment, from the segment and the observation of each reading (R,).

    Kinds (S,) or more are those of the turn before each segment; that of the first one is not used.
    """
    after = np.flatnonzero(np.diff(segment)) + 1
    kind = np.asarray(kinds, np.int64)[segment[after]]
    taken = kind == KINDS.index("in_place")
    image = np.where(taken, np.cumsum(taken) - 1, NO_IMAGE)
    return Turns(observation[after - 1], image, after, kind)


def lose_turns(turns: Turns, segment: np.ndarray, arrived: np.ndarray) -> Turns:
    """Turns, but for the first, before a segment of which a reading (R,) arrives; ``after`` counts those that do."""
    row = np.append(np.flatnonzero(arrived), len(arrived))
    first = np.searchsorted(row, turns.after)
    kept = (first > 0) & (np.append(segment, -1)[row[first]] == segment[turns.after])
    return from_array(replace(turns, after=first).array[kept])


def cut_turns(turns: Turns, readings: int) -> Turns:
    """Turns of a drive that ends after so many readings."""
    return from_array(turns.array[turns.after < readings])


def count_images(turns: Turns) -> int:
    """Number of turn images up to the last turn."""
    return int(turns.image.max(initial=NO_IMAGE)) + 1
