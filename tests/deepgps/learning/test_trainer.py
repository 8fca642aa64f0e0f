"""Trainings: the same bytes however they are interrupted."""

import os
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn

from deepgps.config.learning import NetworkSettings, TrainSettings
from deepgps.learning import losses
from deepgps.learning.batches import Batch, Inputs, Loss
from deepgps.learning.checkpoint import NAME, load_checkpoint, save_checkpoint
from deepgps.learning.networks import make_network
from deepgps.learning.trainer import (
    choose_device,
    describe_device,
    find_device,
    has_fast_bfloat16,
    load_triton,
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


def test_training_learns_and_its_history_holds_losses_and_thirty_snapshots(tmp_path: Path):
    network, inputs = learn(tmp_path)
    found = predict(network, inputs, torch.arange(200))
    assert (found - inputs.table[:, :2]).norm(dim=1).mean() < 0.25 * inputs.table[:, :2].norm(dim=1).mean()
    with np.load(tmp_path / "history.npz") as history:
        assert history["snapshot"].shape == (30, 200, 2)
        assert history["snapshot_step"][0] == 0 and history["snapshot_step"][-1] == SETTINGS.steps
        assert np.all(np.diff(history["snapshot_step"]) > 0)
        assert history["step"][-1] == SETTINGS.steps and len(history["loss"]) == len(history["step"])
        assert history["loss"][-1] < 0.5 * history["loss"][0]
        assert history["snapshot_index"].tolist() == list(range(200))


def test_same_seed_same_weights(tmp_path: Path):
    first, same, other = (learn(tmp_path / str(k), seed)[0] for k, seed in enumerate((0, 0, 1)))
    assert same_weights(first, same)
    assert not same_weights(first, other)
    histories = [(tmp_path / str(k) / "history.npz").read_bytes() for k in range(2)]
    assert histories[0] == histories[1]


def test_a_training_cut_off_anywhere_ends_with_the_same_weights(tmp_path: Path):
    whole, _ = learn(tmp_path / "whole")
    for step in (1, 37, 40, 119):
        folder = tmp_path / str(step)
        with pytest.raises(Cut):
            learn(folder, progress=cut_at(step))
        continued, _ = learn(folder)
        assert same_weights(whole, continued)
        assert (tmp_path / "whole/history.npz").read_bytes() == (folder / "history.npz").read_bytes()
    finished, _ = learn(folder, progress=cut_at(1))  # which is not repeated
    assert same_weights(whole, finished)


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
    assert torch.equal(Inputs(image, shift=False).take(index, torch.Generator().manual_seed(0)), still)


def test_an_absent_device_is_refused(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert choose_device("auto").type == find_device("cuda").type == "cpu" and describe_device().startswith("CPU, ")
    with pytest.raises(InputError, match=r"learn\.train\.device 'cuda': this machine has no CUDA device"):
        choose_device("cuda")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    assert [str(choose_device(name)) for name in ("cpu", "cuda", "cuda:1")] == ["cpu", "cuda", "cuda:1"]
    with pytest.raises(InputError, match=r"learn\.train\.device 'cuda:2': this machine's last CUDA device is cuda:1"):
        choose_device("cuda:2")


def test_triton_is_loaded_with_its_own_symbols(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "triton.py").write_text("import sys\nflags = sys.getdlopenflags()\n")
    monkeypatch.delitem(sys.modules, "triton", raising=False)
    monkeypatch.syspath_prepend(tmp_path)
    before = sys.getdlopenflags()
    load_triton()
    assert sys.modules.pop("triton").flags == before | os.RTLD_DEEPBIND and sys.getdlopenflags() == before


def test_bfloat16_is_used_where_it_is_faster(monkeypatch: pytest.MonkeyPatch):
    for name, avx512, amx, fast in (
        ("AMD EPYC", True, False, True),
        ("Intel Xeon", True, True, True),
        ("Intel Xeon", True, False, False),
        ("AMD EPYC", False, False, False),
    ):
        processor = {"cpu_name": name, "avx512_bf16": avx512, "amx_bf16": amx}
        monkeypatch.setattr(torch.cpu, "get_capabilities", lambda known=processor: known)
        assert has_fast_bfloat16(torch.device("cpu")) == fast
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: {"architecture": "aarch64", "bf16": True})
    assert not has_fast_bfloat16(torch.device("cpu"))


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


def make(seed: int):
    network = nn.Linear(2, 2)
    for parameter in network.parameters():
        nn.init.normal_(parameter, generator=torch.Generator().manual_seed(seed))
    optimiser = torch.optim.AdamW(network.parameters())
    network(torch.ones(1, 2)).sum().backward()
    optimiser.step()
    return network, optimiser, torch.Generator().manual_seed(seed)


def test_all_that_the_next_step_depends_on_comes_back(tmp_path: Path):
    network, optimiser, generator = make(0)
    history = {"step": [3], "snapshot": [torch.ones(2, 2)]}
    torch.rand(5, generator=generator)
    save_checkpoint(tmp_path, 3, network, optimiser, generator, history, 1.5)

    other, other_optimiser, other_generator = make(1)
    found = {"step": [], "snapshot": []}
    assert load_checkpoint(tmp_path, other, other_optimiser, other_generator, found) == (3, 1.5)
    assert torch.equal(torch.rand(3, generator=generator), torch.rand(3, generator=other_generator))
    for model, rule in ((network, optimiser), (other, other_optimiser)):
        rule.zero_grad()
        model(torch.tensor([[1.0, -2.0]])).square().sum().backward()
        rule.step()
    pairs = zip(network.parameters(), other.parameters(), strict=True)
    assert all(torch.equal(a, b) for a, b in pairs)
    assert found["step"] == [3] and torch.equal(found["snapshot"][0], torch.ones(2, 2))


def test_a_checkpoint_cut_off_while_it_is_written_leaves_the_old_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    network, optimiser, generator = make(0)
    save_checkpoint(tmp_path, 1, network, optimiser, generator, {}, 0.0)

    def write_half(path: Path, data: bytes) -> int:
        with path.open("wb") as file:
            file.write(data[:500])
        raise KeyboardInterrupt

    monkeypatch.setattr(Path, "write_bytes", write_half)
    with pytest.raises(KeyboardInterrupt):
        save_checkpoint(tmp_path, 2, network, optimiser, generator, {}, 0.0)
    assert load_checkpoint(tmp_path, network, optimiser, generator, {})[0] == 1


def test_a_checkpoint_of_another_network_or_kind_of_device_is_refused(tmp_path: Path):
    save_checkpoint(tmp_path, 1, *make(0), {}, 0.0)
    larger = nn.Linear(3, 2)
    with pytest.raises(InputError, match=r"checkpoint\.pt belongs to another training"):
        load_checkpoint(tmp_path, larger, torch.optim.AdamW(larger.parameters()), torch.Generator(), {})
    state = torch.load(tmp_path / NAME, weights_only=True)
    torch.save({**state, "generator": torch.zeros(16, dtype=torch.uint8)}, tmp_path / NAME)  # as CUDA's is
    with pytest.raises(InputError, match="another kind of device; without it this one starts from its first step"):
        load_checkpoint(tmp_path, *make(0), {})


def test_a_cut_checkpoint_is_removed_and_said(tmp_path: Path, caplog: pytest.LogCaptureFixture):
    assert load_checkpoint(tmp_path, *make(0), {}) == (0, 0.0)
    for left in (0, 10, 500):
        save_checkpoint(tmp_path, 1, *make(0), {}, 0.0)
        (tmp_path / NAME).write_bytes((tmp_path / NAME).read_bytes()[:left])
        assert load_checkpoint(tmp_path, *make(0), {}) == (0, 0.0)
        assert not (tmp_path / NAME).exists()
        assert f"{tmp_path / NAME} is damaged" in caplog.messages[-1]


def test_a_flipped_bit_is_found_or_changes_nothing(tmp_path: Path):
    expected = make(0)[0].state_dict()
    for at in range(0, 30_000, 1237):
        save_checkpoint(tmp_path, 7, *make(0), {"loss": [1.5]}, 0.25)
        data = bytearray((tmp_path / NAME).read_bytes())
        data[at // 8 % len(data)] ^= 1 << at % 8
        (tmp_path / NAME).write_bytes(data)
        network, optimiser, generator = make(1)
        history = {"loss": []}
        if load_checkpoint(tmp_path, network, optimiser, generator, history) != (0, 0.0):
            assert history == {"loss": [1.5]}
            assert all(torch.equal(value, expected[name]) for name, value in network.state_dict().items())


def test_a_machine_out_of_memory_keeps_the_checkpoint(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    save_checkpoint(tmp_path, 1, *make(0), {}, 0.0)

    def run_out(*_: object, **__: object) -> None:
        raise MemoryError

    monkeypatch.setattr(torch, "load", run_out)
    with pytest.raises(MemoryError):
        load_checkpoint(tmp_path, *make(0), {})
    assert (tmp_path / NAME).is_file()
