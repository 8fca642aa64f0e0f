"""A network trained on positions, as PoseNet is (Kendall et al. 2015; paper Eq. 1): from labels or from a map."""

from pathlib import Path

import torch

from deepgps.config.learning import LearnSettings
from deepgps.data.segments import leave_held_out
from deepgps.learning import losses
from deepgps.learning.batches import Batch
from deepgps.learning.networks import count_parameters
from deepgps.learning.trainer import train
from deepgps.learning.training_data import TrainingData, new_network
from deepgps.positioner.positioner import Fitted, as_positioner
from deepgps.terminal.progress import Report
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
    """Train on observations (n,) labelled with positions (n, 2) [m] by the paper's Eq. 1, the distance between both.

    Observations on held-out segments are not learned from.
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
    seconds = train(network, data.inputs, draw, loss, settings.train, shuffling, folder, progress, folder.name)
    training = {
        "steps": settings.train.steps,
        "train_s": round(seconds, 1),
        "parameters": count_parameters(network),
    }
    return Fitted(as_positioner(data, settings, network, -centre, torch.eye(2)), training)
