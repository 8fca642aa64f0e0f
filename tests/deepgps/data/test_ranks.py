import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import rankdata

from deepgps.data.features import describe
from deepgps.data.ranks import rank_values


def images(count: int, seed: int = 0, values: int = 256) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, values, (count, 6, 32, 3), dtype=np.uint8)


def rank(image: np.ndarray) -> np.ndarray:
    return rank_values(torch.from_numpy(image.transpose(0, 1, 3, 2).copy())).numpy().transpose(0, 1, 3, 2)


@given(seed=st.integers(0, 1000), values=st.integers(1, 256))
@settings(max_examples=20, deadline=None)
def test_equal_values_share_the_mean_of_their_ranks(seed: int, values: int):
    image = images(2, seed, values)
    flat = image.reshape(2, -1, 3)
    expected = (rankdata(flat, axis=1) - 0.5) / flat.shape[1] * 255.0  # which scipy sorts
    assert np.allclose(rank(image).reshape(flat.shape), expected, atol=1e-3)


@given(seed=st.integers(0, 1000), data=st.data())
@settings(max_examples=20, deadline=None)
def test_no_monotone_change_of_brightness_alters_the_description(seed: int, data: st.DataObject):
    image = images(2, seed, 100)
    # a curve for each colour that keeps different values apart, as exposure, gamma and white balance do
    curves = [
        np.sort(np.random.default_rng(data.draw(st.integers(0, 1000))).choice(256, 100, replace=False))
        for _ in range(3)
    ]
    other = np.stack([curve[image[..., colour]] for colour, curve in enumerate(curves)], axis=-1).astype(np.uint8)
    assert torch.equal(describe(image, 12, values="ranks"), describe(other, 12, values="ranks"))


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


def test_which_pixel_is_brighter_is_seen():
    image = images(1)
    assert not torch.allclose(describe(image, 12, values="ranks"), describe(255 - image, 12, values="ranks"), atol=0.01)


def test_scans_and_vectors_have_no_ranks():
    vectors = np.arange(6.0).reshape(2, 3)
    scans, edges = np.random.default_rng(0).random((3, 2, 64), np.float32), torch.tensor([0.0, 0.5, 1.0, 3.0])
    assert torch.equal(describe(vectors, 5, values="ranks"), describe(vectors, 5))
    assert torch.equal(describe(scans, 5, edges, values="ranks"), describe(scans, 5, edges))
