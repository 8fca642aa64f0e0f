"""The timelines of recordings, logging along them, and the ranges of them that views show.

The timelines of a run are ``drive_time`` [s], ``step`` of training, ``making`` (stages of the initial map), ``place``,
which ends with the worst place, and ``progress``, which runs from 0 to ``PROGRESS_END_S`` through the drive, the map's
making, the training and the worst places at the same time, so that its slider changes every tab. A run in progress has
``run_time`` [s] alone.
"""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb

from sim.recording.format import Recording

DRIVE_TIME, STEP, MAKING, PLACE, PROGRESS = "drive_time", "step", "making", "place", "progress"
RUN_TIME = "run_time"
PROGRESS_END_S = 100.0
"""Seconds in which the viewer plays everything; a second is one per cent."""
Rows = Sequence[rr.TimeColumn]
"""Times of some rows, on one or several timelines."""
Clock = Callable[[np.ndarray], Rows]
"""Makes rows at times of a drive (n,) [s]."""


def put(
    stream: rr.RecordingStream,
    path: str,
    thing: rr.AsComponents,
    at: Rows = (),
    said: Mapping[str, Sequence[str]] | None = None,
) -> None:
    """Log something from the one place ``at`` on, or statically without it; wall-clock time is never written.

    Texts that are ``said`` of its parts in the tooltip are logged by their components' names.
    """
    if said:
        put(stream, path, rr.AnyValues(**{name: pa.array(texts, pa.utf8()) for name, texts in said.items()}), at)
    if not at:
        stream.log(path, thing, static=True)
        return
    batches = thing.as_component_batches()
    columns = [
        rr.ComponentColumn(one.component_descriptor(), one, lengths=[len(one.as_arrow_array())]) for one in batches
    ]
    stream.send_columns(path, at, columns)


def put_text(stream: rr.RecordingStream, path: str, text: str, at: Rows = ()) -> None:
    """Log Markdown, as ``put`` does."""
    put(stream, path, rr.TextDocument(text, media_type="text/markdown"), at)


def send_rows(
    stream: rr.RecordingStream, path: str, style: rr.AsComponents, rows: rr.ComponentColumnList, at: Rows
) -> None:
    """Log rows along timelines, and statically what they have in common."""
    stream.log(path, style, static=True)
    stream.send_columns(path, at, rows)


def send_series(
    stream: rr.RecordingStream,
    path: str,
    at: Rows,
    values: np.ndarray,
    label: str,
    colour: Sequence[int],
    width: float = 1.5,
) -> None:
    """Log the values (n,) of a plot's line."""
    style = rr.SeriesLines(colors=[colour], names=label, widths=width)
    send_rows(stream, path, style, rr.Scalars.columns(scalars=np.asarray(values, float)), at)


def drive_clock(recording: Recording) -> Clock:
    """The clock of a finished drive."""
    start, end = recording.time[0], recording.time[-1]

    def make_rows(time: np.ndarray) -> Rows:
        share = (time - start) / max(end - start, 1e-9)
        return [rr.TimeColumn(DRIVE_TIME, duration=time), rr.TimeColumn(PROGRESS, duration=PROGRESS_END_S * share)]

    return make_rows


def run_clock(time: np.ndarray) -> Rows:
    """The clock of a run in progress."""
    return [rr.TimeColumn(RUN_TIME, duration=time)]


def step_rows(step: np.ndarray, last: int) -> Rows:
    """Rows at steps of a training (n,) with so many."""
    return [
        rr.TimeColumn(STEP, sequence=step),
        rr.TimeColumn(PROGRESS, duration=PROGRESS_END_S * np.asarray(step) / last),
    ]


def making_rows(stage: int, last: int) -> Rows:
    """The row of one stage of a map's making, numbered from 0 to ``last``."""
    seconds = PROGRESS_END_S * (stage / max(last, 1))
    return [rr.TimeColumn(MAKING, sequence=[stage]), rr.TimeColumn(PROGRESS, duration=[seconds])]


def place_rows(count: int) -> Rows:
    """Rows for the worst places, the worst first; it is at the end of both timelines, where the viewer opens them."""
    place = np.arange(count, 0, -1)  # not from -1 down: at negative times, the viewer shows no pictures
    seconds = PROGRESS_END_S * (place - 1) / max(count - 1, 1)
    return [rr.TimeColumn(PLACE, sequence=place), rr.TimeColumn(PROGRESS, duration=seconds)]


def until_now(timelines: Sequence[str] = (DRIVE_TIME, PROGRESS)) -> list[rrb.VisibleTimeRange]:
    """Show what was logged from the start to the slider."""
    return [_until_now(name, rr.TimeRangeBoundary.infinite()) for name in timelines]


def lately(seconds: float, drive_s: float) -> list[rrb.VisibleTimeRange]:
    """Show the last seconds [s] of the drive, also on the timeline ``progress``, on which the drive is rescaled."""
    relative, share = rr.TimeRangeBoundary.cursor_relative, seconds / max(drive_s, seconds)
    return [
        _until_now(DRIVE_TIME, relative(seconds=-seconds)),
        _until_now(PROGRESS, relative(seconds=-PROGRESS_END_S * share)),
    ]


def _until_now(timeline: str, start: rr.TimeRangeBoundary) -> rrb.VisibleTimeRange:
    return rrb.VisibleTimeRange(timeline, start=start, end=rr.TimeRangeBoundary.cursor_relative(seconds=0))
