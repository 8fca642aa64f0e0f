"""Faults of a study that need no drive of their own: images of a drive in use are spoilt, or a part is not learned."""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from deepgps.data.segments import find_runs
from sim.recording.format import Recording
from sim.recording.turns import KINDS, NO_IMAGE, Turns, from_array

Spoil = Callable[[np.ndarray], np.ndarray]
THROUGH = 0.04
"""Share of the light that a covered lens lets through from where it comes; the rest is scattered evenly."""


def cover(images: np.ndarray) -> np.ndarray:
    """Images (N, rings, sectors, 3) through a cover: half as bright, and nearly uniform."""
    mean = images.mean(axis=(1, 2), keepdims=True)
    return np.rint((THROUGH * images + (1.0 - THROUGH) * mean) / 2.0).astype(np.uint8)


SPOILT: Mapping[str, Spoil] = {
    "black": np.zeros_like,
    "white": lambda images: np.full_like(images, 255),
    "covered": cover,
    "frozen": lambda images: np.repeat(images[:1], len(images), axis=0),
}
"""What happens to images (N, rings, sectors, 3), by the cause that should be named."""


def spoil_drive(drive: Recording, spoil: Spoil) -> Recording:
    """A drive whose images are spoilt, also those after turns."""
    turned = drive.turn_observation
    turned = None if turned is None or not len(turned) else spoil(np.asarray(turned))
    return replace(drive, observation=spoil(np.asarray(drive.observation)), turn_observation=turned)


def keep_segments(recording: Recording, seen: np.ndarray) -> Recording:
    """A recording without the segments on which any image is not among those seen (N,) bool.

    The robot is taken to be carried over what is left out.
    """
    runs = find_runs(recording)
    kept = [number for number, run in enumerate(runs) if seen[recording.reading[run, 1]].all()]
    rows = np.concatenate([np.empty(0, int), *(runs[number] for number in kept)])
    observed, new = np.unique(recording.reading[rows, 1], return_inverse=True)
    reading = recording.reading[rows].copy()
    reading[:, 0] = np.repeat(np.arange(len(kept)), [len(runs[number]) for number in kept])
    reading[:, 1] = new
    time = recording.observation_time
    return replace(
        recording,
        reading=reading,
        time=recording.time[rows],
        observation=recording.observation[observed],
        observation_time=None if time is None else time[observed],
        turns=None if recording.turns is None else _keep_turns(recording.turns, rows, reading, observed),
        readings=None,
    )


def _keep_turns(turns: Turns, rows: np.ndarray, reading: np.ndarray, observed: np.ndarray) -> Turns:
    """The turns between segments that followed each other, and one relocation for each gap.

    Args:
        turns: Those of the complete recording.
        rows: Its readings that are kept (R,).
        reading: These, numbered again (R, 4).
        observed: Its observations that are kept.
    """
    first = np.flatnonzero(np.diff(reading[:, 0])) + 1
    jump = {row: (reading[row - 1, 1], NO_IMAGE, row, KINDS.index("relocated")) for row in first.tolist()}
    follows = np.isin(turns.after, rows) & np.isin(turns.after - 1, rows)
    for before, image, after, kind in turns.array[follows].tolist():
        row = int(np.searchsorted(rows, after))
        jump[row] = (int(np.searchsorted(observed, before)), image, row, kind)
    return from_array(np.array(list(jump.values()), np.int64).reshape(-1, 4))
