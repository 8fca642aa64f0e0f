"""Trainings: the loss below ``training``, and below ``world`` how the map unfolds.

The same functions log a finished training and, part by part, one in progress.
"""

from collections.abc import Mapping, Sequence

import numpy as np
import rerun as rr

from deepgps.reports import plots
from deepgps.viewer.scene import LAYER_M, colours_of_places, lift
from deepgps.viewer.stream import Rows, send_rows, send_series, step_rows
from sim.alignment import fit_alignment

History = Mapping[str, np.ndarray]


def training_rows(history: History) -> tuple[Rows, Rows]:
    """Rows along the timelines for a training's losses, and for its snapshots."""
    last = max(int(history["step"][-1]), int(history["snapshot_step"][-1]), 1)
    return step_rows(history["step"], last), step_rows(history["snapshot_step"], last)


def log_loss(stream: rr.RecordingStream, name: str, history: History, at: Rows, first: int = 0) -> None:
    """Log the decimal logarithm of a training's losses from ``first`` on, and its running median."""
    loss, colour = np.log10(np.maximum(np.asarray(history["loss"], float), 1e-9)), plots.colour_on_dark(name)
    send_series(stream, f"training/{name}/loss", at, loss[first:], "loss", (*colour, 90))
    send_series(stream, f"training/{name}/smooth", at, plots.smooth(loss, first), "median", colour)


def log_snapshots(stream: rr.RecordingStream, name: str, place: np.ndarray, snapshots: np.ndarray, at: Rows) -> None:
    """Log how the map (k, n, 2) [m] unfolds, and as arrows what is wrong with it, by the true places (n, 2) [m].

    Each snapshot is aligned to the true places by translation and rotation. Only those of DeepGPS may be mirrored:
    distances leave a mirror ambiguity, which turns resolve only after the training.
    """
    kind = "E2" if name.startswith("deepgps") else "SE2"
    aligned = np.stack([fit_alignment(points, place, kind).apply(points) for points in snapshots.astype(float)])
    log_points(stream, f"world/training/{name}", place, aligned, at)
    vectors = (aligned - place).reshape(-1, 2)
    origins, lengths = lift(np.tile(place, (len(aligned), 1)), LAYER_M), [len(place)] * len(aligned)
    colours = plots.colours_of(np.linalg.norm(vectors, axis=1))
    path, arrows = f"world/training_error/{name}", {"origins": origins, "vectors": lift(vectors, 0.0)}
    send_rows(stream, path, rr.Arrows3D, at, {**arrows, "colors": colours}, {"radii": 0.008}, lengths)
    dots, style = {"positions": origins, "colors": colours}, {"radii": 0.018, "point_shading": "Flat"}
    send_rows(stream, f"{path}/places", rr.Points3D, at, dots, style, lengths)


def log_points(
    stream: rr.RecordingStream, path: str, place: np.ndarray, snapshots: Sequence[np.ndarray] | np.ndarray, at: Rows
) -> None:
    """Log each snapshot's points (n, 2) [m], in the colours of the places (n, 2)."""
    colours = np.tile(colours_of_places(place), (len(snapshots), 1))
    points = {"positions": lift(np.concatenate(list(snapshots)), LAYER_M), "colors": colours}
    send_rows(stream, path, rr.Points3D, at, points, {"radii": 0.025}, [len(place)] * len(snapshots))
