"""Nearest neighbours on the same features, with positions as labels: a map of stored images."""

import time
from pathlib import Path

from deepgps.data.labels import read_places
from deepgps.data.plausible_readings import count_readings
from deepgps.learning.training_data import prepare
from deepgps.methods.positioner import NeighbourPositioner, Positioner, is_finished, load_positioner, save_positioner
from deepgps.progress import Report, ignore
from deepgps.settings import LearnSettings
from sim.recording.format import Recording


def fit(
    recording: Recording, settings: LearnSettings, seed: int, folder: Path, progress: Report = ignore
) -> Positioner:
    """Store features and positions of all labelled observations in ``folder``; done work is loaded."""
    if is_finished(folder):
        return load_positioner(folder)
    start = time.perf_counter()
    material = prepare(recording, settings, seed, folder.parent)
    index, places = read_places(recording)
    features = material.features[index]
    positioner = NeighbourPositioner(material.projection, features, places, settings.neighbours)
    stored = features.numel() + places.numel()
    training = {"steps": 0, "train_s": round(time.perf_counter() - start, 1), "parameters": stored}
    training |= count_readings(recording)
    save_positioner(folder, positioner, training)
    progress("knn", 1, 1)
    return load_positioner(folder)
