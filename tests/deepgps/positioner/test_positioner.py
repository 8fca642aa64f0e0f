"""Positioners: saved and loaded they give the same; damage is named; trilateration is least squares."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import least_squares

from deepgps.config.learning import NetworkSettings, PixelValues
from deepgps.data.features import Features
from deepgps.learning.networks import make_network
from deepgps.positioner.appearance import AppearanceMap
from deepgps.positioner.kriging import Kernel
from deepgps.positioner.pose import find_poses
from deepgps.positioner.positioner import NeighbourPositioner, NetworkPositioner
from deepgps.positioner.registration import Calibration, Registration
from deepgps.positioner.stored_positioner import is_finished, load_positioner, read_training, save_positioner
from deepgps.positioner.without_features import LandmarkPositioner, find_seen, trilaterate
from sim.alignment import Alignment
from sim.errors import DamagedError, InputError
from sim.files.checksums import read_json, write_json

SHAPE = (4, 16, 3)


def spectral(values: PixelValues = "pixels") -> NetworkPositioner:
    generator = torch.Generator().manual_seed(0)
    numbers = 4 * 3 * 6 + 3 * 3 * 5 * 2
    mean, basis = torch.rand(numbers, generator=generator), torch.rand((numbers, 7), generator=generator)
    features = Features(SHAPE, 5, mean, basis, values=values)
    settings = NetworkSettings(width=16, layers=2)
    network = make_network(settings, 7, 3, generator).eval()
    axes = torch.linalg.qr(torch.randn((3, 2), generator=generator))[0]
    return NetworkPositioner(SHAPE, features, settings, network, torch.ones(3), axes)


def ranked() -> NetworkPositioner:
    return spectral("ranks")


def resnet() -> NetworkPositioner:
    settings = NetworkSettings(architecture="resnet", channels=4)
    network = make_network(settings, 0, 2, torch.Generator().manual_seed(0)).eval()
    return NetworkPositioner(SHAPE, None, settings, network, torch.zeros(2), torch.eye(2))


def neighbour() -> NeighbourPositioner:
    features = spectral().features
    assert features is not None
    places = torch.arange(12, dtype=torch.float64).reshape(6, 2)
    return NeighbourPositioner(features, features.apply(images(6)), places, 2)


def images(count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (count, *SHAPE), dtype=np.uint8)


@pytest.mark.parametrize("make", [spectral, ranked, resnet, neighbour])
def test_saved_and_loaded_it_gives_the_same_positions_and_trust(tmp_path: Path, make):
    positioner = trusting(make())
    assert not is_finished(tmp_path)
    save_positioner(tmp_path, positioner, {"steps": 3})
    assert is_finished(tmp_path) and read_training(tmp_path) == {"steps": 3}
    loaded = load_positioner(tmp_path)
    there, back = positioner(images(9, 1)), loaded(images(9, 1))
    assert there.shape == (9, 2) and there.dtype == np.float64
    assert np.array_equal(there, back)
    assert loaded(images(0)).shape == (0, 2)
    before, after = (find_poses(one, images(9, 1)) for one in (positioner, loaded))
    assert before.novelty is not None and before.novelty.shape == (9,) and (before.novelty > 0.0).all()
    for name in ("position", "novelty", "accepted", "radius_68", "radius_95"):
        assert np.array_equal(getattr(before, name), getattr(after, name))
    assert np.array_equal(before.position, there)
    assert find_poses(positioner, images(0)).accepted is not None


PLACES = np.random.default_rng(0).uniform(-1.0, 1.0, (30, 2))


def seen_from(places: np.ndarray) -> np.ndarray:
    """Images whose every pixel changes in proportion to the position: where each was taken is no matter of rounding."""
    generator = np.random.default_rng(2)
    mean, slopes = generator.uniform(60.0, 190.0, SHAPE), generator.uniform(-40.0, 40.0, (2, *SHAPE))
    return np.clip(mean + np.tensordot(places, slopes, 1), 0, 255).round().astype(np.uint8)


def trusting(positioner: NetworkPositioner | NeighbourPositioner) -> NetworkPositioner | NeighbourPositioner:
    """The positioner with some images on its map."""
    features = spectral().features
    assert features is not None
    calibration = Calibration(1.0, 0.0, 1.0, 1e9, 1.0, 4.0, (1.5, 2.4), 1.0, 1.0, 1.0)
    arrays = features.apply(seen_from(PLACES)).numpy(), PLACES, np.zeros(len(PLACES))
    return replace(
        positioner, appearance=AppearanceMap(features, Registration(*arrays, Kernel(1.0, 0.02), calibration))
    )


@pytest.mark.parametrize("make", [spectral, neighbour])
def test_positions_and_trust_depend_neither_on_the_heading_nor_on_the_frame(make):
    positioner, seen = trusting(make()), seen_from(0.8 * PLACES[:9])
    there = find_poses(positioner, seen)
    turned = find_poses(positioner, np.roll(seen, 5, axis=2))
    moved = there.align(Alignment(np.array([[0.6, 0.8], [0.8, -0.6]]), np.array([1.0, 2.0]), 1.0))
    assert np.allclose(there.position, turned.position, atol=1e-3)
    for name in ("novelty", "radius_68", "radius_95"):
        np.testing.assert_allclose(getattr(turned, name), getattr(there, name), rtol=1e-4)
        assert np.array_equal(getattr(there, name), getattr(moved, name))


def test_without_an_appearance_map_positions_are_given_without_trust():
    found = find_poses(spectral(), images(9, 1))
    assert np.array_equal(found.position, spectral()(images(9, 1)))
    assert found.novelty is found.accepted is found.radius_68 is found.radius_95 is None


def test_only_ranks_place_a_lighter_image_exactly_where_the_image_is():
    bright = images(3, 1) // 2
    light = bright + 100
    assert np.array_equal(ranked()(bright), ranked()(light))
    assert not np.allclose(spectral()(bright), spectral()(light), atol=1e-3)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
@pytest.mark.parametrize("make", [spectral, resnet])
def test_a_gpu_gives_the_same_positions(tmp_path: Path, make):
    save_positioner(tmp_path, make(), {})
    with torch.backends.cudnn.flags(enabled=True, allow_tf32=False):  # by TF32 a ResNet's differ by 0.14 mm
        cpu, gpu = (load_positioner(tmp_path, torch.device(name))(images(9)) for name in ("cpu", "cuda"))
    np.testing.assert_allclose(gpu, cpu, atol=1e-4)


def test_same_positioner_same_bytes(tmp_path: Path):
    for name in ("a", "b"):
        save_positioner(tmp_path / name, spectral(), {})
    for file in ("weights.safetensors", "positioner.json"):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()


def test_the_plane_is_taken_out_of_the_lifted_space_and_a_known_image_is_placed_where_it_was_taken():
    positioner = spectral()
    assert positioner.features is not None
    with torch.no_grad():
        lifted = positioner.network(positioner.features.apply(images(5)))
    expected = (lifted - positioner.centre).numpy() @ positioner.axes.numpy()
    assert np.allclose(positioner(images(5)), expected, rtol=1e-4)
    assert np.allclose(neighbour()(images(6)), neighbour().places, atol=1e-3)
    with pytest.raises(InputError, match=r"shape \(4, 8, 3\), but trained on shape \(4, 16, 3\)"):
        spectral()(images(2)[:, :, :8])


def test_a_broken_or_missing_file_is_named(tmp_path: Path):
    with pytest.raises(InputError, match=r"holds no trained method: it has no positioner\.json"):
        load_positioner(tmp_path)
    for text, message in (
        ("{", r"positioner\.json is damaged: it is not JSON"),
        ("[]", r"positioner\.json is damaged"),
        ('{"format": 9}', r"positioner\.json: format 9, but this version of deepgps reads format 2"),
        ('{"schema": 1}', r"positioner\.json: made by deepgps 0\.1\.0, format 1"),
        ('{"format": 2}', r"weights\.safetensors is damaged"),
    ):
        save_positioner(tmp_path, spectral(), {})
        (tmp_path / "positioner.json").write_text(text)
        with pytest.raises(InputError, match=message):
            load_positioner(tmp_path)
    save_positioner(tmp_path, spectral(), {})
    description = read_json(tmp_path / "positioner.json")
    description["network"]["width"] = 32
    write_json(tmp_path / "positioner.json", description)
    with pytest.raises(InputError, match=r"weights\.safetensors is damaged: .*size mismatch"):
        load_positioner(tmp_path)
    weights = tmp_path / "weights.safetensors"
    weights.write_bytes(weights.read_bytes()[:-100])
    with pytest.raises(InputError, match=r"weights\.safetensors is damaged.*train the method again"):
        load_positioner(tmp_path)
    weights.unlink()
    with pytest.raises(InputError, match=r"weights\.safetensors is missing"):
        load_positioner(tmp_path)


def test_a_flipped_bit_is_found(tmp_path: Path):
    for name in ("weights.safetensors", "training.json", "positioner.json"):
        for at in (100, 500):
            save_positioner(tmp_path, spectral(), {"steps": 3, "note": "x" * 1000})
            data = bytearray((tmp_path / name).read_bytes())
            data[at % len(data)] ^= 1
            (tmp_path / name).write_bytes(data)
            with pytest.raises(DamagedError, match=rf"{name} is damaged"):
                load_positioner(tmp_path)
                read_training(tmp_path)


RNG = np.random.default_rng(0)
LANDMARK = RNG.uniform(-1, 1, (12, 2))
POINT = RNG.uniform(-1, 1, (40, 2))


def distances(point: np.ndarray, landmark: np.ndarray = LANDMARK) -> np.ndarray:
    return np.linalg.norm(point[:, None] - landmark, axis=2)


@given(st.lists(st.integers(0, 11), min_size=3, max_size=12, unique=True), st.floats(-np.pi, np.pi))
def test_exact_distances_give_the_points_in_any_frame(chosen: list[int], turn: float):
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    landmark = LANDMARK[chosen] @ rotation.T + [3.0, -1.0]
    found = trilaterate(landmark, distances(POINT, LANDMARK[chosen]), np.inf)
    spread = np.linalg.svd(landmark - landmark.mean(axis=0), compute_uv=False)[-1]
    assert np.abs(found - (POINT @ rotation.T + [3.0, -1.0])).max() < 1e-5 / min(1.0, spread**2)


def test_noisy_distances_give_the_least_squares_that_scipy_finds():
    noisy = distances(POINT) + RNG.normal(0.0, 0.02, (len(POINT), len(LANDMARK)))
    found = trilaterate(LANDMARK, noisy, np.inf)
    for place, measured in zip(found, noisy, strict=True):
        solution = least_squares(
            lambda p, x=measured: np.linalg.norm(p - LANDMARK, axis=1) - x, place + 0.01, xtol=1e-12
        )
        assert np.abs(solution.x - place).max() < 1e-5


def test_landmarks_beyond_the_reach_do_not_count():
    reach_m = 0.8
    short = np.minimum(distances(POINT), reach_m).astype(np.float32)
    seen = find_seen(short, reach_m)
    assert np.array_equal(seen, short < np.float32(reach_m)) and not seen.all()
    enough = seen.sum(axis=1) >= 4
    assert np.abs(trilaterate(LANDMARK, short, reach_m) - POINT)[enough].max() < 1e-4


def test_too_few_landmarks_give_a_finite_point_that_fits_and_wrong_ones_do_not_make_it_run_away():
    for count in range(3):
        short = distances(POINT)
        short[:, count:] = 5.0
        found = trilaterate(LANDMARK, short, 5.0)
        assert np.isfinite(found).all()
        if count == 1:
            assert np.abs(distances(found)[:, 0] - short[:, 0]).max() < 1e-6
    rng = np.random.default_rng(1)
    for _ in range(20):
        wrong, measured = rng.uniform(-1, 1, (5, 2)), rng.uniform(0.1, 2.0, (200, 5))
        found = trilaterate(wrong, measured, np.inf)
        assert (np.linalg.norm(found - wrong.mean(axis=0), axis=1) <= measured.max(axis=1) + 1e-9).all()


@pytest.mark.parametrize("reach_m", [0.8, np.inf])
def test_it_is_saved_and_loaded_and_refuses_other_shapes(reach_m: float, tmp_path: Path):
    positioner = LandmarkPositioner(LANDMARK, reach_m)
    save_positioner(tmp_path, positioner, {})
    loaded = load_positioner(tmp_path)
    observed = np.minimum(distances(POINT), reach_m).astype(np.float32)
    assert np.array_equal(loaded(observed), positioner(observed))
    assert loaded(observed[:0]).shape == (0, 2)
    with pytest.raises(InputError, match=r"observations of shape \(5,\), but trained on shape \(12,\)"):
        loaded(observed[:, :5])
