"""The same network trained on dead-reckoned positions as labels: what the encoders alone would teach."""

from pathlib import Path

import numpy as np
import torch

from deepgps.config.learning import LearnSettings
from deepgps.data.dead_reckoning import dead_reckon
from deepgps.learning.training_data import prepare
from deepgps.methods.supervised import fit_positions
from deepgps.positioner.positioner import Fitted
from deepgps.terminal.progress import Report
from sim.recording.format import Recording


def fit(recording: Recording, settings: LearnSettings, seed: int, folder: Path, progress: Report) -> Fitted:
    """Train on dead-reckoned positions."""
    # Where the robot turns, one observation has two readings; either gives its label. Lost readings give no label.
    index, first = np.unique(recording.reading[:, 1], return_index=True)
    place = dead_reckon(recording)[first, :2].astype(np.float32)
    data = prepare(recording, settings, seed, folder.parent)
    return fit_positions(data, torch.from_numpy(index), torch.from_numpy(place), settings, seed, folder, progress)
