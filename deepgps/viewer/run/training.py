"""Training along its timeline: the loss below ``training``, and below ``world`` how the map unfolds."""

from collections.abc import Mapping

import numpy as np
import rerun as rr

from deepgps.reports import field_plot, style
from deepgps.viewer import playback
from deepgps.viewer.scene import LAYER_M, lift
from deepgps.viewer.timeline import send_series, step_index
from sim.alignment import fit_alignment

Data = Mapping[str, np.ndarray]


def log_training(stream: rr.RecordingStream, name: str, history: Data, truth: np.ndarray) -> None:
    """Log a training's loss, and its snapshots aligned to the true places of the training samples (n, 2) [m]."""
    log_loss(stream, name, history)
    place = truth[history["snapshot_index"]]
    snapshot = lay_upon(name, history["snapshot"], place)
    indexes = snapshot_index(history)
    log_snapshots(stream, f"world/training/{name}", place, snapshot, indexes)
    log_snapshot_errors(stream, name, place, snapshot, indexes)


def log_loss(stream: rr.RecordingStream, name: str, history: Data) -> None:
    """Log the decimal logarithm of a training's loss, and its running median."""
    loss, colour = take_log(history["loss"]), style.colour_on_dark(name)
    indexes = step_index(history["step"], _last_step(history))
    send_series(stream, f"training/{name}/loss", indexes, loss, "loss", (*colour, 90))
    send_series(stream, f"training/{name}/smooth", indexes, style.smooth(loss), "median", colour)


def snapshot_index(history: Data) -> list[rr.TimeColumn]:
    """Rows along the timelines for a training's snapshots."""
    return step_index(history["snapshot_step"], _last_step(history))


def lay_upon(name: str, snapshots: np.ndarray, place: np.ndarray) -> list[np.ndarray]:
    """Align each of a method's snapshots (k, n, 2) to true places (n, 2) [m] by translation and rotation.

    Only snapshots of DeepGPS may be mirrored: distances leave a mirror ambiguity, which turns resolve only after the
    training.
    """
    kind = "E2" if name.startswith("deepgps") else "SE2"
    return [fit_alignment(points, place, kind).apply(points) for points in snapshots.astype(float)]


def take_log(loss: np.ndarray) -> np.ndarray:
    """Decimal logarithm of losses (n,), as the viewer shows them."""
    return np.log10(np.maximum(np.asarray(loss, float), 1e-9))


def log_snapshots(
    stream: rr.RecordingStream, path: str, place: np.ndarray, snapshot: list[np.ndarray], indexes: list[rr.TimeColumn]
) -> None:
    """Log how the map unfolds: each snapshot's points (n, 2) [m], in the colours of the places (n, 2)."""
    stream.log(path, rr.Points3D.from_fields(radii=0.025), static=True)
    stream.send_columns(
        path,
        indexes,
        rr.Points3D.columns(
            positions=lift(np.concatenate(snapshot), LAYER_M),
            colors=np.tile(playback.colours_of_places(place), (len(snapshot), 1)),
        ).partition([len(place)] * len(snapshot)),
    )


def log_snapshot_errors(
    stream: rr.RecordingStream, name: str, place: np.ndarray, snapshot: list[np.ndarray], indexes: list[rr.TimeColumn]
) -> None:
    """Log the error field of each snapshot: arrows from true places (n, 2) to predicted ones (n, 2) [m]."""
    vectors = np.stack(snapshot) - place
    path, lengths = f"world/training_error/{name}", [len(place)] * len(snapshot)
    origins = lift(np.tile(place, (len(snapshot), 1)), LAYER_M)
    colours = field_plot.colours_of(np.linalg.norm(vectors, axis=2).reshape(-1))
    stream.log(path, rr.Arrows3D.from_fields(radii=0.008), static=True)
    stream.send_columns(
        path,
        indexes,
        rr.Arrows3D.columns(
            origins=origins, vectors=lift(np.concatenate(list(vectors)), 0.0), colors=colours
        ).partition(lengths),
    )
    stream.log(f"{path}/places", rr.Points3D.from_fields(radii=0.018, point_shading="Flat"), static=True)
    stream.send_columns(
        f"{path}/places", indexes, rr.Points3D.columns(positions=origins, colors=colours).partition(lengths)
    )


def _last_step(history: Data) -> int:
    return max(int(history["step"][-1]), int(history["snapshot_step"][-1]), 1)
