"""PoseNet, the supervised baseline (Kendall et al. 2015; paper Eq. 1): the same network, trained on positions."""

from pathlib import Path

import torch

from deepgps.config.learning import LearnSettings
from deepgps.data.labels import read_places
from deepgps.learning.trainer import make_generator
from deepgps.learning.training_data import prepare
from deepgps.methods.supervised import fit_positions
from deepgps.positioner.positioner import Fitted
from deepgps.terminal.progress import Report
from sim.recording.format import Recording

LABEL_NOISE_M = 0.01
"""Standard deviation of a noisy label, in x and in y [m]."""


def fit(recording: Recording, settings: LearnSettings, seed: int, folder: Path, progress: Report) -> Fitted:
    """Train on labels, or on true positions if the recording has no labels."""
    index, place = read_places(recording)
    data = prepare(recording, settings, seed, folder.parent)
    return fit_positions(data, index, place.float(), settings, seed, folder, progress)


def fit_noisy(recording: Recording, settings: LearnSettings, seed: int, folder: Path, progress: Report) -> Fitted:
    """Train on labels with a surveyor's errors: Gaussian noise of ``LABEL_NOISE_M`` in x and in y."""
    index, place = read_places(recording)
    noise = torch.randn(place.shape, generator=make_generator(seed, "labels"))
    place = place.float() + LABEL_NOISE_M * noise
    data = prepare(recording, settings, seed, folder.parent)
    return fit_positions(data, index, place, settings, seed, folder, progress)
