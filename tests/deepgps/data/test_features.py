"""Features of images, scans and vectors: what turns, light and ranks change, and what is kept of it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import rankdata

from deepgps.config.learning import FeatureSettings, LearnSettings
from deepgps.data import features
from deepgps.data.features import (
    describe,
    draw_rings,
    find_edges,
    fit_features,
    normalise,
    rank_values,
    relight,
    solve_generalised,
)
from deepgps.data.segments import Segments, find_held_out, read_segments
from deepgps.learning import training_data
from deepgps.learning.training_data import cached_features, prepare
from sim.errors import InputError
from tests.helpers.toy import make_toy


def images(count: int, seed: int = 0, values: int = 256) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, values, (count, 6, 32, 3), dtype=np.uint8)


@given(shift=st.integers(-40, 40), seed=st.integers(0, 1000))
@settings(max_examples=40, deadline=None)
def test_turning_changes_nothing(shift: int, seed: int):
    image = images(2, seed)
    there = describe(image, 12)
    turned = describe(np.roll(image, shift, axis=2), 12)
    assert torch.allclose(there, turned, atol=2e-4 * float(there.abs().max()))


@pytest.mark.parametrize("frequencies", [1, 12, 16, 40])
def test_it_is_made_of_plain_fourier_coefficients(frequencies: int):
    image = images(3)
    spectrum = np.fft.rfft(image.transpose(0, 1, 3, 2) / 255.0, norm="forward")[..., : frequencies + 1]
    product = spectrum[:, :-1, :, 1:] * spectrum[:, 1:, :, 1:].conj()
    product /= (np.abs(product) + 1e-8) ** 0.75
    parts = np.sqrt(np.abs(spectrum)), np.stack([product.real, product.imag], axis=-1)
    expected = np.concatenate([part.reshape(3, -1) for part in parts], axis=1)
    assert np.abs(describe(image, frequencies).numpy() - expected).max() < 1e-4


def test_what_is_no_turn_is_seen():
    image = images(1)
    broken = image.copy()
    broken[:, 2] = np.roll(image[:, 2], 5, axis=1)
    for other in (broken, image[:, :, ::-1].copy()):
        assert not torch.allclose(describe(image, 12), describe(other, 12), atol=1e-2)
    assert not torch.allclose(describe(image, 12, values="ranks"), describe(255 - image, 12, values="ranks"), atol=0.01)


def test_observations_without_contrast_or_of_other_kinds_are_described_and_other_shapes_refused():
    for value in (0, 255):
        for values in ("pixels", "ranks"):
            assert torch.isfinite(describe(np.full((2, 6, 32, 3), value, np.uint8), 12, values=values)).all()
    vectors = np.arange(6.0).reshape(2, 3)
    assert describe(vectors, 5).tolist() == describe(vectors, 5, values="ranks").tolist() == vectors.tolist()
    assert torch.equal(describe(scans(3), 5, EDGES, values="ranks"), describe(scans(3), 5, EDGES))
    assert rank(images(0)).shape == (0, 6, 32, 3)
    with pytest.raises(InputError, match=r"not \(2, 3, 4\)"):
        describe(np.zeros((2, 3, 4)), 5)


def test_fitted_features_are_those_applied(tmp_path: Path):
    recording = make_toy(tmp_path / "toy", samples=300)
    generator = torch.Generator().manual_seed(0)
    fitted, features = fit_features(
        recording.observation, read_segments(recording), FeatureSettings(components=8), generator
    )
    assert torch.allclose(fitted.apply(recording.observation), features, atol=1e-4)
    assert float(features.square().mean()) == pytest.approx(1.0, rel=1e-4)
    assert fitted.apply(recording.observation[:0]).shape == (0, 8)
    with pytest.raises(InputError, match=r"observations of shape \(5,\), but trained on shape \(12,\)"):
        fitted.apply(np.zeros((1, 5)))


def test_slow_features_leave_noise_out(tmp_path: Path):
    recording = make_toy(tmp_path / "toy", samples=600)
    signal = np.asarray(recording.observation)
    rng = np.random.default_rng(0)
    noise = rng.normal(0.0, 3.0, signal.shape)
    both = np.concatenate([signal, noise], axis=1) @ np.linalg.qr(rng.normal(size=(24, 24)))[0]
    segments, settings = read_segments(recording), FeatureSettings(components=4)
    _, features = fit_features(both, segments, settings, torch.Generator().manual_seed(0))

    def explained(by: np.ndarray) -> float:
        design = np.column_stack([np.ones(len(by)), by])
        left = features.numpy() - design @ np.linalg.lstsq(design, features.numpy(), rcond=None)[0]
        return 1.0 - float(np.sum(left**2) / np.sum((features.numpy() - features.numpy().mean(axis=0)) ** 2))

    assert explained(signal) > 0.95
    assert explained(noise) < 0.1


def test_images_held_out_do_not_change_the_projection(tmp_path: Path):
    recording = make_toy(tmp_path / "toy", samples=1500)
    segments = read_segments(recording)
    observation = np.array(recording.observation)
    held = find_held_out(segments, len(observation)).numpy()
    assert held.any()
    settings = FeatureSettings(components=8)
    _, features = fit_features(observation, segments, settings, torch.Generator().manual_seed(0))
    observation[held] = 0.0
    _, changed = fit_features(observation, segments, settings, torch.Generator().manual_seed(0))
    assert changed[~held].equal(features[~held])
    assert not changed[held].equal(features[held])


def test_features_are_taken_from_the_cache_of_the_same_key(tmp_path: Path):
    recording = make_toy(tmp_path / "toy", samples=300)
    segments = read_segments(recording)

    def make(key: str, seed: int):
        generator = torch.Generator().manual_seed(seed)
        settings = FeatureSettings(components=4, principal=4)
        return cached_features(tmp_path, key, recording.observation, segments, settings, generator)

    first, same, other = make("a", 0), make("a", 1), make("b", 1)
    assert torch.equal(first[1], same[1]) and torch.equal(first[0].basis, same[0].basis)
    assert torch.equal(first[0].apply(recording.observation), same[0].apply(recording.observation))
    assert not torch.equal(first[1], other[1])


def test_vectors_are_normalised_and_nothing_else(tmp_path: Path):
    recording = make_toy(tmp_path / "toy", samples=300)
    vectors = np.asarray(recording.observation, float)
    fitted, features = normalise(recording.observation)
    assert np.allclose(features.mean(dim=0), 0.0, atol=1e-5)
    assert float(features.square().mean()) == pytest.approx(1.0, rel=1e-4)
    apart = np.linalg.norm(vectors[1:] - vectors[:-1], axis=1)
    ratio = (features[1:] - features[:-1]).norm(dim=1).numpy() / apart
    assert np.allclose(ratio, ratio[0], rtol=1e-3)
    assert torch.allclose(fitted.apply(recording.observation), features, atol=1e-4)
    material = prepare(recording, LearnSettings(), 0, tmp_path / "run")
    assert torch.equal(material.features, features) and not (tmp_path / "run").exists()


def test_generalised_eigenvectors_solve_their_equation():
    rng = np.random.default_rng(0)
    a, b = (torch.from_numpy(m @ m.T) for m in rng.normal(size=(2, 5, 5)))
    w, v = solve_generalised(a, b)
    assert torch.allclose(a @ v, b @ v * w)
    assert torch.allclose(v.T @ b @ v, torch.eye(5, dtype=torch.float64), atol=1e-8)


def scans(count: int, rays: int = 64, seed: int = 0) -> np.ndarray:
    """Scans (count, 2, rays) of walls with jumps."""
    rng = np.random.default_rng(seed)
    wall = rng.uniform(0.2, 3.0, (count, 2, 8)).repeat(rays // 8, axis=2)
    return (wall + rng.uniform(0, 0.1, wall.shape)).astype(np.float32)


EDGES = torch.tensor([0.0, 0.5, 0.8, 1.4, 3.1])


@given(shift=st.integers(-70, 70), seed=st.integers(0, 1000), heading=st.integers(0, 1))
@settings(max_examples=40, deadline=None)
def test_turning_by_whole_rays_changes_nothing(shift: int, seed: int, heading: int):
    scan = scans(2, seed=seed)
    there = describe(scan, 12, EDGES, heading)
    turned = describe(np.roll(scan, shift, axis=2), 12, EDGES, heading)
    # A ring that is all full or all empty has coefficients of rounding errors alone, whose phases weigh up to this.
    assert torch.allclose(there, turned, atol=1e-2 * float(there.abs().max()))
    assert not torch.allclose(there, describe(scan, 12, EDGES, 1 - heading), atol=1e-2)
    assert not torch.allclose(there, describe(scan[:, :, ::-1].copy(), 12, EDGES, heading), atol=1e-2)


def test_rings_lose_nothing_of_a_scan():
    scan = torch.from_numpy(scans(3)[:, 0])
    rings = draw_rings(scan, EDGES)
    assert rings.shape == (3, 4, 64)
    assert torch.allclose((rings / 255 * EDGES.diff()[:, None]).sum(dim=1), scan, atol=1e-5)


def test_rings_are_filled_equally_often_even_where_many_rays_end_at_the_reach():
    observation = scans(500)
    edges = find_edges(observation, 8)
    assert edges is not None
    inside = np.histogram(observation[:, 0], edges.numpy())[0]
    assert inside.min() > 0.9 * inside.max()
    blunt = find_edges(np.minimum(observation, 0.5), 8)
    assert blunt is not None and (blunt.diff() > 0).all()
    assert find_edges(images(3), 8) is None


def test_a_heading_is_drawn_among_those_kept(tmp_path: Path):
    toy = make_toy(tmp_path / "toy", samples=300)
    count = len(toy.observation)
    manifest = toy.manifest.model_copy(update={"sensors": {"lidar": "scan"}})
    recording = replace(toy, observation=scans(count), manifest=manifest)
    chosen = LearnSettings.model_validate({"features": {"components": 8, "principal": 32, "noise": 0}})
    material = prepare(recording, chosen, 0, tmp_path / "run")
    assert material.inputs.table.shape == (count, 2, 8)
    assert torch.equal(material.inputs.take(torch.arange(count)), material.features)
    other = material.projection.apply(recording.observation, 1)
    drawn = material.inputs.take(torch.arange(count), torch.Generator().manual_seed(0))
    first = (drawn == material.features).all(dim=1)
    assert 0.35 < float(first.float().mean()) < 0.65
    assert torch.equal(drawn[~first], other[~first])


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


def test_features_do_not_depend_on_the_number_of_cores(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    toy = make_toy(tmp_path / "toy", samples=300)
    images = np.random.default_rng(0).integers(0, 256, (len(toy.observation), 4, 16, 3), np.uint8)
    manifest = toy.manifest.model_copy(update={"sensors": {"fisheye": "polar_image"}})
    recording = replace(toy, observation=images, manifest=manifest)
    threads = []
    plain = training_data.cached_features

    def count_threads(*arguments):
        threads.append(torch.get_num_threads())
        return plain(*arguments)

    monkeypatch.setattr(training_data, "cached_features", count_threads)
    before = torch.get_num_threads()
    training_data.prepare(recording, LearnSettings(), 0, tmp_path)
    assert threads == [LearnSettings().train.threads]
    assert torch.get_num_threads() == before
