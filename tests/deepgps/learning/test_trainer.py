from pathlib import Path

import numpy as np
import pytest
import torch

from deepgps.config.learning import NetworkSettings, TrainSettings
from deepgps.learning import losses
from deepgps.learning.batches import Batch, Inputs, Loss
from deepgps.learning.networks import make_network
from deepgps.learning.trainer import (
    choose_device,
    describe_device,
    find_device,
    has_fast_bfloat16,
    make_generator,
    predict,
    schedule,
    train,
)
from deepgps.terminal.progress import Look, Report, ignore
from sim.errors import InputError, WorkError
from sim.rng import derive_seed

SETTINGS = TrainSettings(steps=120, learning_rate=1e-2, checkpoint_steps=20)


class Cut(Exception):
    """Stands for kill -9."""


def cut_at(step: int) -> Report:
    def report(label: str, done: int, total: int, look: Look | None = None) -> None:
        if done == step:
            raise Cut

    return report


def aim(out: torch.Tensor, batch: Batch, done: torch.Tensor) -> torch.Tensor:
    return losses.distance(out, batch.target).mean()


def learn(folder: Path, seed: int = 0, progress: Report = ignore, settings: TrainSettings = SETTINGS, loss: Loss = aim):
    """Learn the first two of six features."""
    table = torch.randn((200, 6), generator=torch.Generator().manual_seed(7))
    network = make_network(NetworkSettings(width=16, layers=2), 6, 2, make_generator(seed, "weights"))

    def draw(generator: torch.Generator, done: float) -> Batch:
        index = torch.randint(200, (32,), generator=generator)
        return Batch(index, table[index, :2], torch.ones(32, dtype=torch.bool))

    inputs = Inputs(table, noise=0.01)
    train(network, inputs, draw, loss, settings, derive_seed(seed, "shuffling"), folder, progress)
    return network, inputs


def same_weights(first: torch.nn.Module, second: torch.nn.Module) -> bool:
    pairs = zip(first.state_dict().values(), second.state_dict().values(), strict=True)
    return all(torch.equal(a, b) for a, b in pairs)


def test_training_learns(tmp_path: Path):
    network, inputs = learn(tmp_path)
    found = predict(network, inputs, torch.arange(200))
    assert (found - inputs.table[:, :2]).norm(dim=1).mean() < 0.25 * inputs.table[:, :2].norm(dim=1).mean()


def test_same_seed_same_weights(tmp_path: Path):
    first, same, other = (learn(tmp_path / str(k), seed)[0] for k, seed in enumerate((0, 0, 1)))
    assert same_weights(first, same)
    assert not same_weights(first, other)
    histories = [(tmp_path / str(k) / "history.npz").read_bytes() for k in range(2)]
    assert histories[0] == histories[1]


@pytest.mark.parametrize("step", [1, 37, 40, 119])
def test_a_training_cut_off_anywhere_ends_with_the_same_weights(tmp_path: Path, step: int):
    whole, _ = learn(tmp_path / "whole")
    with pytest.raises(Cut):
        learn(tmp_path / "cut", progress=cut_at(step))
    continued, _ = learn(tmp_path / "cut")
    assert same_weights(whole, continued)
    assert (tmp_path / "whole/history.npz").read_bytes() == (tmp_path / "cut/history.npz").read_bytes()


def test_a_finished_training_is_not_repeated(tmp_path: Path):
    first, _ = learn(tmp_path)
    again, _ = learn(tmp_path, progress=cut_at(1))
    assert same_weights(first, again)


def test_history_holds_losses_and_thirty_snapshots(tmp_path: Path):
    learn(tmp_path)
    with np.load(tmp_path / "history.npz") as history:
        assert history["snapshot"].shape == (30, 200, 2)
        assert history["snapshot_step"][0] == 0 and history["snapshot_step"][-1] == SETTINGS.steps
        assert np.all(np.diff(history["snapshot_step"]) > 0)
        assert history["step"][-1] == SETTINGS.steps and len(history["loss"]) == len(history["step"])
        assert history["loss"][-1] < 0.5 * history["loss"][0]
        assert history["snapshot_index"].tolist() == list(range(200))


