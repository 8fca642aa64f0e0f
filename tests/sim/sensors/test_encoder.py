import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from sim.sensors.encoder import (
    count_ticks,
    disturb_gaps,
    read_encoders,
    scale_wheels,
    slip_wheels,
    stick_wheel,
    ticks_to_distance,
)
from sim.settings import EncoderSettings

RADIUS = 0.033


def drive(gaps: int = 200, seed: int = 0) -> np.ndarray:
    """A drive with forward gaps and turns (R, 2) [rad]."""
    rng = np.random.default_rng(seed)
    return np.cumsum(rng.uniform(-1.0, 3.0, (gaps, 2)), axis=0)


@given(st.integers(4, 65536), st.integers(0, 10_000))
def test_quantised_distances_stay_within_their_bound(ticks_per_rev, seed):
    settings = EncoderSettings(ticks_per_rev=ticks_per_rev)
    angle = drive(50, seed)
    ticks, arrived = read_encoders(angle, RADIUS, settings, np.random.default_rng(0))
    measured = ticks_to_distance(ticks, RADIUS, ticks_per_rev)
    tick_m = 2 * np.pi * RADIUS / ticks_per_rev
    error = angle * RADIUS - measured
    assert arrived.all()
    assert error.min() >= -1e-9
    assert error.max() <= tick_m + 1e-9


def test_without_faults_only_quantisation_is_left():
    settings, angle, rng = EncoderSettings(ticks_per_rev=65536), drive(), np.random.default_rng(0)
    np.testing.assert_array_equal(read_encoders(angle, RADIUS, settings, rng)[0], count_ticks(angle, settings))
    np.testing.assert_allclose(scale_wheels(angle, 0.0, 0.0), angle)
    np.testing.assert_allclose(slip_wheels(angle, 0.0, RADIUS, rng), angle)
    np.testing.assert_allclose(disturb_gaps(angle, 0.0, rng), angle)


def test_a_radius_error_scales_the_way_of_its_wheel_only():
    angle = drive()
    distance = scale_wheels(angle, 0.1, 0.0)
    np.testing.assert_allclose(np.diff(distance, axis=0), np.diff(angle, axis=0) * [1.1, 1.0])


def test_gap_noise_has_the_paper_s_standard_deviation_on_each_gap():
    angle = np.cumsum(np.full((20_001, 2), 2.0), axis=0)
    ratio = np.diff(disturb_gaps(angle, 0.1, np.random.default_rng(1)), axis=0) / 2.0
    np.testing.assert_allclose(ratio[:, 0], ratio[:, 1])
    assert ratio.mean() == pytest.approx(1.0, abs=0.003)
    assert ratio.std() == pytest.approx(0.1, rel=0.03)


def test_slip_after_a_metre_does_not_depend_on_how_often_it_is_read():
    for gaps in (1, 25):
        rng = np.random.default_rng(2)
        angle = np.linspace(0.0, 1.0 / RADIUS, gaps + 1)[:, None].repeat(2, axis=1)
        ends = np.array([slip_wheels(angle, 0.02, RADIUS, rng)[-1] for _ in range(4000)]) * RADIUS
        assert ends.std() == pytest.approx(0.02, rel=0.05)


def test_faults_draw_from_streams_of_their_own():
    angle = drive()
    quiet = EncoderSettings(dropout=0.3)
    noisy = EncoderSettings(dropout=0.3, slip_per_m=0.01, step_noise=0.05)
    _, arrived = read_encoders(angle, RADIUS, quiet, np.random.default_rng(3))
    _, arrived_noisy = read_encoders(angle, RADIUS, noisy, np.random.default_rng(3))
    np.testing.assert_array_equal(arrived, arrived_noisy)
    assert 0.15 < 1 - arrived.mean() < 0.45


@given(st.floats(0.0, 0.9), st.integers(0, 10_000))
def test_one_wheel_sticks_in_one_stretch_and_the_other_never(stuck, seed):
    angle = drive(100, seed)
    gap = np.diff(stick_wheel(angle, stuck, np.random.default_rng(seed)), axis=0)
    still = np.isclose(gap, 0.0) & ~np.isclose(np.diff(angle, axis=0), 0.0)
    assert still.sum() == round(stuck * 99)
    assert not still.all(axis=1).any() and not (still.any(axis=0)).all()
    where = np.flatnonzero(still.any(axis=1))
    assert len(where) == 0 or where[-1] - where[0] + 1 == len(where)
    np.testing.assert_allclose(gap[~still], np.diff(angle, axis=0)[~still], atol=1e-9)


def test_sticking_shifts_no_other_fault():
    quiet = EncoderSettings(step_noise=0.1, slip_per_m=0.01, dropout=0.2)
    angle = drive()
    ticks, arrived = read_encoders(angle, RADIUS, quiet, np.random.default_rng(3))
    stuck, arrived_too = read_encoders(
        angle, RADIUS, quiet.model_copy(update={"stuck_fraction": 0.3}), np.random.default_rng(3)
    )
    np.testing.assert_array_equal(arrived, arrived_too)
    same = (stuck == ticks).all(axis=0)
    assert same.sum() == 1  # of one wheel


def test_same_seed_same_ticks_other_seed_others_and_settings_out_of_range_are_named():
    settings = EncoderSettings(step_noise=0.1, slip_per_m=0.01)
    angle = drive()
    first, again, other = (read_encoders(angle, RADIUS, settings, np.random.default_rng(seed))[0] for seed in (5, 5, 6))
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()
    with pytest.raises(ValidationError, match="ticks_per_rev"):
        EncoderSettings(ticks_per_rev=3)
