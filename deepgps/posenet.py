"""PoseNet, the supervised rival (Kendall et al. 2015; paper Eq. 1): the same network, trained on true positions."""

from pathlib import Path

import torch

from deepgps.positioner import Positioner
from deepgps.progress import Report, ignore
from deepgps.settings import LearnSettings
from deepgps.supervised import fit_positions
from deepgps.train import make_generator
from sim.records import Recording, open_truth


def fit(
    recording: Recording, settings: LearnSettings, seed: int, folder: Path, progress: Report = ignore
) -> Positioner:
    """Train on true positions into ``folder``; done work is loaded, cut-off work continued."""
    place = _true_places(recording)
    return fit_positions(recording, torch.arange(len(place)), place, settings, seed, folder, progress, "posenet")


def fit_noisy(
    recording: Recording, settings: LearnSettings, seed: int, folder: Path, progress: Report = ignore
) -> Positioner:
    """The same with labels as a surveyor would make them: each off by ``settings.label_noise_m`` in x and in y."""
    place = _true_places(recording)
    noise = torch.randn(place.shape, generator=make_generator(seed, "labels"))
    place = place + settings.label_noise_m * noise
    return fit_positions(recording, torch.arange(len(place)), place, settings, seed, folder, progress, "posenet_noisy")


def _true_places(recording: Recording) -> torch.Tensor:
    return torch.from_numpy(open_truth(recording.folder).pose[:, :2].astype("float32"))
