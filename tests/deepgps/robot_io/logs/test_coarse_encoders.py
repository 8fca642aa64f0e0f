"""Angles of coarse encoders: close to the true ones between counts, and every motion is found by them."""

from itertools import product
from typing import Any

import numpy as np
import pytest

from deepgps.robot_io.logs.segmentation import follow
from deepgps.robot_io.logs.wheels import Wheels, fill_counts
from tests.helpers.robot_log import LENGTHS_M, RADIUS_M, TRACK_M, TURNS, make_motion


def make_wheels(ticks: int, period_s: float, rounding: Any = np.floor) -> tuple[Wheels, np.ndarray]:
    """The wheels of the test drive with an encoder of so many ticks, and their true angles (n, 2) [rad]."""
    motion, tick = make_motion(), 2 * np.pi / ticks
    time_s = np.arange(0.0, motion.time_s[-1], period_s)
    true = np.column_stack([np.interp(time_s, motion.time_s, wheel) for wheel in motion.angle.T])
    none = np.zeros(len(time_s) - 1, bool)
    return Wheels(time_s, rounding(true / tick) * tick, none), true


def test_angles_between_counts_are_closer_to_the_true_ones():
    for ticks, period_s, rounding in product((8, 16, 32), (0.02, 0.05), (np.floor, np.rint)):
        wheels, true = make_wheels(ticks, period_s, rounding)
        filled = fill_counts(wheels, "wheels").angle
        before, after = (one - true - np.median(one - true, axis=0) for one in (wheels.angle, filled))
        assert np.abs(after).max() <= 2 * np.pi / ticks
        turning = np.abs(np.gradient(true, period_s, axis=0)) > 3.0  # rad/s
        assert np.std(after[turning]) < 0.6 * np.std(before[turning])


def test_fine_encoders_and_wheels_that_never_turn_stay_as_they_are():
    for ticks in (1024, 4096):
        wheels, _ = make_wheels(ticks, 0.05)
        np.testing.assert_array_equal(fill_counts(wheels, "wheels").angle, wheels.angle)
    still = Wheels(wheels.time_s, np.zeros_like(wheels.angle), wheels.broken)
    assert not fill_counts(still, "wheels").angle.any()


@pytest.mark.parametrize("ticks", [16, 32, 64])
def test_wheels_with_coarse_encoders_show_every_segment_and_turn(ticks: int):
    wheels, _ = make_wheels(ticks, 0.05)
    _, path, motions = follow(fill_counts(wheels, "wheels"), RADIUS_M, TRACK_M)
    motions = [one for one in motions if one.kind in {"straight", "turn"}]
    lengths = [path.measure(one) for one in motions if one.kind == "straight"]
    np.testing.assert_allclose(lengths, LENGTHS_M, atol=0.005 + 1.5 * 2 * np.pi / ticks * RADIUS_M)
    assert [one.kind for one in motions if path.measure(one) > 0.1 or one.kind == "turn"] == ["straight", "turn"] * len(
        TURNS
    ) + ["straight"]


def test_encoders_that_are_too_coarse_are_noted():
    wheels, _ = make_wheels(4, 0.05)
    (note,) = fill_counts(wheels, "wheels").notes
    assert note == "wheels: an encoder counts 4 ticks a turn of its wheel: turns in place may be missed"
