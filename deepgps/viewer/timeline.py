"""The timelines of a run's recording, and rows along them.

The timelines are ``drive_time`` [s], ``step`` of training, ``making`` (stages of the initial map), ``place``, which
ends with the worst place, and ``progress``, which runs from 0 to ``PROGRESS_END_S`` through the drive, the map's
making, the training and the worst places at the same time, so that its slider changes every tab.
"""

from collections.abc import Iterable, Sequence

import numpy as np
import rerun as rr

from sim.recording.format import Recording

DRIVE_TIME, STEP, MAKING, PLACE, PROGRESS = "drive_time", "step", "making", "place", "progress"
PROGRESS_END_S = 100.0
"""Seconds in which the viewer plays everything; a second is one per cent."""


def send_series(
    stream: rr.RecordingStream,
    path: str,
    indexes: Iterable[rr.TimeColumn],
    values: np.ndarray,
    label: str,
    colour: Sequence[int],
    width: float = 1.5,
) -> None:
    stream.log(path, rr.SeriesLines(colors=[colour], names=label, widths=width), static=True)
    stream.send_columns(path, indexes, rr.Scalars.columns(scalars=np.asarray(values, float)))


def drive_index(time: np.ndarray, recording: Recording) -> list[rr.TimeColumn]:
    start, end = recording.time[0], recording.time[-1]
    share = (time - start) / max(end - start, 1e-9)
    return [rr.TimeColumn(DRIVE_TIME, duration=time), rr.TimeColumn(PROGRESS, duration=PROGRESS_END_S * share)]


def step_index(step: np.ndarray, last: int) -> list[rr.TimeColumn]:
    return [
        rr.TimeColumn(STEP, sequence=step),
        rr.TimeColumn(PROGRESS, duration=PROGRESS_END_S * np.asarray(step) / last),
    ]


def making_index(stage: int, last: int) -> list[rr.TimeColumn]:
    """The row of one stage of a map's making, numbered from 0 to ``last``."""
    share = stage / max(last, 1)
    return [
        rr.TimeColumn(MAKING, sequence=[stage]),
        rr.TimeColumn(PROGRESS, duration=[PROGRESS_END_S * share]),
    ]


def place_index(count: int) -> list[rr.TimeColumn]:
    """Rows for the worst places, the worst first; it is at the end of both timelines, where the viewer opens them."""
    place = np.arange(count, 0, -1)  # not from -1 down: at negative times, the viewer shows no pictures
    return [
        rr.TimeColumn(PLACE, sequence=place),
        rr.TimeColumn(PROGRESS, duration=PROGRESS_END_S * (place - 1) / max(count - 1, 1)),
    ]
