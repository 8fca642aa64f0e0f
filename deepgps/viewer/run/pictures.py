"""Fisheye pictures at a size that shows the room: rendered for people after a run, kept in ``<run>/pictures.npz``."""

from contextlib import suppress
from pathlib import Path

import numpy as np
import rerun as rr

from deepgps.viewer import playback
from deepgps.viewer.timeline import drive_index
from sim.errors import DamagedError
from sim.files.arrays import read_arrays, write_arrays
from sim.recording.format import Recording, open_recording, open_truth

PICTURES = "pictures.npz"
LARGE = "large"
"""Name of the pictures below ``drive``."""
COUNT = 36


def choose_views(run: Path) -> tuple[np.ndarray, np.ndarray]:
    """Observations of a run's drive to draw for people (n,), evenly spread, and their true poses (n, 3)."""
    recording, truth = open_recording(run / "recording"), open_truth(run / "recording")
    seen = np.unique(recording.reading[:, 1])
    chosen = seen[np.unique(np.linspace(0, len(seen) - 1, COUNT).round().astype(int))]
    return chosen, truth.pose[chosen]


def write_pictures(run: Path, observation: np.ndarray, pictures: np.ndarray) -> None:
    """Write pictures (n, rows, columns, 3) of observations (n,)."""
    blobs = {
        f"{number:06d}": np.frombuffer(playback.encode_jpeg(picture), np.uint8)
        for number, picture in zip(observation, pictures, strict=True)
    }
    write_arrays(run / PICTURES, blobs)


def read_pictures(run: Path) -> dict[int, bytes]:
    """Pictures as JPEG by observation; none if they were not drawn, or if the file is damaged."""
    with suppress(DamagedError, FileNotFoundError):
        return {int(name): blob.tobytes() for name, blob in read_arrays(run / PICTURES).items()}
    return {}


def log_pictures(stream: rr.RecordingStream, pictures: dict[int, bytes], recording: Recording) -> None:
    """Log the pictures at the times of their observations."""
    if not pictures:
        return
    seen, first = np.unique(recording.reading[:, 1], return_index=True)
    there = [number for number in pictures if number in set(seen.tolist())]
    time = recording.time[first[np.searchsorted(seen, there)]]
    stream.log(f"drive/{LARGE}", rr.EncodedImage.from_fields(media_type="image/jpeg"), static=True)
    blobs = [pictures[number] for number in there]
    stream.send_columns(f"drive/{LARGE}", drive_index(time, recording), rr.EncodedImage.columns(blob=blobs))
