"""Segments as bars: what the readings between the ends of a bar are expected to err."""

from dataclasses import replace

import numpy as np
import torch

from deepgps.data.segments import Segments
from deepgps.data.turns import CompassTurns
from deepgps.initial_map.compass.bars import Bars, lay_out

READINGS, SPACING_M, DRAWS = 9, 0.08, 40_000
NO_TURNS = CompassTurns(np.empty(0), np.empty(0), np.empty((0, 2)), np.empty(0))


def lay_bar(noise: float, tick_m: float) -> Bars:
    """One segment whose gaps are wrong by the fraction ``noise`` and whose way is known in ticks."""
    way = SPACING_M * np.arange(READINGS)
    variance = (noise * SPACING_M) ** 2 * np.arange(READINGS)
    tables = (torch.arange(READINGS)[None], torch.from_numpy(way)[None], torch.tensor([READINGS]), 0)
    rounding_m2 = tick_m**2 / 6.0
    segments = Segments(*tables, variance=torch.from_numpy(variance)[None], rounding_m2=rounding_m2)
    bars = lay_out(segments, NO_TURNS, curvature=0.0)
    assert len(bars.unknown) == 1
    return bars


def measure_unevenness(noise: float, tick_m: float) -> np.ndarray:
    """Mean squared error (READINGS,) [m^2] of many such measurements, each scaled so that its ends are right."""
    rng, way = np.random.default_rng(0), SPACING_M * np.arange(READINGS)
    gap = SPACING_M * (1.0 + noise * rng.standard_normal((DRAWS, READINGS - 1)))
    measured = np.concatenate([np.zeros((DRAWS, 1)), gap.cumsum(axis=1)], axis=1)
    if tick_m:
        measured += rng.uniform(0.0, tick_m, measured.shape)
    begin, end = measured[:, :1], measured[:, -1:]
    scaled = (measured - begin) * way[-1] / (end - begin)
    return np.square(scaled - way).mean(axis=0)


def test_readings_of_a_bar_err_as_expected():
    for noise, tick_m in ((0.05, 0.0), (0.0, 0.01), (0.05, 0.01)):
        expected = lay_bar(noise, tick_m).uneven_m2
        assert np.allclose(expected, measure_unevenness(noise, tick_m), rtol=0.03, atol=1e-12)


def test_readings_of_a_bar_with_exact_encoders_do_not_err():
    assert not lay_bar(0.0, 0.0).uneven_m2.any()


def test_coarse_ticks_may_put_readings_at_the_ends_of_a_bar():
    tables = torch.arange(4)[None], torch.tensor([[0.0, 0.0, 0.2, 0.2]]), torch.tensor([4]), 0
    segments = Segments(*tables, variance=torch.zeros(1, 4), rounding_m2=0.01)
    uneven_m2 = lay_out(segments, NO_TURNS, curvature=0.0).uneven_m2
    assert np.allclose(uneven_m2, [0.0, 0.01, 0.01, 0.0])
    still = lay_out(replace(segments, distance=torch.zeros(1, 4)), NO_TURNS, curvature=0.0)
    assert np.isfinite(still.uneven_m2).all()


def test_samples_lie_along_the_bar_and_have_the_expected_variance():
    bars = lay_bar(0.05, 0.01)
    bars.unknown[:, 2] = np.pi / 6.0
    drawn = bars.draw_unevenness(DRAWS, np.random.default_rng(0))
    along = np.cos(np.pi / 6.0) * drawn[:, 0] + np.sin(np.pi / 6.0) * drawn[:, 1]
    assert np.allclose(along**2, (drawn**2).sum(axis=1))
    assert np.allclose((along**2).mean(axis=1), bars.uneven_m2, rtol=0.03, atol=1e-12)
