"""PoseNet, the supervised rival (Kendall et al. 2015; paper Eq. 1): the same network, trained on true positions."""

from pathlib import Path

import torch

from deepgps.positioner import Positioner
from deepgps.progress import Report, ignore
from deepgps.settings import LearnSettings
from deepgps.supervised import fit_positions
from sim.records import Recording, open_truth


def fit(
    recording: Recording, settings: LearnSettings, seed: int, folder: Path, progress: Report = ignore
) -> Positioner:
    """Train on true positions into ``folder``; done work is loaded, cut-off work continued."""
    place = torch.from_numpy(open_truth(recording.folder).pose[:, :2].astype("float32"))
    return fit_positions(recording, torch.arange(len(place)), place, settings, seed, folder, progress, "posenet")
