"""Training on positions as labels: the same network, inputs, steps and loop as DeepGPS.

Dead-reckoned positions are labels too: what the encoders alone would teach.
"""

from pathlib import Path

import numpy as np
import torch

from deepgps.config.learning import LearnSettings
from deepgps.data.segments import dead_reckon, leave_held_out
from deepgps.learning import losses
from deepgps.learning.batches import Batch
from deepgps.learning.networks import count_parameters
from deepgps.learning.trainer import train
from deepgps.learning.training_data import TrainingData, new_network, prepare
from deepgps.positioner.positioner import Fitted, as_positioner
from deepgps.terminal.progress import Report
from sim.recording.format import Recording
from sim.rng import derive_seed


def fit_positions(
    data: TrainingData,
    index: torch.Tensor,
    label: torch.Tensor,
    settings: LearnSettings,
    seed: int,
    folder: Path,
    progress: Report,
) -> Fitted:
    """Train on labelled observations with the paper's Eq. 1, the distance between prediction and label.

    Observations on held-out segments are not learned from.

    Args:
        data: The network's input.
        index: Labelled observations (n,).
        label: Their positions (n, 2) [m].
        settings: Network and training.
        seed: Seed of weights and batches.
        folder: The method's folder, for its checkpoint.
        progress: Called with the steps done and their number.
    """
    index, label = leave_held_out(index, label, data.segments, len(data.features))
    # The mean of the labels is the origin, since an untrained network predicts near zero.
    centre = label.float().mean(dim=0)
    device = data.device
    index, label = index.to(device), (label.float() - centre).to(device)
    count = settings.train.segments * settings.train.samples

    def draw(generator: torch.Generator, done: float) -> Batch:
        chosen = torch.randint(len(index), (count,), generator=generator, device=device)
        return Batch(index[chosen], label[chosen], torch.ones(count, dtype=torch.bool, device=device))

    def loss(out: torch.Tensor, batch: Batch, done: torch.Tensor) -> torch.Tensor:
        return losses.distance(out, batch.target).mean()

    network, shuffling = new_network(data, settings, 2, seed), derive_seed(seed, "shuffling")
    seconds = train(
        network, data.inputs, draw, loss, settings.train, shuffling, folder, progress, folder.name, replay=True
    )
    training = {
        "steps": settings.train.steps,
        "train_s": round(seconds, 1),
        "parameters": count_parameters(network),
    }
    return Fitted(as_positioner(data, settings, network, -centre, torch.eye(2)), training)


def fit_dead_reckoned(
    recording: Recording, settings: LearnSettings, seed: int, folder: Path, progress: Report
) -> Fitted:
    """Train on dead-reckoned positions."""
    # Where the robot turns, one observation has two readings; either gives its label. Lost readings give no label.
    index, first = np.unique(recording.reading[:, 1], return_index=True)
    place = dead_reckon(recording)[first, :2].astype(np.float32)
    data = prepare(recording, settings, seed, folder.parent)
    return fit_positions(data, torch.from_numpy(index), torch.from_numpy(place), settings, seed, folder, progress)
