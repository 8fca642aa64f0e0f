"""Motions of the plane: a group, with covariances that sampling confirms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deepgps.tracking.motion import Motion, compose, invert, make_motion, move
from sim.errors import InputError

NUMBERS = st.floats(-3.0, 3.0)


@st.composite
def motions(draw: st.DrawFn) -> Motion:
    forward, left, turn = (draw(NUMBERS) for _ in range(3))
    root = np.array([[draw(NUMBERS) for _ in range(3)] for _ in range(3)])
    return Motion(np.array([forward, left]), turn, root @ root.T)


def test_numbers_that_no_robot_can_mean_are_refused():
    for name, value in (("forward_m", np.nan), ("turn_rad", np.inf), ("step_std_m", -0.1)):
        with pytest.raises(InputError, match=f"{name} {value}: must be finite"):
            make_motion(**{"forward_m": 0.1, name: value})


@given(motions())
def test_there_and_back_is_nothing(motion: Motion):
    assert np.allclose(compose(motion, invert(motion)).step, 0.0)
    again = invert(invert(motion))
    assert np.allclose(again.step, motion.step)
    assert np.allclose(again.covariance, motion.covariance)


@given(motions(), motions(), motions())
def test_composition_is_associative(one: Motion, two: Motion, three: Motion):
    left, right = compose(compose(one, two), three), compose(one, compose(two, three))
    assert np.allclose(left.step, right.step)
    assert np.allclose(left.covariance, right.covariance)


@given(motions(), motions())
def test_moving_twice_is_moving_by_both(one: Motion, two: Motion):
    mean, covariance = np.array([[1.0, 2.0, 0.5, 0.0]]), np.diag([0.1, 0.2, 0.3, 0.0])[None]
    twice = move(*move(mean, covariance, one), two)
    once = move(mean, covariance, compose(one, two))
    assert np.allclose(twice[0][:, :2], once[0][:, :2])
    assert np.allclose(twice[1][:, :3, :3], once[1][:, :3, :3], atol=0.02), "the scale changes on the way"


def test_covariances_are_those_of_samples():
    rng, motion = np.random.default_rng(0), make_motion(0.5, 0.1, 0.7, 0.01, 0.02)
    drawn = rng.standard_normal((20_000, 3)) * np.sqrt(np.diag(motion.covariance))
    back = np.array([[*one.step, one.turn] for one in (_disturb(motion, row) for row in drawn)])
    assert np.allclose(np.cov(back.T), invert(motion).covariance, atol=1e-5)


def _disturb(motion: Motion, error: np.ndarray) -> Motion:
    return invert(Motion(motion.step + error[:2], motion.turn + error[2], motion.covariance))
