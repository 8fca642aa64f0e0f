"""A GPU replays steps, so a step must not wait for a value: fake tensors, which have none, show that without a GPU."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from torch._subclasses.fake_tensor import DataDependentOutputException, FakeTensorMode

from deepgps.config.learning import Architecture, LearnSettings, LiftSettings, NetworkSettings, TrainSettings
from deepgps.learning import losses
from deepgps.learning.batches import Batch, Inputs, Loss
from deepgps.learning.losses import flatten_later, imitate_first
from deepgps.learning.networks import make_network
from deepgps.learning.trainer import ReplayedStep, make_generator, make_step, set_rate, train
from deepgps.methods.deepgps import segment_loss
from deepgps.methods.variants import weigh_by_noise

needs_gpu = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
KNOWN = torch.tensor([[0.1, 0.2], [float("nan")] * 2]).repeat(10, 1)
DEFAULT = LearnSettings()
PAPER = LearnSettings(loss="normalised", straight=0.0)
LOSSES: dict[str, Callable[[str], Loss]] = {
    "paper": lambda device: segment_loss(PAPER, losses.weigh_equally),
    "ours": lambda device: segment_loss(DEFAULT, losses.weigh_equally),
    "arcs": lambda device: segment_loss(DEFAULT, losses.weigh_equally, curvature=0.01),
    "noise": lambda device: segment_loss(DEFAULT, weigh_by_noise(1e-6)),
    "imitation": lambda device: imitate_first(segment_loss(DEFAULT, losses.weigh_equally), KNOWN.to(device), 0.03),
}


def make_batch(generator: torch.Generator) -> Batch:
    index = torch.randint(20, (4, 8), generator=generator)
    along = torch.rand((4, 8), generator=generator).cumsum(dim=1)
    return Batch(index, along, torch.rand((4, 8), generator=generator) < 0.8, 1e-4 * along)


def step_on_fake_tensors(loss: Loss, outputs: int = 2) -> None:
    batch, generator = make_batch(make_generator(0, "batch")), make_generator(0, "weights")
    network = make_network(NetworkSettings(width=16, layers=2), 6, outputs, generator)
    step = make_step(network, torch.optim.AdamW(network.parameters()), loss, bfloat16=False)
    with FakeTensorMode(allow_non_fake_inputs=True) as mode:
        held = {name: mode.from_tensor(one) for name, one in vars(batch).items()}
        step(torch.zeros((32, 6)), Batch(**held), torch.zeros(()))


@pytest.mark.parametrize("name", LOSSES)
def test_no_loss_waits_for_a_value(name: str):
    step_on_fake_tensors(LOSSES[name]("cpu"))


def test_lifting_waits_for_values():
    with pytest.raises(DataDependentOutputException):
        step_on_fake_tensors(flatten_later(LOSSES["ours"]("cpu"), LiftSettings()), outputs=8)


def test_a_rate_is_set_in_place_where_it_is_a_tensor():
    optimiser = torch.optim.AdamW([torch.zeros(1, requires_grad=True)], lr=1.0)
    set_rate(optimiser, 0.5)
    assert optimiser.param_groups[0]["lr"] == 0.5
    held = optimiser.param_groups[0]["lr"] = torch.zeros(())
    set_rate(optimiser, 0.25)
    assert optimiser.param_groups[0]["lr"] is held and held.item() == 0.25


@needs_gpu
@pytest.mark.parametrize("architecture", ["spectral", "resnet"])
@pytest.mark.parametrize("name", LOSSES)
def test_a_replayed_training_learns_what_a_plain_one_learns(name: str, architecture: Architecture, tmp_path: Path):
    """Convolutions do not even repeat themselves on a GPU, so two plain trainings say how far apart losses may be."""
    replayed, plain, again = (
        learn_on_gpu(name, architecture, tmp_path / str(number), replay)
        for number, replay in enumerate((True, False, False))
    )
    noise, scale = np.abs(plain - again).max(), np.abs(plain).max()
    assert np.abs(replayed - plain).max() <= 10.0 * noise + 1e-3 * scale


@needs_gpu
def test_other_shapes_are_recorded_anew():
    network = make_network(NetworkSettings(width=16, layers=2), 6, 2, make_generator(0, "weights")).cuda()
    optimiser = torch.optim.AdamW(network.parameters(), fused=True)
    loss = LOSSES["ours"]("cuda")
    step = ReplayedStep(make_step(network, optimiser, loss, bfloat16=False), optimiser, torch.device("cuda:0"))
    set_rate(optimiser, 0.0)
    for rows in (4, 4, 4, 4, 4, 2, 2, 2, 2, 2, 4):
        batch = make_batch(make_generator(rows, "batch"))
        held = {name: one[:rows].cuda() for name, one in vars(batch).items()}
        inputs, done = torch.ones((8 * rows, 6), device="cuda"), torch.zeros((), device="cuda")
        inputs *= torch.arange(8 * rows, device="cuda")[:, None]
        with torch.no_grad():  # a graph of another stream that is kept would disturb the recording
            expected = loss(network(inputs).unflatten(0, (rows, 8)), Batch(**held), done).item()
        assert step(inputs, Batch(**held), done).item() == pytest.approx(expected, rel=1e-5)


def learn_on_gpu(name: str, architecture: Architecture, folder: Path, replay: bool) -> np.ndarray:
    """Losses of a short training on a GPU."""
    random = np.random.default_rng(0)
    table = (
        random.random((20, 6), np.float32) if architecture == "spectral" else random.integers(0, 255, (20, 16, 32, 3))
    )
    table = torch.from_numpy(table.astype(np.float32 if table.ndim == 2 else np.uint8)).cuda()
    network = make_network(
        NetworkSettings(architecture=architecture, width=16, channels=4), 6, 2, make_generator(0, "w")
    )
    batches = [make_batch(make_generator(number, "batch")) for number in range(60)]
    drawn = iter(Batch(**{name: one.cuda() for name, one in vars(batch).items()}) for batch in batches)
    settings = TrainSettings(steps=60, device="cuda", bfloat16=False)
    loss = LOSSES[name]("cuda")
    train(network, Inputs(table, shift=False), lambda *_: next(drawn), loss, settings, 0, folder, replay=replay)
    with np.load(folder / "history.npz") as history:
        return history["loss"]
