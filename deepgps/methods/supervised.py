"""Training on positions as labels: the same network, inputs, steps and loop as DeepGPS."""

from pathlib import Path

import torch

from deepgps.data.plausible_readings import count_readings
from deepgps.learning import losses
from deepgps.learning.batches import Batch
from deepgps.learning.checkpoint import NAME as CHECKPOINT
from deepgps.learning.networks import count_parameters
from deepgps.learning.trainer import derive_seed, train
from deepgps.learning.training_data import new_network, prepare
from deepgps.methods.positioner import Positioner, as_positioner, is_finished, load_positioner, save_positioner
from deepgps.progress import Report
from deepgps.settings import LearnSettings
from sim.recording.format import Recording


def fit_positions(
    recording: Recording,
    index: torch.Tensor,
    label: torch.Tensor,
    settings: LearnSettings,
    seed: int,
    folder: Path,
    progress: Report,
    name: str,
) -> Positioner:
    """Train on labelled observations with the paper's Eq. 1, the distance of prediction and label.

    Args:
        recording: Where the observations are.
        index: Labelled observations (n,).
        label: Their positions (n, 2) [m].
        settings: Network and training.
        seed: Of weights and draws.
        folder: Where the method goes; done work there is loaded, cut-off work continued.
        progress: Told how far it is.
        name: What it is told to be.
    """
    if not is_finished(folder):
        learn(recording, index, label, settings, seed, folder, progress, name)
    (folder / CHECKPOINT).unlink(missing_ok=True)
    return load_positioner(folder)


def learn(
    recording: Recording,
    index: torch.Tensor,
    label: torch.Tensor,
    settings: LearnSettings,
    seed: int,
    folder: Path,
    progress: Report,
    name: str,
) -> None:
    """Train and save; the arguments are those of ``fit_positions``."""
    material = prepare(recording, settings, seed, folder.parent)
    # The middle of the labels is the origin, as a network starts near zero.
    centre = label.float().mean(dim=0)
    device = material.inputs.table.device
    index, label = index.to(device), (label.float() - centre).to(device)
    count = settings.train.segments * settings.train.samples

    def draw_batch(generator: torch.Generator, done: float) -> Batch:
        chosen = torch.randint(len(index), (count,), generator=generator, device=device)
        return Batch(index[chosen], label[chosen], torch.ones(count, dtype=torch.bool, device=device))

    def loss(out: torch.Tensor, batch: Batch, done: float) -> torch.Tensor:
        return losses.distance(out, batch.target).mean()

    network = new_network(material, settings, 2, seed)
    seconds = train(
        network,
        material.inputs,
        draw_batch,
        loss,
        settings.train,
        derive_seed(seed, "shuffling"),
        folder,
        progress,
        name,
    )
    positioner = as_positioner(material, settings, network, -centre, torch.eye(2))
    training = {
        "steps": settings.train.steps,
        "train_s": round(seconds, 1),
        "parameters": count_parameters(network),
        **count_readings(recording),
    }
    save_positioner(folder, positioner, training)
