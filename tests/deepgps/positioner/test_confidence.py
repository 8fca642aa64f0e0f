"""Laws of novelty, refusal and radii, on a made-up drive whose predictions have errors of a known size."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from deepgps.data.segments import HELD_OUT_SHARE, MIN_SEGMENTS, Segments, choose_held_out, find_held_out
from deepgps.positioner.confidence import GROWTH, LEVELS, Confidence, find_normal_radius, make_table
from deepgps.positioner.confidence_fit import (
    LARGE_ERROR_M,
    MAX_ERROR_PROBABILITY,
    MIN_ERRORS,
    REFUSED_SHARE,
    find_crossing,
    fit_quantile,
    fit_radii,
    interpolate,
    leave_segments_out,
    make_confidence,
    measure_bars,
    set_threshold,
)

SIDE_M, READINGS, SPACING_M = 4.0, 12, 0.08


def lift(place: np.ndarray) -> np.ndarray:
    """Features (B, 96) of places (B, 2) [m]: waves over the room; what is far away looks different."""
    rng = np.random.default_rng(7)
    wave, phase = rng.normal(0.0, 1.5, (2, 96)), rng.uniform(0.0, 2.0 * np.pi, 96)
    return np.cos(place @ wave + phase).astype(np.float32)


def drive(count: int, seed: int = 0) -> tuple[Segments, np.ndarray]:
    """Straight segments anywhere in the room, and the true place of each of their images (N, 2) [m]."""
    rng = np.random.default_rng(seed)
    start, angle = rng.uniform(0.0, SIDE_M - 1.0, (count, 2)), rng.uniform(0.0, np.pi / 2.0, count)
    way = SPACING_M * np.arange(READINGS)
    place = start[:, None] + way[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)[:, None]
    index = torch.arange(count * READINGS).reshape(count, READINGS)
    distance = torch.from_numpy(np.tile(way, (count, 1))).float()
    number = torch.full((count,), READINGS)
    return Segments(index, distance, number, 0, held_out=choose_held_out(count)), place.reshape(-1, 2)


def err(place: np.ndarray, std: np.ndarray | float, seed: int) -> np.ndarray:
    """Predictions of places (N, 2) [m] with normal errors of a standard deviation (N,) along each axis."""
    return place + np.random.default_rng(seed).normal(size=place.shape) * np.reshape(std, (-1, 1))


def make(segments: Segments, features: np.ndarray, positions: np.ndarray) -> Confidence:
    made = make_confidence(segments, features, positions)
    assert made is not None
    return made


@pytest.fixture(scope="module")
def table() -> Confidence:
    segments, place = drive(600)
    return make(segments, lift(place), err(place, 0.01, 1))


def test_the_radii_hold_the_true_place_as_often_as_they_say(table: Confidence) -> None:
    _, place = drive(400, seed=2)
    found = table.find(lift(place), err(place, 0.01, 3))
    error = np.linalg.norm(err(place, 0.01, 3) - place, axis=1)
    for radius, level in zip(found.radius.T, LEVELS, strict=True):
        assert abs((error <= radius).mean() - level) < 0.05


def test_the_share_refused_of_a_fresh_drive_is_as_chosen(table: Confidence) -> None:
    _, place = drive(400, seed=4)
    assert 0.3 * REFUSED_SHARE < (~table.find(lift(place), place).accepted).mean() < 2.0 * REFUSED_SHARE


def test_images_of_a_part_that_may_lie_elsewhere_are_refused() -> None:
    segments, place = drive(600)
    undecided = place[:, 0] < SIDE_M / 4.0
    made = make_confidence(segments, lift(place), place, undecided=undecided)
    assert made is not None
    _, fresh = drive(400, seed=2)
    accepted = made.find(lift(fresh), fresh).accepted
    inside, outside = fresh[:, 0] < SIDE_M / 4.0 - 0.5, fresh[:, 0] > SIDE_M / 4.0 + 0.2
    assert accepted[inside].mean() < 0.05
    assert accepted[outside].mean() > 0.9


def test_unknown_and_misplaced_images_are_refused_with_large_radii(table: Confidence) -> None:
    _, place = drive(50, seed=5)
    known = table.find(lift(place), place)
    elsewhere, misplaced = table.find(lift(place + 50.0), place), table.find(lift(place), place[::-1] + [0.0, 1.5])
    for found in (elsewhere, misplaced):
        assert (~found.accepted).mean() > 0.9
        assert np.median(found.radius[:, 0]) > 5.0 * np.median(known.radius[:, 0])
    assert elsewhere.radius.max() <= table.reach_m


def test_radii_grow_with_novelty_and_probability_and_by_the_variance_of_the_map(table: Confidence) -> None:
    radius = table._find_radius(np.linspace(0.0, 30.0, 200), np.full(200, 0.003))
    assert (np.diff(radius, axis=0) >= 0.0).all() and (radius[:, 1] >= radius[:, 0]).all()
    _, place = drive(50, seed=5)
    shaky = replace(table, map_std=np.full_like(table.map_std, 0.02))
    before, after = (one.find(lift(place), place).radius for one in (table, shaky))
    assert np.allclose(after**2 - before**2, (0.02 * find_normal_radius(np.array(LEVELS))) ** 2, rtol=1e-4)


def test_motion_packing_and_company_change_nothing(table: Confidence) -> None:
    _, place = drive(50, seed=5)
    motion, here = np.array([[0.6, 0.8], [0.8, -0.6]]), table.find(lift(place), place)
    moved = replace(table, place=(table.place @ motion.T + [3.0, -2.0]).astype(np.float32))
    there = moved.find(lift(place), place @ motion.T + [3.0, -2.0])
    assert np.allclose(here.novelty, there.novelty) and np.allclose(here.radius, there.radius)
    packed = Confidence.unpack(*table.pack()).find(lift(place), place)
    assert np.array_equal(here.novelty, packed.novelty) and np.array_equal(here.radius, packed.radius)
    alone = [table.find(lift(one[None]), one[None]) for one in place[:24]]
    assert np.allclose(here.novelty[:24], np.concatenate([one.novelty for one in alone]))
    assert table.find(lift(place[:0]), place[:0]).radius.shape == (0, 2)


def test_without_segments_held_out_radii_come_from_interpolation_and_are_not_too_small() -> None:
    segments, place = drive(MIN_SEGMENTS - 1)
    table = Confidence.unpack(*make(segments, lift(place), place).pack())
    assert not table.find(lift(place + 50.0), place).accepted.any()
    _, place = drive(400, seed=2)
    guessed = interpolate(table, lift(place))
    found, error = table.find(lift(place), guessed), np.linalg.norm(guessed - place, axis=1)
    for radius, level in zip(found.radius[found.accepted].T, LEVELS, strict=True):
        assert (error[found.accepted] <= radius).mean() > level - 0.05


def test_a_few_errors_blank_features_and_one_segment_tell_nothing(table: Confidence) -> None:
    unknown = replace(table, slope=np.full((2, 2), np.nan))
    few = fit_radii(unknown, np.linspace(0.1, 0.2, MIN_ERRORS - 1), np.ones(MIN_ERRORS - 1))
    assert np.isnan(few.find(lift(np.ones((3, 2))), np.ones((3, 2))).radius).all()
    segments, place = drive(4)
    assert make(segments, 0.0 * lift(place), place).threshold_m == 0.0
    segments, place = drive(1)
    assert make_confidence(segments, lift(place), place) is None


@pytest.mark.parametrize(("longer", "most"), [(2, 1.35), pytest.param(4, 1.6, marks=pytest.mark.slow)])
def test_the_table_grows_with_the_area_and_not_with_the_images(table: Confidence, longer: int, most: float) -> None:
    segments, place = drive(600 * longer)
    assert len(make(segments, lift(place), place).place) < most * len(table.place)


def test_short_drives_accept_only_images_whose_places_can_be_interpolated() -> None:
    segments, place = drive(12)
    left_out = leave_segments_out(segments, lift(place), place)
    assert left_out is not None
    usual = float(np.quantile(left_out.novelty, 1.0 - REFUSED_SHARE))
    table = make(segments, lift(place), place)
    assert table.threshold_m < 0.9 * usual
    _, place = drive(400, seed=2)
    guessed = interpolate(table, lift(place))
    error, found = np.linalg.norm(guessed - place, axis=1), table.find(lift(place), guessed)
    assert (error[found.accepted] > LARGE_ERROR_M).mean() < MAX_ERROR_PROBABILITY
    assert (error > LARGE_ERROR_M).mean() > 2.0 * MAX_ERROR_PROBABILITY


def test_long_drives_refuse_the_usual_share() -> None:
    segments, place = drive(300)
    left_out = leave_segments_out(segments, lift(place), place)
    assert left_out is not None
    table = set_threshold(make_table(lift(place), place, np.zeros(len(place)), np.arange(len(place))), left_out)
    assert table.threshold_m == table.usual_m == np.quantile(left_out.novelty, 1.0 - REFUSED_SHARE, method="higher")
    assert table.refused < REFUSED_SHARE


def test_the_threshold_does_not_change_under_a_rigid_motion() -> None:
    segments, place = drive(25)
    moved = place @ np.array([[0.6, 0.8], [0.8, -0.6]]) + [30.0, -20.0]
    here, there = (make(segments, lift(place), one).threshold_m for one in (place, moved))
    assert here == pytest.approx(there, rel=0.02)


def test_the_novelty_is_found_at_which_positions_are_far_off_with_a_probability() -> None:
    rng = np.random.default_rng(0)
    novelty = np.exp(rng.normal(0.0, 1.0, 20000))
    far = rng.uniform(size=20000) < 1.0 / (1.0 + (novelty / 3.0) ** -2.0)
    assert find_crossing(novelty, far, 0.5) == pytest.approx(3.0, rel=0.05)
    assert find_crossing(novelty, far, 0.1) == pytest.approx(1.0, rel=0.05)
    assert find_crossing(7.0 * novelty, far, 0.1) == pytest.approx(7.0, rel=0.05)


def test_novelty_that_tells_nothing_of_errors_refuses_nothing_or_all_by_the_share_of_errors() -> None:
    novelty = np.linspace(1.0, 2.0, 50)
    assert find_crossing(novelty, np.zeros(50, bool), 0.1) == np.inf
    assert find_crossing(novelty, novelty < 1.05, 0.1) == np.inf
    assert find_crossing(novelty, novelty < 1.5, 0.1) == 0.0


def test_bars_measure_the_error_whatever_their_place_heading_and_length() -> None:
    segments, place = drive(2000)
    held = find_held_out(segments, len(place)).numpy()
    assert abs(held.mean() - HELD_OUT_SHARE) < 0.005
    error = measure_bars(segments, 1.01 * err(place, 0.01, 1), held)
    assert np.array_equal(np.isfinite(error), held)
    assert np.nanmean(error**2) == pytest.approx(2.0 * 0.0101**2, rel=0.1)
    assert np.nanmax(measure_bars(segments, 1.02 * place @ [[0.0, 1.0], [-1.0, 0.0]] + 5.0, held)) < 1e-6


def test_bars_do_not_mistake_errors_of_the_encoders_or_a_curve_for_errors_of_the_network() -> None:
    segments, place = drive(2000)
    held = find_held_out(segments, len(place)).numpy()
    clean = np.nanmedian(measure_bars(segments, err(place, 0.01, 1), held))
    rng = np.random.default_rng(2)
    noisy = replace(segments, distance=segments.distance + torch.from_numpy(rng.normal(0.0, 0.05, (2000, 12))).float())
    assert np.nanmedian(measure_bars(noisy, err(place, 0.01, 1), held)) == pytest.approx(clean, rel=0.1)
    way = place.reshape(2000, READINGS, 2) - place.reshape(2000, READINGS, 2)[:, :1]
    left = np.stack([-way[..., 1], way[..., 0]], axis=-1) * np.linalg.norm(way, axis=-1, keepdims=True)
    bent = place + 0.05 / 2.0 * left.reshape(-1, 2)
    assert np.nanmax(measure_bars(segments, bent, held)) < 1e-5


def test_a_stretch_that_is_far_off_does_not_spoil_the_other_errors_of_its_bar() -> None:
    segments, place = drive(2000)
    held = find_held_out(segments, len(place)).numpy()
    seen = err(place, 0.01, 1)
    clean, wrong = measure_bars(segments, seen, held), np.zeros((2000, READINGS), bool)
    wrong[:, :2] = True  # the end of a bar, where it turns the line most
    wrong = wrong.ravel()
    error = measure_bars(segments, seen + 0.3 * wrong[:, None], held)
    assert np.median(error[held & wrong]) == pytest.approx(0.3 * np.sqrt(2.0), rel=0.25)
    assert np.median(error[held & ~wrong]) < 1.5 * np.median(clean[held & ~wrong])


def test_quantiles_are_found_where_errors_grow_with_novelty() -> None:
    rng = np.random.default_rng(0)
    novelty = rng.uniform(1.0, 4.0, 3000)
    std = 0.004 + 0.001 * novelty**GROWTH
    error = np.linalg.norm(rng.normal(size=(3000, 2)), axis=1) * std
    for level in LEVELS:
        a, b = fit_quantile(novelty, error, level)
        expected = find_normal_radius(np.array(level))
        assert a / expected == pytest.approx(0.004, abs=0.0015)
        assert b / expected == pytest.approx(0.001, rel=0.1)
        assert (error <= a + b * novelty**GROWTH).mean() == pytest.approx(level, abs=0.002)
