import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import rankdata

from deepgps.config.learning import FeatureSettings
from deepgps.data import features
from deepgps.data.features import describe, fit_features, rank_values, relight
from deepgps.data.segments import Segments


def images(count: int, seed: int = 0, values: int = 256) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, values, (count, 6, 32, 3), dtype=np.uint8)


def rank(image: np.ndarray) -> np.ndarray:
    return rank_values(torch.from_numpy(image.transpose(0, 1, 3, 2).copy())).numpy().transpose(0, 1, 3, 2)


@given(seed=st.integers(0, 1000), values=st.integers(1, 256))
@settings(max_examples=20, deadline=None)
def test_equal_values_share_the_mean_of_their_ranks(seed: int, values: int):
    image = images(2, seed, values)
    flat = image.reshape(2, -1)
    expected = (rankdata(flat, axis=1) - 0.5) / flat.shape[1] * 255.0  # which scipy sorts
    assert np.allclose(rank(image).reshape(flat.shape), expected, atol=1e-3)


@given(seed=st.integers(0, 1000), curve_seed=st.integers(0, 1000))
@settings(max_examples=20, deadline=None)
def test_no_monotone_change_of_brightness_alters_the_description(seed: int, curve_seed: int):
    image = images(2, seed, 100)
    # a curve that keeps different values apart, as exposure and gamma do
    curve = np.sort(np.random.default_rng(curve_seed).choice(256, 100, replace=False)).astype(np.uint8)
    assert torch.equal(describe(image, 12, values="ranks"), describe(curve[image], 12, values="ranks"))


@given(shift=st.integers(-40, 40), seed=st.integers(0, 1000))
@settings(max_examples=20, deadline=None)
def test_turning_shifts_the_ranks_exactly(shift: int, seed: int):
    image = images(2, seed)
    assert np.array_equal(rank(np.roll(image, shift, axis=2)), np.roll(rank(image), shift, axis=2))


def test_an_image_is_described_alike_alone_and_among_others():
    image = images(5)
    assert np.array_equal(rank(image)[3:4], rank(image[3:4]))


@pytest.mark.parametrize("value", [0, 255])
def test_images_of_one_value_are_finite(value: int):
    assert torch.isfinite(describe(np.full((2, 6, 32, 3), value, np.uint8), 12, values="ranks")).all()


def test_no_images_have_no_ranks():
    assert rank(images(0)).shape == (0, 6, 32, 3)


def test_which_pixel_is_brighter_is_seen():
    image = images(1)
    assert not torch.allclose(describe(image, 12, values="ranks"), describe(255 - image, 12, values="ranks"), atol=0.01)


def test_scans_and_vectors_have_no_ranks():
    vectors = np.arange(6.0).reshape(2, 3)
    scans, edges = np.random.default_rng(0).random((3, 2, 64), np.float32), torch.tensor([0.0, 0.5, 1.0, 3.0])
    assert torch.equal(describe(vectors, 5, values="ranks"), describe(vectors, 5))
    assert torch.equal(describe(scans, 5, edges, values="ranks"), describe(scans, 5, edges))


def test_copies_under_other_light_are_smooth_and_the_same_for_a_seed():
    image = np.full((20, 12, 64, 3), 100, np.uint8)
    copy, again = (relight(image, torch.Generator().manual_seed(3)) for _ in range(2))
    assert np.array_equal(copy, again) and copy.dtype == np.uint8
    around = np.diff(copy.astype(int), axis=2, append=copy[:, :, :1].astype(int))
    assert np.abs(around).max() < 12 < np.ptp(copy, axis=(1, 2, 3)).min()


def test_slow_features_of_ranks_leave_out_what_light_changes(monkeypatch: pytest.MonkeyPatch):
    rng = np.random.default_rng(0)
    # two things vary along a drive: a pattern, and how brightly one side is lit
    along = np.linspace(0.0, 60.0, 400)
    pattern = (
        rng.uniform(20, 60, (3, 8, 32, 3))
        * (1.0 + np.sin(along[:, None, None, None, None] + np.arange(3)[:, None, None, None]))
    ).sum(axis=1)
    side = 1.0 + 0.7 * np.sin(0.7 * along)[:, None, None, None] * np.cos(2 * np.pi * np.arange(32) / 32)[:, None]
    observation = np.clip(pattern * side, 0, 255).astype(np.uint8)
    index = torch.arange(400).view(8, 50)
    segments = Segments(index, torch.arange(50.0).repeat(8, 1), torch.full((8,), 50), 0)
    chosen = FeatureSettings(values="ranks", principal=40, components=6)
    relit = relight(observation, torch.Generator().manual_seed(1))

    def change(weight: float) -> float:
        monkeypatch.setattr(features, "LIGHT_WEIGHT", weight)
        fitted, known = fit_features(observation, segments, chosen, torch.Generator().manual_seed(0))
        return float((fitted.apply(relit) - known).square().mean() / known.square().mean())

    assert change(5.0) < 0.7 * change(0.0)
