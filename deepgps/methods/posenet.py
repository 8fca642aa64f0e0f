"""PoseNet, the supervised rival (Kendall et al. 2015; paper Eq. 1): the same network, trained on positions."""

from pathlib import Path

import torch

from deepgps.data.labels import read_places
from deepgps.learning.trainer import make_generator
from deepgps.learning.training_data import prepare
from deepgps.methods.positioner import Fitted
from deepgps.methods.supervised import fit_positions
from deepgps.progress import Report
from deepgps.settings import LearnSettings
from sim.recording.format import Recording


def fit(recording: Recording, settings: LearnSettings, seed: int, folder: Path, progress: Report) -> Fitted:
    """Train on labels, or on true positions where there are none."""
    index, place = read_places(recording)
    material = prepare(recording, settings, seed, folder.parent)
    return fit_positions(material, index, place.float(), settings, seed, folder, progress)


def fit_noisy(recording: Recording, settings: LearnSettings, seed: int, folder: Path, progress: Report) -> Fitted:
    """The same with labels as a surveyor would make them: each off by ``settings.label_noise_m`` in x and in y."""
    index, place = read_places(recording)
    noise = torch.randn(place.shape, generator=make_generator(seed, "labels"))
    place = place.float() + settings.label_noise_m * noise
    material = prepare(recording, settings, seed, folder.parent)
    return fit_positions(material, index, place, settings, seed, folder, progress)
