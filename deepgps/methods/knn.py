"""Nearest neighbours on the same features, with positions as labels: a map of stored images."""

import time
from pathlib import Path

from deepgps.config.learning import LearnSettings
from deepgps.data.labels import read_places
from deepgps.data.segments import leave_held_out
from deepgps.learning.training_data import prepare
from deepgps.positioner.positioner import Fitted, NeighbourPositioner
from deepgps.terminal.progress import Report
from sim.recording.format import Recording

NEIGHBOURS = 4
"""Number of stored positions that are averaged."""


def fit(recording: Recording, settings: LearnSettings, seed: int, folder: Path, progress: Report) -> Fitted:
    """Store features and positions of the labelled observations, without those on segments held out."""
    start = time.perf_counter()
    data = prepare(recording, settings, seed, folder.parent)
    index, places = leave_held_out(*read_places(recording), data.segments, len(data.features))
    features = data.features[index]
    positioner = NeighbourPositioner(data.projection, features, places, NEIGHBOURS)
    stored = features.numel() + places.numel()
    training = {"steps": 0, "train_s": round(time.perf_counter() - start, 1), "parameters": stored}
    progress(folder.name, 1, 1)
    return Fitted(positioner, training)
