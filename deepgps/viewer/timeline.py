"""The timelines of a run's recording, and rows along them.

The timelines are ``drive_time`` [s], ``step`` of training, and ``progress``, which runs from 0 to ``PROGRESS_END``
through the drive and the training at the same time.
"""

from collections.abc import Iterable, Sequence

import numpy as np
import rerun as rr

from sim.recording.format import Recording

DRIVE_TIME, STEP, PROGRESS = "drive_time", "step", "progress"
PROGRESS_END = 10_000


def send_series(
    stream: rr.RecordingStream,
    path: str,
    indexes: Iterable[rr.TimeColumn],
    values: np.ndarray,
    label: str,
    colour: Sequence[int],
) -> None:
    stream.log(path, rr.SeriesLines(colors=[colour], names=label, widths=1.5), static=True)
    stream.send_columns(path, indexes, rr.Scalars.columns(scalars=np.asarray(values, float)))


def drive_index(time: np.ndarray, recording: Recording) -> list[rr.TimeColumn]:
    start, end = recording.time[0], recording.time[-1]
    share = (time - start) / max(end - start, 1e-9)
    return [rr.TimeColumn(DRIVE_TIME, duration=time), rr.TimeColumn(PROGRESS, sequence=_progress(share))]


def step_index(step: np.ndarray, last: int) -> list[rr.TimeColumn]:
    return [rr.TimeColumn(STEP, sequence=step), rr.TimeColumn(PROGRESS, sequence=_progress(step / last))]


def _progress(share: np.ndarray) -> np.ndarray:
    return np.rint(share * PROGRESS_END).astype(np.int64)
