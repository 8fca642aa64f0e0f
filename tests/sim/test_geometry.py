"""Angles: wrapping changes none of them by anything but whole turns."""

import numpy as np

from sim.geometry import wrap


def test_a_wrapped_angle_is_the_same_angle_and_within_half_a_turn() -> None:
    angle = np.random.default_rng(0).uniform(-50.0, 50.0, 1000)
    np.testing.assert_allclose(np.exp(1j * wrap(angle)), np.exp(1j * angle), atol=1e-12)
    assert np.abs(wrap(angle)).max() <= np.pi
    np.testing.assert_allclose(wrap(wrap(angle)), wrap(angle), atol=1e-12)
