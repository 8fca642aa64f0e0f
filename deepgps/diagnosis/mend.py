"""Readings of a stuck wheel, replaced by what the other wheel counts."""

from dataclasses import replace

import numpy as np

from deepgps.diagnosis.gaps import read_gaps
from sim.recording.format import Recording
from sim.recording.turns import KINDS


def mend_stuck(recording: Recording) -> Recording:
    """The recording with the gaps in which a wheel is stuck taken from the other wheel.

    On a segment both wheels travel alike, and in a turn in place in opposite directions. Other gaps stay as they are.
    """
    gaps = read_gaps(recording)
    if not gaps.stuck:
        return recording
    sign = gaps.inside.astype(np.int64)
    if recording.turns is not None:
        in_place = recording.turns.after[recording.turns.kind == KINDS.index("in_place")] - 1
        sign[in_place[~gaps.inside[in_place]]] = -1
    ticks = np.diff(recording.reading[:, 2:], axis=0)
    for stretch in gaps.stuck:
        part = slice(stretch.first, stretch.last + 1)
        ticks[part, stretch.wheel] = sign[part] * ticks[part, 1 - stretch.wheel]
    reading = recording.reading.copy()
    reading[1:, 2:] = reading[0, 2:] + np.cumsum(ticks, axis=0)
    return replace(recording, reading=reading)
