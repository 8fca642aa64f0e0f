"""Training along its timeline: the loss below ``training``, and below ``world`` how the map unfolds."""

from collections.abc import Mapping

import numpy as np
import rerun as rr

from deepgps.alignment import fit_alignment
from deepgps.figures import field_plot, style
from deepgps.viewer import playback
from deepgps.viewer.scene import LAYER_M, lift
from deepgps.viewer.timeline import send_series, step_index

Data = Mapping[str, np.ndarray]


def log_training(stream: rr.RecordingStream, name: str, history: Data, truth: np.ndarray) -> None:
    last = max(int(history["step"][-1]), int(history["snapshot_step"][-1]), 1)
    step, loss, colour = history["step"], take_log(history["loss"]), style.colour_on_dark(name)
    send_series(stream, f"training/{name}/loss", step_index(step, last), loss, "loss", (*colour, 90))
    send_series(stream, f"training/{name}/smooth", step_index(step, last), style.smooth(loss), "median", colour)
    place = truth[history["snapshot_index"]]
    snapshot = lay_upon(name, history["snapshot"], place)
    indexes = step_index(history["snapshot_step"], last)
    log_snapshots(stream, name, place, snapshot, indexes)
    log_snapshot_errors(stream, name, place, snapshot, indexes)


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
    stream: rr.RecordingStream, name: str, place: np.ndarray, snapshot: list[np.ndarray], indexes: list[rr.TimeColumn]
) -> None:
    """Log how the map unfolds: each snapshot's points (n, 2) [m], in the colours of their true places (n, 2)."""
    path = f"world/training/{name}"
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
