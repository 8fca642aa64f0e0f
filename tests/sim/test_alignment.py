import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deepgps.evaluation.stored_alignment import read_alignment
from sim.alignment import fit_alignment, fit_robust_alignment
from sim.errors import InputError
from sim.geometry import wrap

points = np.random.default_rng(0).normal(size=(60, 2)) * [2.0, 1.0]


def rotation(angle: float) -> np.ndarray:
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, -sin], [sin, cos]])


@given(st.floats(-3.2, 3.2), st.floats(-5.0, 5.0), st.floats(-5.0, 5.0), st.booleans())
def test_a_rigid_motion_is_undone(angle, x, y, mirrored):
    moved = (points * [1.0, -1.0] if mirrored else points) @ rotation(angle).T + [x, y]
    alignment = fit_alignment(moved, points, "E2")
    np.testing.assert_allclose(alignment.apply(moved), points, atol=1e-9)
    assert alignment.scale == pytest.approx(1.0)
    assert np.linalg.det(alignment.rotation) == pytest.approx(-1.0 if mirrored else 1.0)


def test_se2_refuses_a_reflection():
    mirrored = points * [1.0, -1.0]
    alignment = fit_alignment(mirrored, points, "SE2")
    assert np.linalg.det(alignment.rotation) == pytest.approx(1.0)
    assert np.abs(alignment.apply(mirrored) - points).max() > 0.5


def test_scale_is_told_and_not_applied():
    alignment = fit_alignment(points / 1.25, points, "E2")
    assert alignment.scale == pytest.approx(1.25)
    assert np.linalg.norm(alignment.apply(points / 1.25) - points, axis=1).max() > 0.1


def test_agrees_with_an_independent_implementation():
    umeyama = pytest.importorskip("evo.core.geometry").umeyama_alignment
    noisy = points @ rotation(0.7).T + [1.0, 2.0] + np.random.default_rng(1).normal(0.0, 0.05, points.shape)
    expected_rotation, expected_translation, _ = umeyama(noisy.T, points.T, False)
    alignment = fit_alignment(noisy, points, "SE2")
    np.testing.assert_allclose(alignment.rotation, expected_rotation, atol=1e-12)
    np.testing.assert_allclose(alignment.translation, expected_translation, atol=1e-12)


@given(st.floats(-3.2, 3.2), st.floats(-3.2, 3.2), st.booleans())
def test_a_yaw_is_turned_as_the_step_between_two_points(angle, yaw, mirrored):
    moved = (points * [1.0, -1.0] if mirrored else points) @ rotation(angle).T
    alignment = fit_alignment(moved, points, "E2")
    step = np.array([np.cos(yaw), np.sin(yaw)])
    turned = float(alignment.turn(np.array(yaw)))
    np.testing.assert_allclose(
        [np.cos(turned), np.sin(turned)], alignment.apply(step) - alignment.apply(np.zeros(2)), atol=1e-9
    )


@given(st.floats(-3.2, 3.2), st.booleans())
def test_a_robust_alignment_undoes_a_rigid_motion_and_turns_with_it(angle, mirrored):
    noisy = points + np.random.default_rng(2).standard_cauchy(points.shape) / 50
    moved = (noisy * [1.0, -1.0] if mirrored else noisy) @ rotation(angle).T + [3.0, -1.0]
    expected = fit_robust_alignment(noisy, points, "E2").apply(noisy)
    np.testing.assert_allclose(fit_robust_alignment(moved, points, "E2").apply(moved), expected, atol=1e-9)


def test_what_is_metres_off_does_not_move_the_rest():
    random = np.random.default_rng(3)
    many = random.uniform(-4.0, 4.0, (4000, 2))
    placed = many + random.normal(0.0, 0.01, many.shape)
    placed[:200] += [6.0, 2.0]
    rest = slice(200, None)
    pulled, kept = (
        fit(placed, many, "SE2").apply(placed)[rest] - many[rest] for fit in (fit_alignment, fit_robust_alignment)
    )
    assert np.linalg.norm(pulled, axis=1).mean() > 0.1
    assert np.linalg.norm(kept.mean(axis=0)) < 0.001


def test_a_robust_alignment_of_normal_errors_is_least_squares():
    random = np.random.default_rng(4)
    many = random.uniform(-2.0, 2.0, (4000, 2))
    placed = many + random.normal(0.0, 0.02, many.shape)
    one, other = (fit(placed, many, "SE2").apply(placed) for fit in (fit_alignment, fit_robust_alignment))
    assert np.abs(one - other).max() < 1e-4


def test_the_command_that_places_a_map_can_be_copied_into_a_shell(tmp_path: Path) -> None:
    run = tmp_path / "my run"
    with pytest.raises(InputError, match=re.escape(f"deepgps evaluate '{run}/scenario.yaml' --out '{run}' writes it")):
        read_alignment(run / "deepgps")


def test_a_wrapped_angle_is_the_same_angle_and_within_half_a_turn() -> None:
    angle = np.random.default_rng(0).uniform(-50.0, 50.0, 1000)
    np.testing.assert_allclose(np.exp(1j * wrap(angle)), np.exp(1j * angle), atol=1e-12)
    assert np.abs(wrap(angle)).max() <= np.pi
    np.testing.assert_allclose(wrap(wrap(angle)), wrap(angle), atol=1e-12)
