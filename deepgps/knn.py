"""Nearest neighbours on the same features, with true positions: a map of stored images."""

import time
from pathlib import Path

import torch

from deepgps.material import prepare
from deepgps.positioner import NeighbourPositioner, Positioner, is_finished, load_positioner, save_positioner
from deepgps.progress import Report, ignore
from deepgps.settings import LearnSettings
from sim.records import Recording, open_truth


def fit(
    recording: Recording, settings: LearnSettings, seed: int, folder: Path, progress: Report = ignore
) -> Positioner:
    """Store features and true positions of all training observations in ``folder``; done work is loaded."""
    if is_finished(folder):
        return load_positioner(folder)
    start = time.perf_counter()
    material = prepare(recording, settings, seed, folder.parent)
    places = torch.from_numpy(open_truth(recording.folder).pose[:, :2].astype("float64"))
    positioner = NeighbourPositioner(material.projection, material.features, places, settings.neighbours)
    stored = material.features.numel() + places.numel()
    training = {"steps": 0, "train_s": round(time.perf_counter() - start, 1), "parameters": stored}
    save_positioner(folder, positioner, training)
    progress("knn", 1, 1)
    return load_positioner(folder)
