from pathlib import Path

import pytest
import torch
from torch import nn

from deepgps.learning.checkpoint import NAME, load_checkpoint, save_checkpoint
from sim.errors import InputError


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


def test_nothing_to_continue(tmp_path: Path):
    assert load_checkpoint(tmp_path, *make(0), {}) == (0, 0.0)


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


def test_a_checkpoint_of_another_network_is_refused(tmp_path: Path):
    save_checkpoint(tmp_path, 1, *make(0), {}, 0.0)
    larger = nn.Linear(3, 2)
    with pytest.raises(InputError, match=r"checkpoint\.pt belongs to another training"):
        load_checkpoint(tmp_path, larger, torch.optim.AdamW(larger.parameters()), torch.Generator(), {})


@pytest.mark.parametrize("left", [0, 10, 500])
def test_a_cut_checkpoint_is_removed_and_said(tmp_path: Path, left: int, caplog: pytest.LogCaptureFixture):
    save_checkpoint(tmp_path, 1, *make(0), {}, 0.0)
    (tmp_path / NAME).write_bytes((tmp_path / NAME).read_bytes()[:left])
    assert load_checkpoint(tmp_path, *make(0), {}) == (0, 0.0)
    assert not (tmp_path / NAME).exists()
    assert f"{tmp_path / NAME} is damaged" in caplog.text


@pytest.mark.parametrize("at", range(0, 30_000, 1237))
def test_a_flipped_bit_is_found_or_changes_nothing(tmp_path: Path, at: int):
    save_checkpoint(tmp_path, 7, *make(0), {"loss": [1.5]}, 0.25)
    data = bytearray((tmp_path / NAME).read_bytes())
    data[at // 8 % len(data)] ^= 1 << at % 8
    (tmp_path / NAME).write_bytes(data)
    network, optimiser, generator = make(1)
    history = {"loss": []}
    if load_checkpoint(tmp_path, network, optimiser, generator, history) != (0, 0.0):
        assert history == {"loss": [1.5]}
        expected = make(0)[0].state_dict()
        assert all(torch.equal(value, expected[name]) for name, value in network.state_dict().items())


def test_a_checkpoint_of_another_kind_of_device_is_refused(tmp_path: Path):
    network, optimiser, generator = make(0)
    save_checkpoint(tmp_path, 1, network, optimiser, generator, {}, 0.0)
    state = torch.load(tmp_path / NAME, weights_only=True)
    torch.save({**state, "generator": torch.zeros(16, dtype=torch.uint8)}, tmp_path / NAME)  # as CUDA's is
    with pytest.raises(InputError, match="another kind of device; without it this one starts from its first step"):
        load_checkpoint(tmp_path, *make(0), {})


def test_a_machine_out_of_memory_keeps_the_checkpoint(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    save_checkpoint(tmp_path, 1, *make(0), {}, 0.0)

    def run_out(*_: object, **__: object) -> None:
        raise MemoryError

    monkeypatch.setattr(torch, "load", run_out)
    with pytest.raises(MemoryError):
        load_checkpoint(tmp_path, *make(0), {})
    assert (tmp_path / NAME).is_file()