def test_rate_rises_then_falls_to_zero():
    rates = [schedule(step, 1000) for step in range(1001)]
    top = int(np.argmax(rates))
    assert rates[top] == pytest.approx(1.0) and 40 <= top <= 60
    assert np.all(np.diff(rates[:top]) > 0) and np.all(np.diff(rates[top:]) < 0)
    assert rates[-1] == pytest.approx(0.0)


def test_images_are_shifted_in_a_circle_only_in_training():
    image = torch.randint(0, 256, (4, 5, 8, 3), generator=torch.Generator().manual_seed(0), dtype=torch.uint8)
    inputs, index = Inputs(image), torch.arange(4)
    still = inputs.take(index)
    assert torch.allclose(still, image.permute(0, 3, 1, 2).float() / 255.0)
    turned = inputs.take(index, torch.Generator().manual_seed(1))
    shifts = [[torch.equal(turned[k], still[k].roll(s, dims=2)) for s in range(8)] for k in range(4)]
    assert all(sum(one) == 1 for one in shifts)
    assert len({one.index(True) for one in shifts}) > 1


def test_images_stay_as_they_are_where_shifts_are_not_wanted():
    image = torch.arange(4 * 2 * 8 * 3, dtype=torch.uint8).view(4, 2, 8, 3)
    inputs, index = Inputs(image, shift=False), torch.arange(4)
    assert torch.equal(inputs.take(index, torch.Generator().manual_seed(0)), inputs.take(index))


def test_each_purpose_and_attempt_has_its_own_stream():
    seeds = {derive_seed(s, p, a) for s in range(3) for p in ("weights", "shuffling") for a in range(3)}
    assert len(seeds) == 18


def test_a_number_beyond_the_last_device_is_refused(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    assert [str(choose_device(name)) for name in ("cpu", "cuda", "cuda:1")] == ["cpu", "cuda", "cuda:1"]
    with pytest.raises(InputError, match=r"learn\.train\.device 'cuda:2': this machine's last CUDA device is cuda:1"):
        choose_device("cuda:2")


def test_an_absent_device_is_refused():
    if torch.cuda.is_available():
        pytest.skip("this machine has CUDA")
    assert choose_device("auto").type == "cpu"
    with pytest.raises(InputError, match=r"learn\.train\.device 'cuda': this machine has no CUDA device"):
        choose_device("cuda")
    assert describe_device().startswith("CPU, ")
    assert find_device("cuda").type == "cpu"


@pytest.mark.parametrize(
    ("processor", "fast"),
    [
        ({"cpu_name": "AMD EPYC", "avx512_bf16": True, "amx_bf16": False}, True),
        ({"cpu_name": "Intel Xeon", "avx512_bf16": True, "amx_bf16": True}, True),
        ({"cpu_name": "Intel Xeon", "avx512_bf16": True, "amx_bf16": False}, False),
        ({"cpu_name": "AMD EPYC", "avx512_bf16": False, "amx_bf16": False}, False),
        ({"architecture": "aarch64", "bf16": True}, False),
    ],
)
def test_bfloat16_is_used_where_it_is_faster(
    processor: dict[str, str | bool], fast: bool, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: processor)
    assert has_fast_bfloat16(torch.device("cpu")) == fast


def test_threads_are_lent_only_to_training(tmp_path: Path):
    before = torch.get_num_threads()
    seen = []
    learn(tmp_path, progress=lambda *_: seen.append(torch.get_num_threads()))
    assert set(seen) == {SETTINGS.threads} == {1}
    with pytest.raises(Cut):
        learn(tmp_path / "cut", progress=cut_at(1))
    assert torch.get_num_threads() == before


def test_a_training_that_diverges_says_so_and_leaves_no_checkpoint_of_it(tmp_path: Path):
    def burst(out: torch.Tensor, batch: Batch, done: torch.Tensor) -> torch.Tensor:
        return aim(out, batch, done) * (torch.nan if done >= 0.5 else 1.0)

    with pytest.raises(WorkError, match=r"training diverged before step 6\d: .*learn.train.learning_rate"):
        learn(tmp_path, loss=burst)
    with pytest.raises(WorkError, match="training diverged"):  # from the last checkpoint, which is sound
        learn(tmp_path, loss=burst)
    learn(tmp_path)
