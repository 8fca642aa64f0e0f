from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import least_squares

from deepgps.positioner.stored_positioner import load_positioner, save_positioner
from deepgps.positioner.without_features import LandmarkPositioner, find_seen, trilaterate
from sim.errors import InputError

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


@pytest.mark.parametrize("count", [0, 1, 2])
def test_too_few_landmarks_give_a_finite_point_that_fits(count: int):
    short = distances(POINT)
    short[:, count:] = 5.0
    found = trilaterate(LANDMARK, short, 5.0)
    assert np.isfinite(found).all()
    if count == 1:
        assert np.abs(distances(found)[:, 0] - short[:, 0]).max() < 1e-6


def test_wrong_landmarks_do_not_make_points_run_away():
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
