"""PoseNet, the supervised rival (Kendall et al. 2015; paper Eq. 1): the same network, trained on positions."""

from pathlib import Path

import torch

from deepgps.data.labels import read_places
from deepgps.learning.trainer import make_generator
from deepgps.methods.positioner import Positioner
from deepgps.methods.supervised import fit_positions
from deepgps.progress import Report, ignore
from deepgps.settings import LearnSettings
from sim.recording.format import Recording


def fit(
    recording: Recording, settings: LearnSettings, seed: int, folder: Path, progress: Report = ignore
) -> Positioner:
    """Train on labels, or on true positions where there are none; done work is loaded, cut-off work continued."""
    index, place = read_places(recording)
    return fit_positions(recording, index, place.float(), settings, seed, folder, progress, "posenet")


def fit_noisy(
    recording: Recording, settings: LearnSettings, seed: int, folder: Path, progress: Report = ignore
) -> Positioner:
    """The same with labels as a surveyor would make them: each off by ``settings.label_noise_m`` in x and in y."""
    index, place = read_places(recording)
    noise = torch.randn(place.shape, generator=make_generator(seed, "labels"))
    place = place.float() + settings.label_noise_m * noise
    return fit_positions(recording, index, place, settings, seed, folder, progress, "posenet_noisy")
