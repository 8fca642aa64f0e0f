"""Slow features with a linear map: exact where positions are linear in features or in their products."""

import numpy as np
import pytest
import torch

from deepgps.data.segments import Segments
from deepgps.methods import sfa_linear
from deepgps.methods.sfa_linear import learn
from deepgps.positioner.positioner import multiply_slowest
from sim.alignment import fit_alignment
from sim.errors import InputError


def drive(seed: int, count: int = 60) -> tuple[np.ndarray, Segments]:
    """Positions (N, 2) [m] on straight segments that cross a room, and the distances along them."""
    rng = np.random.default_rng(seed)
    ends, readings = rng.uniform(-2.0, 2.0, (count, 2, 2)), torch.from_numpy(rng.integers(4, 12, count))
    share = (torch.arange(11) / (readings[:, None] - 1)).numpy()
    places = ends[:, 0, None] + share[..., None] * (ends[:, 1] - ends[:, 0])[:, None]
    distance = torch.from_numpy(share * np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)[:, None]).float()
    return places.reshape(-1, 2), Segments(torch.arange(11 * count).reshape(count, 11), distance, readings, 0)


def locate(features: np.ndarray, weights: torch.Tensor) -> np.ndarray:
    multiplied = int((2 * (len(weights) - features.shape[1])) ** 0.5)
    return multiply_slowest(features, multiplied) @ weights.numpy()


@pytest.mark.parametrize("mirror", [1.0, -1.0])
@pytest.mark.parametrize("of_products", [False, True])
def test_positions_that_are_linear_in_features_are_found_but_for_a_motion_or_a_mirror_image(
    mirror: float, of_products: bool, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(sfa_linear, "RIDGE", 1e-12)
    places, segments = drive(0)
    x, y = (places @ np.array([[0.6, 0.8 * mirror], [-0.8, 0.6 * mirror]])).T
    if of_products:
        features = np.stack([x * np.exp(y / 2), np.exp(-y / 2), y * np.exp(x / 2), np.exp(-x / 2)], axis=1)
    else:
        features = np.stack([x + y + 5.0, np.sin(3.0 * x) - y, np.sin(3.0 * x), np.cos(2.0 * y)], axis=1)
    found = locate(features, learn(features, segments, 0))[segments.valid.flatten()]
    places = places[segments.valid.flatten()]
    assert np.abs(fit_alignment(found, places, "E2").apply(found) - places).max() < 1e-6


def test_the_seed_decides_the_bytes():
    places, segments = drive(2)
    features = np.hstack([places, np.sin(places)])
    one, again, other = (learn(features, segments, seed) for seed in (0, 0, 1))
    assert torch.equal(one, again) and not torch.equal(one, other)


def test_one_segment_is_refused():
    places, segments = drive(3, count=1)
    with pytest.raises(InputError, match="one segment does not tell directions apart"):
        learn(places, segments, 0)
