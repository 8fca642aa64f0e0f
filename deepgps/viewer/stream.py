"""Logging along timelines, saving and opening: without wall-clock time, and equal contents for equal runs.

The timelines of a run are ``drive_time`` [s], ``step`` of training, ``making`` (stages of the initial map), ``place``,
which begins with the worst place, and ``deployment`` [s]. Whatever the time of the drive, the worst place and the final
maps are shown; plots go through it. A run in progress has ``run_time`` [s] alone.
"""

import hashlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from datetime import timedelta
from pathlib import Path
from typing import Any
from warnings import catch_warnings, simplefilter

import numpy as np
import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb
from rerun.chunk import RrdReader

from sim.errors import InputError
from sim.files.atomic import write_bytes
from sim.files.checksums import drop_sum, sha256, write_sum
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
    """Rows at steps of a training (n,) with so many, for a plot."""
    return _spread(rr.TimeColumn(STEP, sequence=step), np.asarray(step) / last, span)


def start_row(span: Span) -> Rows:
    """The row at the start of the drive, of what is shown as long as its time passes."""
    return [rr.TimeColumn(DRIVE_TIME, duration=[span[0]])]


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


def open_rrd(path: Path) -> RrdReader:
    """Open a recording; raise InputError if the file is missing, truncated or not a recording."""
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    try:
        with catch_warnings():
            simplefilter("ignore")  # the InputError below says the same
            reader = RrdReader(path)
            reader.store().schema()  # needs the footer, which a truncated file lacks
    except Exception as error:  # rerun raises ValueError, RuntimeError and its own types
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"{path} is truncated or no recording ({reason}); delete it and view the run again") from None
    return reader


def _spread(column: rr.TimeColumn, share: np.ndarray, span: Span) -> Rows:
    return [column, rr.TimeColumn(DRIVE_TIME, duration=span[0] + (span[1] - span[0]) * share)]
