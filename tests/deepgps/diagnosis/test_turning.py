"""Turns by the camera against turns by the wheels: a few wrong angles change neither the slope nor its error."""

import numpy as np

from deepgps.data.turns import PUSHED_TURN_STD_RAD, WHEEL_TURN_STD_RAD, trust_wheels
from deepgps.diagnosis.turning import fit_slope
from sim.recording.turns import KINDS, Turns


def test_the_slope_and_its_error_bear_wrong_angles():
    for wrong in (0, 1, 4, 10):
        errors, said = [], []
        for seed in range(100):
            rng = np.random.default_rng(seed)
            x, std = rng.uniform(-3.0, 3.0, 100), np.full(100, 0.003)
            y = 1.02 * x + std * rng.standard_normal(100)
            y[:wrong] += rng.uniform(0.3, 0.8, wrong)
            found = fit_slope(x, y, std)
            errors.append(found.value - 1.02)
            said.append(found.std)
        assert np.sqrt(np.mean(np.square(errors))) < 4e-4
        assert 0.7 < np.sqrt(np.mean(np.square(errors))) / np.mean(said) < 1.6


def test_errors_larger_than_expected_widen_the_interval():
    rng = np.random.default_rng(0)
    x = rng.uniform(-3.0, 3.0, 400)
    slopes = [fit_slope(x, x + 0.003 * size * rng.standard_normal(400), np.full(400, 0.003)) for size in (1.0, 5.0)]
    assert 4.0 < slopes[1].std / slopes[0].std < 6.0


def test_wheels_are_trusted_less_where_the_robot_was_pushed():
    kinds = np.array([KINDS.index("in_place"), KINDS.index("backed_off"), KINDS.index("relocated")])
    none = np.zeros(3, int)
    assert trust_wheels(Turns(none, none, none, kinds)).tolist() == [
        WHEEL_TURN_STD_RAD,
        PUSHED_TURN_STD_RAD,
        PUSHED_TURN_STD_RAD,
    ]
