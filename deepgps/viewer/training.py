"""Training along its timeline: the loss below ``training``, and below ``world`` how the map unfolds."""

from collections.abc import Mapping

import numpy as np
import rerun as rr
from matplotlib.colors import to_rgb

from deepgps import figures, playback
from deepgps.alignment import fit_alignment
from deepgps.viewer.scene import LAYER_M, lift
from deepgps.viewer.timeline import send_series, step_index

Data = Mapping[str, np.ndarray]


def log_training(stream: rr.RecordingStream, name: str, history: Data, truth: np.ndarray) -> None:
    last = max(int(history["step"][-1]), 1)
    step, loss = history["step"], np.log10(np.maximum(np.asarray(history["loss"], float), 1e-9))
    colour = tuple(int(255 * part) for part in to_rgb(figures.LINES.get(name, "#888888")))
    send_series(stream, f"training/{name}/loss", step_index(step, last), loss, "loss", (*colour, 90))
    send_series(stream, f"training/{name}/smooth", step_index(step, last), figures.smooth(loss), "median", colour)
    place = truth[history["snapshot_index"]]
    snapshot = [fit_alignment(points, place, "E2").apply(points) for points in history["snapshot"].astype(float)]
    count = len(place)
    path = f"world/training/{name}"
    stream.log(path, rr.Points3D.from_fields(radii=0.025), static=True)
    stream.send_columns(
        path,
        step_index(history["snapshot_step"], last),
        rr.Points3D.columns(
            positions=lift(np.concatenate(snapshot), LAYER_M),
            colors=np.tile(playback.colours_of_places(place), (len(snapshot), 1)),
        ).partition([count] * len(snapshot)),
    )
