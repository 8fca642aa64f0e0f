"""Peaks around a circle: where they are, between the samples, and however the circle is turned."""

import numpy as np
import pytest

from sim.geometry import wrap
from sim.sensors.compass.compass import find_highest

SAMPLES = 64


def waves(angle: np.ndarray) -> np.ndarray:
    """A curve with two peaks, the higher one at zero."""
    return np.cos(2.0 * angle) + 0.3 * np.cos(angle)


@pytest.mark.parametrize("turned", [0.0, 0.03, 1.0, np.pi, 6.27])
def test_peaks_turn_with_the_circle(turned: float):
    around = 2.0 * np.pi * np.arange(SAMPLES) / SAMPLES
    angle, height = find_highest(waves(around - turned)[None], 3)
    assert np.abs(wrap(angle[0, :2] - turned - [0.0, np.pi])).max() < 1e-3
    assert height[0, :2] == pytest.approx([1.3, 0.7], abs=0.01)
    assert height[0, 2] == -np.inf, "there are two only"


def test_a_flat_curve_has_no_peak():
    assert (find_highest(np.ones((2, SAMPLES)), 1)[1] == -np.inf).all()
