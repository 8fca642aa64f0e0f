"""The images before and after the turns of a drive, which together show how far the robot turned."""

import numpy as np

from sim.recording.format import Recording
from sim.recording.turns import KINDS, NO_IMAGE, Turns


def turns_with_images(recording: Recording) -> Turns | None:
    """The turns of a recording; None unless it has polar images before and after them."""
    return recording.turns if recording.turn_observation is not None and recording.kind == "polar_image" else None


def take_images(recording: Recording, turns: Turns) -> tuple[np.ndarray, np.ndarray]:
    """Images before and after some of a recording's turns, both (T, rings, sectors, channels)."""
    assert recording.turn_observation is not None
    after, taken = recording.observation[find_next(recording, turns)], turns.image != NO_IMAGE
    after[taken] = recording.turn_observation[turns.image[taken]]
    return recording.observation[turns.before], after


def find_next(recording: Recording, turns: Turns) -> np.ndarray:
    """First observation (T,) of the segment after each turn: where the robot backed off, its reading may be lost."""
    first = recording.reading[turns.after, 1]
    return np.where(turns.kind == KINDS.index("backed_off"), np.minimum(turns.before + 1, first), first)


def find_in_place(turns: Turns) -> np.ndarray:
    """Indices of the turns in place with an image after them."""
    return np.flatnonzero((turns.kind == KINDS.index("in_place")) & (turns.image != NO_IMAGE))
