"""Saving a recording: whole or not at all, and equal contents for equal runs."""

from collections.abc import Callable
from contextlib import suppress
from datetime import timedelta
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb

from deepgps.viewer.read import open_rrd
from sim.errors import InputError
from sim.files import check_sum, drop_sum, write_bytes, write_sum


def save_recording(
    path: Path, number: str, title: str, blueprint: rrb.Blueprint, log: Callable[[rr.RecordingStream], None]
) -> None:
    """Write a recording atomically.

    Args:
        path: The ``.rrd`` file.
        number: The recording's id; the same for the same contents.
        title: Its name in the viewer.
        blueprint: How the viewer shows it.
        log: Logs what it holds.
    """

    # Chunks end by size and never by the clock, so that a busy machine cuts equal runs in equal pieces.
    by_size = rr.ChunkBatcherConfig(flush_tick=timedelta(days=1))
    # The viewer keeps one layout for an application: each recording's is its own.
    stream = rr.RecordingStream(f"deepgps-{number}", recording_id=number, send_properties=False, batcher_config=by_size)
    with stream:
        # In memory first: on a full disk Rerun's own file waits without end, or is cut off without an error.
        memory = stream.binary_stream()
        stream.send_blueprint(blueprint, make_active=False, make_default=True)
        stream.send_recording_name(title)
        log(stream)
        stream.flush()
        data = memory.read()
        stream.disconnect()
    drop_sum(path)
    write_bytes(path, data or b"")
    write_sum(path)


def holds(path: Path, number: str) -> bool:
    """Whether a whole recording of this id stands there."""
    with suppress(InputError):
        check_sum(path)
        return [one.recording_id for one in open_rrd(path).recordings()] == [number]
    return False
