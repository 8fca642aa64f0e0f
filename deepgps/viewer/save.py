"""Saving a recording: atomically, and with equal contents for equal runs."""

import hashlib
from collections.abc import Callable, Iterable
from contextlib import suppress
from datetime import timedelta
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb

from deepgps.viewer.read import open_rrd
from sim.errors import InputError
from sim.files.atomic import write_bytes
from sim.files.checksums import check_sum, drop_sum, sha256, write_sum


def save_recording(
    path: Path, number: str, title: str, blueprint: rrb.Blueprint, log: Callable[[rr.RecordingStream], None]
) -> None:
    """Write a recording atomically.

    Args:
        path: The ``.rrd`` file.
        number: The recording's id; equal contents have equal ids.
        title: The recording's name in the viewer.
        blueprint: The viewer's layout for it.
        log: Function that logs its contents.
    """

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
