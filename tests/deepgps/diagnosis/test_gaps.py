"""Noise of wheels: the likelihood finds the random walk under the rounding, and its intervals hold."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deepgps.data.segments import read_segments
from deepgps.diagnosis.gaps import Fit, Gaps, find_stuck, fit_slip, fit_step_noise, measure_stuck, mend_stuck
from sim.recording.format import open_recording

STEP_M, SPEED = 0.08, 0.22


def drive(
    rng: np.random.Generator, slip: float = 0.0, noise: float = 0.0, tick_m: float = 5e-5, ratio: float = 1.0
) -> Gaps:
    """Gaps of 60 segments of 20 readings, by an independent model of the faults."""
    gaps, segments, first = [], [], 0.0
    for _ in range(60):
        true = np.full(20, STEP_M)
        wheels = (true * (1.0 + noise * rng.standard_normal(20)))[:, None] * [1.0, ratio]
        wheels = wheels + slip * np.sqrt(STEP_M) * rng.standard_normal((20, 2))
        read = np.floor((rng.uniform(0, tick_m, 2) + np.vstack([[0, 0], wheels.cumsum(axis=0)])) / tick_m) * tick_m
        gaps.append(np.vstack([np.diff(read, axis=0), [[-0.2, 0.2]]]))
        segments.append(np.append(np.ones(20, bool), False))
        first += 1.0
    distance, inside = np.concatenate(gaps), np.concatenate(segments)
    count = len(distance)
    return Gaps(distance, np.full(count, STEP_M / SPEED), np.ones(count, int), inside, (), np.ones(count, bool), tick_m)


def hold(fits: list[Fit], truth: float) -> float:
    """Share of the intervals that contain the truth."""
    return float(np.mean([fit.low <= truth <= fit.high for fit in fits]))


@pytest.mark.parametrize("drives", [8, pytest.param(40, marks=pytest.mark.slow)])
def test_intervals_of_slip_and_noise_hold(drives: int):
    slips = [fit_slip(drive(np.random.default_rng(seed), slip=0.01)) for seed in range(drives)]
    noises = [fit_step_noise(drive(np.random.default_rng(seed), noise=0.05), 0.0) for seed in range(drives)]
    assert hold(slips, 0.01) >= 0.85
    assert hold(noises, 0.05) >= 0.85
    assert np.mean([fit.high - fit.low for fit in slips]) < 0.001, "an interval is no use where it holds everything"
    assert np.mean([fit.high - fit.low for fit in noises]) < 0.006


def test_wheels_without_noise_show_none_however_long_a_tick_is():
    for tick_m in (5e-5, 1e-3, 1e-2):
        gaps = drive(np.random.default_rng(1), tick_m=tick_m)
        assert fit_slip(gaps).value < 0.1 * tick_m + 1e-4
        assert fit_step_noise(gaps, 0.0).value < 0.1 * tick_m / STEP_M + 1e-4


@pytest.mark.parametrize(
    ("ticks_a_gap", "seeds"),
    [(6.18, 1), *(pytest.param(ticks, 5, marks=pytest.mark.slow) for ticks in (3.09, 3.86, 6.18, 18.14, 19.3, 6.5))],
)
def test_rounding_that_hardly_changes_from_reading_to_reading_is_no_slip(ticks_a_gap: float, seeds: int):
    tick_m = STEP_M / ticks_a_gap
    for seed in range(seeds):
        gaps = drive(np.random.default_rng(seed), tick_m=tick_m)
        assert (fit_slip(gaps).value, fit_step_noise(gaps, 0.0).value) == (0.0, 0.0)
        slip = fit_slip(drive(np.random.default_rng(seed), slip=0.7 * tick_m, tick_m=tick_m))
        assert 0.3 * tick_m < slip.low < slip.value < 1.2 * tick_m


def test_slip_is_no_noise_of_gaps_and_noise_of_gaps_is_no_slip():
    slipping, noisy = (drive(np.random.default_rng(2), slip=0.02), drive(np.random.default_rng(2), noise=0.1))
    slip = fit_slip(slipping)
    assert fit_step_noise(slipping, slip.value).value < 0.03
    assert fit_slip(noisy).value < 1e-4, "both wheels share the noise of a gap"


def test_the_drift_is_the_ratio_of_the_readings():
    found = fit_slip(drive(np.random.default_rng(3), slip=0.005, ratio=1.02))
    assert abs(found.drift - 0.02 / 1.01) < 3.0 * found.drift_std < 0.003


def test_a_wheel_is_stuck_where_it_counts_nothing_while_the_other_one_travels():
    gaps = drive(np.random.default_rng(4))
    distance = gaps.distance.copy()
    distance[200:260, 1] = 0.0
    distance[400:402, 0] = 0.0  # two gaps are no stretch
    stretches = find_stuck(distance, gaps.inside, 1, gaps.tick_m)
    assert [(one.first, one.last) for one in stretches] == [(200, 259)]
    assert find_stuck(distance, gaps.inside, 0, gaps.tick_m) == []
    distance[440] = [0.0, 0.5]  # a turn about one wheel
    assert find_stuck(distance, gaps.inside & (np.arange(len(distance)) != 440), 0, gaps.tick_m) == []
    stuck, low, high = measure_stuck(Gaps(**{**vars(gaps), "distance": distance, "stuck": tuple(stretches)}))
    assert low <= 60 / len(distance) <= high
    assert stuck == pytest.approx(60 / len(distance))


def test_segments_too_short_for_a_steady_speed_tell_no_noise_of_gaps():
    for inner in (1, 2):
        rng, count = np.random.default_rng(0), 100 * (inner + 1)
        inside = np.arange(count) % (inner + 1) < inner
        driven = rng.uniform(0.1, 3.0, count)[:, None] * (1.0 + 0.1 * rng.standard_normal((count, 2)))
        gaps = Gaps(driven, driven.mean(axis=1) / SPEED, np.ones(count, int), inside, (), np.ones(count, bool), 5e-5)
        fit = fit_step_noise(gaps, 0.0)
        assert (fit.low, fit.high) == (0.0, 1.0)
    gaps = drive(np.random.default_rng(2))
    short = np.arange(len(gaps.inside)) > 19  # of the first segment, its last gap alone is left
    cut = replace(gaps, inside=gaps.inside & (short | (np.arange(len(short)) == 0)))
    assert fit_step_noise(cut, 0.0).value == 0.0


def test_a_stuck_wheel_is_replaced_by_the_other_one_as_if_it_had_counted(small_recording: Path):
    recording = open_recording(small_recording)
    assert mend_stuck(recording) is recording
    for wheel in (0, 1):
        ticks, reading = np.diff(recording.reading[:, 2:], axis=0), recording.reading.copy()
        ticks[20 : len(reading) // 2, wheel] = 0
        reading[1:, 2:] = reading[0, 2:] + np.cumsum(ticks, axis=0)
        stuck = replace(recording, reading=reading)
        right, wrong, mended = (read_segments(one).distance for one in (recording, stuck, mend_stuck(stuck)))
        assert (wrong - right).abs().max() > 0.1
        assert (mended - right).abs().max() < 0.003, "wheels on a straight segment differ by a tick or two"
