"""Losses: means over pairs that see no rigid motion, with exact gradients."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from deepgps.config.learning import PairLoss
from deepgps.learning import losses

KINDS: tuple[PairLoss, ...] = ("absolute", "normalised")
SEEDS = st.integers(0, 2**32 - 1)


def made_up(seed: int, segments: int = 3, samples: int = 5, dimensions: int = 2):
    generator = torch.Generator().manual_seed(seed)
    positions = torch.randn((segments, samples, dimensions), generator=generator, dtype=torch.float64)
    along = torch.rand((segments, samples), generator=generator, dtype=torch.float64)
    valid = torch.rand((segments, samples), generator=generator) < 0.8
    return positions, along, valid


@pytest.mark.parametrize("kind", KINDS)
@given(seed=SEEDS)
@settings(max_examples=30, deadline=None)
def test_dense_is_the_mean_over_all_pairs(kind: PairLoss, seed: int):
    positions, along, valid = made_up(seed)
    expected = []
    for p, a, v in zip(positions.numpy(), along.numpy(), valid.numpy(), strict=True):
        for i in range(len(p)):
            for j in range(i + 1, len(p)):
                if v[i] and v[j]:
                    d, c = np.linalg.norm(p[i] - p[j]), abs(a[i] - a[j])
                    expected.append(abs(d - c) if kind == "absolute" else abs(d - c) / (d + c))
    assert losses.dense(positions, along, valid, kind).item() == pytest.approx(np.mean(expected) if expected else 0.0)


@given(seed=SEEDS, angle=st.floats(-4, 4), x=st.floats(-10, 10), y=st.floats(-10, 10), mirrored=st.booleans())
@settings(max_examples=30, deadline=None)
def test_losses_see_neither_rigid_motion_nor_the_way_driven(
    seed: int, angle: float, x: float, y: float, mirrored: bool
):
    positions, along, valid = made_up(seed)
    turn = torch.tensor([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    if mirrored:
        turn = turn * torch.tensor([1.0, -1.0], dtype=torch.float64)
    moved = positions @ turn + torch.tensor([x, y], dtype=torch.float64)
    for p, c in ((moved, along), (positions, 1.0 - along)):
        for kind in KINDS:
            assert torch.isclose(losses.dense(p, c, valid, kind), losses.dense(positions, along, valid, kind))
        assert torch.isclose(losses.straight(p, c, valid), losses.straight(positions, along, valid))


def test_a_right_map_costs_nothing_and_so_does_no_pair():
    along = torch.tensor([[0.0, 0.3, 0.5]], dtype=torch.float64)
    positions = torch.tensor([1.0, 2.0]) + along[..., None] * torch.tensor([0.6, -0.8], dtype=torch.float64)
    valid = torch.ones_like(along, dtype=torch.bool)
    assert losses.dense(positions, along, valid, "absolute").item() == pytest.approx(0.0, abs=1e-12)
    assert losses.straight(positions, along, valid).item() == pytest.approx(0.0, abs=1e-7)
    positions, along, _ = made_up(0)
    none = torch.zeros(along.shape, dtype=torch.bool)
    assert losses.dense(positions, along, none, "absolute").item() == 0.0
    assert losses.straight(positions, along, none).item() == 0.0


def test_a_small_bend_costs_straightness_in_proportion_and_distance_by_its_square():
    along = torch.linspace(-1.0, 1.0, 9, dtype=torch.float64)[None]
    valid = torch.ones_like(along, dtype=torch.bool)

    def bent(angle: float) -> torch.Tensor:
        turned = torch.where(along > 0, angle, 0.0)
        return along[..., None] * torch.stack([turned.cos(), turned.sin()], dim=-1)

    small, large = bent(0.01), bent(0.02)
    straight = [losses.straight(p, along, valid).item() for p in (small, large)]
    dense = [losses.dense(p, along, valid, "absolute").item() for p in (small, large)]
    assert straight[1] / straight[0] == pytest.approx(2.0, rel=0.01)
    assert dense[1] / dense[0] == pytest.approx(4.0, rel=0.01)
    assert straight[0] > 20 * dense[0]


@pytest.mark.parametrize("loss", ["absolute", "normalised", "straight"])
def test_gradients_agree_with_finite_differences_and_are_finite_where_everything_coincides(loss):
    def value(p: torch.Tensor, along: torch.Tensor, valid: torch.Tensor) -> torch.Tensor:
        return losses.straight(p, along, valid) if loss == "straight" else losses.dense(p, along, valid, loss)

    positions, along, valid = made_up(1)
    assert torch.autograd.gradcheck(lambda p: value(p, along, valid), (positions.requires_grad_(),))
    positions = torch.zeros((2, 4, 2), requires_grad=True)
    cost = value(positions, torch.zeros((2, 4)), torch.ones((2, 4), dtype=torch.bool))
    cost.backward()
    assert cost.item() == 0.0
    assert positions.grad is not None and torch.isfinite(positions.grad).all()


def test_two_samples_are_the_end_point_strategy():
    ends = torch.tensor([[[0.0, 0.0], [3.0, 4.0]]])
    along, valid = torch.tensor([[0.0, 4.0]]), torch.ones((1, 2), dtype=torch.bool)
    assert losses.dense(ends, along, valid, "absolute").item() == pytest.approx(1.0)
    assert losses.dense(ends, along, valid, "normalised").item() == pytest.approx(1.0 / 9.0)
    # Each end lies half the excess off.
    assert losses.straight(ends, along, valid).item() == pytest.approx(0.5)
