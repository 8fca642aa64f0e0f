"""Logging along timelines, and saving: atomically, without wall-clock time, and equal contents for equal runs.

The timelines of a run are ``drive_time`` [s], ``step`` of training, ``making`` (stages of the initial map), ``place``,
which ends with the worst place, and ``deployment`` [s]. All of them also go through the time of the drive, so that its
slider changes every tab. A run in progress has ``run_time`` [s] alone.
"""

import hashlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb

from deepgps.viewer.read import open_rrd
from sim.errors import InputError
from sim.files.atomic import write_bytes
from sim.files.checksums import check_sum, drop_sum, sha256, write_sum
from sim.recording.format import Recording

DRIVE_TIME, STEP, MAP_STAGE, PLACE, DEPLOYMENT = "drive_time", "step", "making", "place", "deployment"
RUN_TIME = "run_time"
Rows = Sequence[rr.TimeColumn]  # Times of some rows, on one or several timelines
Shapes = dict[str, tuple[Mapping[str, Any], Sequence[int], float]]  # By entity: components, colour, radius [m]
Span = tuple[float, float]  # Times of the drive [s] between which something else is spread
Clock = Callable[[np.ndarray], Rows]  # Makes rows at times of a drive (n,) [s]


def put(
    stream: rr.RecordingStream,
    path: str,
    thing: rr.AsComponents,
    at: Rows = (),
    said: Mapping[str, Sequence[str]] | None = None,
) -> None:
    """Log something from the one place ``at`` on, or statically without it.

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
    stream: rr.RecordingStream,
    path: str,
    kind: Any,
    at: Rows,
    rows: Mapping[str, Any],
    style: Mapping[str, Any],
    lengths: Sequence[int] | None = None,
) -> None:
    """Log rows of one archetype along timelines.

    Components that change have the values of all rows, so many each if there are ``lengths``, else one; those of the
    style are the same in all rows and logged statically.
    """
    stream.log(path, kind.from_fields(**style), static=True)
    columns = kind.columns(**rows)
    stream.send_columns(path, at, columns if lengths is None else columns.partition(lengths))


def send_shapes(
    stream: rr.RecordingStream, root: str, at: Rows, shapes: Shapes, lengths: Sequence[int] | None = None
) -> None:
    """Log lines, dots or labels along timelines, as ``send_rows`` does."""
    for name, (rows, colour, radius_m) in shapes.items():
        kind, style = (rr.LineStrips3D, {}) if "strips" in rows else (rr.Points3D, {"point_shading": "Flat"})
        style |= {"radii": radius_m, "colors": [colour], **({"show_labels": True} if "labels" in rows else {})}
        send_rows(stream, f"{root}/{name}", kind, at, rows, style, lengths)


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
    stream.log(path, rr.SeriesLines(colors=[colour], names=label, widths=width), static=True)
    stream.send_columns(path, at, rr.Scalars.columns(scalars=np.asarray(values, float)))


def find_span(recording: Recording) -> Span:
    """First and last time of a drive [s]."""
    return float(recording.time[0]), float(recording.time[-1])


def drive_clock(time: np.ndarray) -> Rows:
    """The clock of a finished drive."""
    return [rr.TimeColumn(DRIVE_TIME, duration=time)]


def run_clock(time: np.ndarray) -> Rows:
    """The clock of a run in progress."""
    return [rr.TimeColumn(RUN_TIME, duration=time)]


def deployment_clock(drive: Recording, span: Span) -> Clock:
    """The clock of the deployment drive."""
    start, end = find_span(drive)
    return lambda time: _spread(rr.TimeColumn(DEPLOYMENT, duration=time), (time - start) / max(end - start, 1e-9), span)


def step_rows(step: np.ndarray, last: int, span: Span) -> Rows:
    """Rows at steps of a training (n,) with so many."""
    return _spread(rr.TimeColumn(STEP, sequence=step), np.asarray(step) / last, span)


def making_rows(stage: int, last: int, span: Span) -> Rows:
    """The row of one stage of a map's making, numbered from 0 to ``last``."""
    return _spread(rr.TimeColumn(MAP_STAGE, sequence=[stage]), np.array([stage / max(last, 1)]), span)


def place_rows(count: int, span: Span) -> Rows:
    """Rows for some places, the worst first; it is at the end of both timelines, where the viewer opens them."""
    place = np.arange(count, 0, -1)  # not from -1 down: at negative times, the viewer shows no pictures
    return _spread(rr.TimeColumn(PLACE, sequence=place), (place - 1) / max(count - 1, 1), span)


def show_until_now(timeline: str = DRIVE_TIME, seconds: float | None = None) -> list[rrb.VisibleTimeRange]:
    """Show what was logged from the start to the slider, or in the last seconds [s]."""
    boundary = rr.TimeRangeBoundary
    start = boundary.infinite() if seconds is None else boundary.cursor_relative(seconds=-seconds)
    return [rrb.VisibleTimeRange(timeline, start=start, end=boundary.cursor_relative(seconds=0))]


def save_recording(
    path: Path, number: str, title: str, blueprint: rrb.Blueprint, log: Callable[[rr.RecordingStream], None]
) -> None:
    """Write a recording with this id, title and layout atomically; equal contents have equal ids."""
    # Chunks end by size and never by the clock, so that even a busy machine cuts equal runs into equal pieces.
    by_size = rr.ChunkBatcherConfig(flush_tick=timedelta(days=1))
    # The viewer keeps one layout for each application, so each recording is an application of its own.
    stream = rr.RecordingStream(f"deepgps-{number}", recording_id=number, send_properties=False, batcher_config=by_size)
    with stream:
        # Write to memory first: on a full disk, Rerun's own file writer hangs or truncates the file without an error.
        memory = stream.binary_stream()
        # Active, not only the default: a busy browser may have made a layout of its own before this one arrives.
        stream.send_blueprint(blueprint, make_active=True, make_default=True)
        stream.send_recording_name(title)
        log(stream)
        stream.flush()
        data = memory.read()
        stream.disconnect()
    drop_sum(path)
    write_bytes(path, data or b"")
    write_sum(path)


def hash_files(folder: Path, paths: Iterable[Path]) -> str:
    """Thirty-two hexadecimal digits of what a recording shows: the files' paths in their folder, and their contents."""
    state = hashlib.sha256()
    for path in paths:
        state.update(f"{path.relative_to(folder).as_posix()} {sha256(path)}\n".encode())
    return state.hexdigest()[:32]


def holds(path: Path, number: str) -> bool:
    """Whether the file is an intact recording with this id."""
    with suppress(InputError):
        check_sum(path)
        return [one.recording_id for one in open_rrd(path).recordings()] == [number]
    return False


def _spread(column: rr.TimeColumn, share: np.ndarray, span: Span) -> Rows:
    return [column, rr.TimeColumn(DRIVE_TIME, duration=span[0] + (span[1] - span[0]) * share)]
