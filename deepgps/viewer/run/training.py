"""Trainings: the loss below ``training``, and below ``world`` how the map unfolds.

The same functions log a finished training and, part by part, one in progress.
"""

from collections.abc import Mapping, Sequence

import numpy as np
import rerun as rr

from deepgps.reports import plots
from deepgps.viewer.scene import LAYER_M, colours_of_places, lift
from deepgps.viewer.timeline import Rows, send_rows, send_series, step_rows
from sim.alignment import fit_alignment

History = Mapping[str, np.ndarray]


def log_training(stream: rr.RecordingStream, name: str, history: History, truth: np.ndarray) -> None:
    """Log a training's loss, and its snapshots aligned to the true places of the observations (N, 2) [m]."""
    log_loss(stream, name, history, loss_rows(history))
    place = truth[history["snapshot_index"]]
    log_snapshots(stream, name, place, lay_upon(name, history["snapshot"], place), snapshot_rows(history))


def loss_rows(history: History) -> Rows:
    """Rows along the timelines for a training's losses."""
    return step_rows(history["step"], _last_step(history))


def snapshot_rows(history: History) -> Rows:
    """Rows along the timelines for a training's snapshots."""
    return step_rows(history["snapshot_step"], _last_step(history))


def log_loss(stream: rr.RecordingStream, name: str, history: History, at: Rows, first: int = 0) -> None:
    """Log the decimal logarithm of a training's losses from ``first`` on, and its running median."""
    loss, colour = np.log10(np.maximum(np.asarray(history["loss"], float), 1e-9)), plots.colour_on_dark(name)
    send_series(stream, f"training/{name}/loss", at, loss[first:], "loss", (*colour, 90))
    send_series(stream, f"training/{name}/smooth", at, plots.smooth(loss, first), "median", colour)


def lay_upon(name: str, snapshots: np.ndarray, place: np.ndarray) -> list[np.ndarray]:
    """Align each of a method's snapshots (k, n, 2) to true places (n, 2) [m] by translation and rotation.

    Only snapshots of DeepGPS may be mirrored: distances leave a mirror ambiguity, which turns resolve only after the
    training.
    """
    kind = "E2" if name.startswith("deepgps") else "SE2"
    return [fit_alignment(points, place, kind).apply(points) for points in snapshots.astype(float)]


def log_snapshots(
    stream: rr.RecordingStream, name: str, place: np.ndarray, snapshots: Sequence[np.ndarray], at: Rows
) -> None:
    """Log how the map unfolds, and as arrows what is wrong with it.

    Args:
        stream: Stream to log to.
        name: The method.
        place: True places (n, 2) [m].
        snapshots: Each snapshot's points (n, 2) [m], aligned.
        at: Times of the snapshots.
    """
    log_points(stream, f"world/training/{name}", place, snapshots, at)
    vectors = np.stack(snapshots) - place
    path, lengths = f"world/training_error/{name}", [len(place)] * len(snapshots)
    origins = lift(np.tile(place, (len(snapshots), 1)), LAYER_M)
    colours = plots.colours_of(np.linalg.norm(vectors, axis=2).reshape(-1))
    arrows = rr.Arrows3D.columns(origins=origins, vectors=lift(np.concatenate(list(vectors)), 0.0), colors=colours)
    send_rows(stream, path, rr.Arrows3D.from_fields(radii=0.008), arrows.partition(lengths), at)
    dots = rr.Points3D.columns(positions=origins, colors=colours).partition(lengths)
    send_rows(stream, f"{path}/places", rr.Points3D.from_fields(radii=0.018, point_shading="Flat"), dots, at)


def log_points(
    stream: rr.RecordingStream, path: str, place: np.ndarray, snapshots: Sequence[np.ndarray], at: Rows
) -> None:
    """Log each snapshot's points (n, 2) [m], in the colours of the places (n, 2)."""
    points = rr.Points3D.columns(
        positions=lift(np.concatenate(list(snapshots)), LAYER_M),
        colors=np.tile(colours_of_places(place), (len(snapshots), 1)),
    )
    rows = points.partition([len(place)] * len(snapshots))
    send_rows(stream, path, rr.Points3D.from_fields(radii=0.025), rows, at)


def _last_step(history: History) -> int:
    return max(int(history["step"][-1]), int(history["snapshot_step"][-1]), 1)
