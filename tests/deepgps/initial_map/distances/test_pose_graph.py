"""Segments as bars: exact maps from rough ones, and bars of noisy encoders that give way as far as these err."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from deepgps.data.segments import Segments, read_segments
from deepgps.initial_map.compass.factors import Factors
from deepgps.initial_map.distances.isomap import LoopClosures, find_loop_closures, map_by_paths
from deepgps.initial_map.distances.pose_graph import (
    MIN_NOISE,
    UnevenBars,
    add_factors,
    build_pose_graph,
    derive_apart,
    relax,
    relax_unevenly,
)
from sim.alignment import fit_alignment
from tests.helpers.toy import DescribedToy, make_toy

Mapped = tuple[np.ndarray, Segments, LoopClosures, np.ndarray]


@pytest.fixture(scope="module")
def mapped(toy: DescribedToy) -> Mapped:
    """A rough map of the toy, its segments, loop closures and true places."""
    closures = find_loop_closures(toy.features, toy.segments, (3,))[0]
    rough = map_by_paths(len(toy.features), toy.segments, closures, torch.Generator().manual_seed(0))
    return rough, toy.segments, closures, toy.place


def error(found: np.ndarray, place: np.ndarray) -> np.ndarray:
    return np.linalg.norm(fit_alignment(found, place, "E2").apply(found) - place, axis=1)


def along(found: np.ndarray, segments: Segments, row: int) -> np.ndarray:
    points = found[segments.index[row, : int(segments.count[row])].numpy()]
    return np.linalg.norm(points - points[0], axis=1)


def test_a_rough_map_becomes_exact_to_a_centimetre_and_a_right_one_stays(mapped: Mapped):
    rough, segments, closures, place = mapped
    found, _ = relax(rough, segments, closures)
    assert np.sqrt(np.mean(error(rough, place) ** 2)) > 0.05
    assert np.sqrt(np.mean(error(found, place) ** 2)) < 0.01
    for row in range(len(segments.count)):
        # A turning place lies on two bars, which meet only nearly.
        driven = segments.distance[row, : int(segments.count[row])].numpy()
        assert along(found, segments, row) == pytest.approx(driven, abs=0.005)
    right, cost = relax(place, segments, closures)
    assert error(right, place).max() < 0.06
    bent = place.copy()
    bent[place[:, 0] > place[:, 0].mean(), 1] *= -1.0
    assert cost < 0.9 * relax(bent, segments, closures)[1]
    more = np.concatenate([rough, [[7.0, 8.0]]])  # on no segment
    assert np.array_equal(relax(more, segments, closures)[0][-1], [7.0, 8.0])


def test_a_few_false_look_alikes_are_no_inliers(mapped: Mapped):
    rough, segments, (first, second, length), place = mapped
    rng = np.random.default_rng(1)
    i, j = rng.integers(len(place), size=(2, 40))
    false = np.concatenate([first, i, j]), np.concatenate([second, j, i]), np.concatenate([length, np.full(80, 0.02)])
    found, _ = relax(rough, segments, false)
    assert np.mean(np.linalg.norm(place[i] - place[j], axis=1) > 0.5) > 0.7
    assert np.sqrt(np.mean(error(found, place) ** 2)) < 0.01


def test_turning_the_rough_map_turns_the_exact_one(mapped: Mapped):
    rough, segments, closures, _ = mapped
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    (one, cost), (other, same) = (relax(places, segments, closures) for places in (rough, rough @ turn.T + [3.0, -2.0]))
    assert np.allclose(one @ turn.T + [3.0, -2.0], other, atol=1e-4)
    assert same == pytest.approx(cost, rel=1e-3)


def test_what_is_nowhere_stays_there_and_moves_nothing_else(mapped: Mapped):
    rough, segments, closures, _ = mapped
    row = 3
    lost = segments.index[row, : int(segments.count[row])].numpy()
    gone = np.isin(closures[0], lost) | np.isin(closures[1], lost)
    places = rough.copy()
    places[lost] = np.nan
    found, _ = relax(places, segments, closures)
    same, _ = relax(places, segments, (closures[0][~gone], closures[1][~gone], closures[2][~gone]))
    assert np.isnan(found[lost]).all() and np.isfinite(np.delete(found, lost, axis=0)).all()
    assert np.array_equal(found, same, equal_nan=True)


def test_one_segment_stays_straight_where_nothing_holds_it(tmp_path: Path):
    recording = make_toy(tmp_path / "toy", samples=30)
    segments = read_segments(recording).take(torch.tensor([0]))
    places = np.full((30, 2), np.nan)
    count = int(segments.count[0])
    places[segments.index[0, :count].numpy()] = np.outer(segments.distance[0, :count].numpy(), [0.6, 0.8])
    nothing = np.empty(0, int)
    found, cost = relax(places, segments, (nothing, nothing, np.empty(0)))
    assert np.allclose(found, places, equal_nan=True, atol=1e-6)
    assert cost == 0.0


Closed = tuple[np.ndarray, Segments, LoopClosures]


@pytest.fixture(scope="module")
def closed(toy: DescribedToy) -> Closed:
    """The toy's true places, segments and loop closures."""
    return toy.place, toy.segments, find_loop_closures(toy.features, toy.segments, (3,))[0]


def rms(found: np.ndarray, place: np.ndarray) -> float:
    return float(np.sqrt(((fit_alignment(found, place, "E2").apply(found) - place) ** 2).sum(axis=1).mean()))


def make_noisy(segments: Segments, noise: float, seed: int = 1) -> Segments:
    """The same segments by encoders that are wrong by this part of each gap."""
    gap = segments.distance.diff(dim=1, prepend=torch.zeros(len(segments.count), 1).to(segments.distance))
    wrong = torch.randn(gap.shape, generator=torch.Generator().manual_seed(seed))
    return replace(segments, distance=(gap * (1.0 + noise * wrong)).cumsum(dim=1))


def refine(places: np.ndarray, segments: Segments, closures: LoopClosures) -> tuple[np.ndarray, float]:
    found, _, noise = relax_unevenly(places, segments, closures, np.random.default_rng(0))
    return found, noise


@pytest.mark.parametrize("noise", [0.0, 0.2, *(pytest.param(noise, marks=pytest.mark.slow) for noise in (0.1, 0.3))])
def test_the_noise_is_found_and_the_map_is_better_than_that_of_rigid_bars(closed: Closed, noise: float):
    place, exact, closures = closed
    segments = make_noisy(exact, noise)
    rigid, _ = relax(place, segments, closures)
    found, corrected, estimated = relax_unevenly(rigid, segments, closures, np.random.default_rng(0))
    before, after = (measure_gaps(some.distance, exact) for some in (segments, corrected))
    if noise:
        assert estimated == pytest.approx(noise, rel=0.25)
        assert rms(found, place) < 0.8 * rms(rigid, place) and after < 0.8 * before
    else:
        assert estimated < 0.04
        assert rms(found, place) < rms(rigid, place) + 0.001 and after < 0.005
    last = (segments.count - 1)[:, None]
    ends = found[segments.index[:, 0].numpy()], found[segments.index.gather(1, last)[:, 0].numpy()]
    driven = segments.distance.gather(1, last).sum().item()
    assert np.linalg.norm(ends[1] - ends[0], axis=1).sum() == pytest.approx(driven, rel=0.005), "no length is lost"


def test_bars_of_a_wheel_that_stuck_are_mended_and_the_others_stay_rigid(closed: Closed):
    place, segments, closures = closed
    distance = segments.distance.clone()
    distance[::10] *= 0.5
    stuck = replace(segments, distance=distance)
    rigid, _ = relax(place, stuck, closures)
    found, estimated = refine(rigid, stuck, closures)
    assert estimated < 0.1
    assert rms(found, place) < 0.3 * rms(rigid, place)


def measure_gaps(distance: torch.Tensor, exact: Segments) -> float:
    """RMS error of the distances of readings from the middle of their segment [m]."""
    wrong = (distance - exact.distance) * exact.valid
    wrong = (wrong - (wrong.sum(dim=1) / exact.count)[:, None])[exact.valid]
    return float(wrong.square().mean().sqrt())


def test_turning_the_map_turns_the_refined_one(closed: Closed):
    place, segments, closures = closed
    segments = make_noisy(segments, 0.2)
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    one, other = (refine(places, segments, closures)[0] for places in (place, place @ turn.T + [3.0, -2.0]))
    assert np.allclose(one @ turn.T + [3.0, -2.0], other, atol=0.003)  # samples differ


def test_a_bar_whose_encoder_stood_still_or_that_is_nowhere_does_no_harm(closed: Closed):
    place, segments, closures = closed
    distance = segments.distance.clone()
    distance[5] = 0.0
    lost = segments.index[3, : int(segments.count[3])].numpy()
    places = place.copy()
    places[lost] = np.nan
    found, estimated = refine(places, replace(segments, distance=distance), closures)
    assert np.isnan(found[lost]).all() and np.isfinite(np.delete(found, lost, axis=0)).all()
    assert estimated >= MIN_NOISE


def make_factors(place: np.ndarray, variance: float) -> Factors:
    """Registrations of 200 observations on three others each, without any error."""
    rng = np.random.default_rng(3)
    one, others = rng.integers(len(place), size=200), rng.integers(len(place), size=(200, 3))
    weight = rng.dirichlet(np.ones(3), 200)
    offset = place[one] - np.einsum("mk,mkd->md", weight, place[others])
    return Factors(one, others, weight, offset, np.full(200, variance))


def test_registrations_mend_a_map_and_change_nothing_where_they_say_nothing(closed: Closed):
    place, exact, closures = closed
    segments = make_noisy(exact, 0.2)
    plain = refine(place, segments, closures)[0]
    start, rng = fit_alignment(plain, place, "E2").apply(plain), np.random.default_rng(0)
    mended = relax_unevenly(start, segments, closures, rng, make_factors(place, 1e-5)).places
    assert rms(mended, place) < 0.7 * rms(plain, place)
    vague, none = (
        relax_unevenly(start, segments, closures, np.random.default_rng(0), factors).places
        for factors in (make_factors(place, 1e8), None)
    )
    assert np.allclose(vague, none, atol=0.003)  # samples differ


def test_derivatives_agree_with_finite_differences(closed: Closed):
    place, segments, closures = closed
    graph = build_pose_graph(segments.take(torch.arange(12)), closures, np.ones(len(place), bool))
    graph = add_factors(graph, make_factors(place[graph.observation], 1e-4))
    bars = UnevenBars(graph, place)
    bars.unknown += 0.02 * np.random.default_rng(2).standard_normal(bars.unknown.shape)
    derived = derive_apart(graph, bars.derive(bars.place()[1])).toarray()

    def apart() -> np.ndarray:
        return (graph.mix @ bars.place()[0]).T.ravel()

    for column in range(bars.unknown.size):
        ends = []
        for step in (1e-6, -2e-6):
            bars.unknown.flat[column] += step
            ends.append(apart())
        bars.unknown.flat[column] += 1e-6
        assert np.allclose((ends[0] - ends[1]) / 2e-6, derived[:, column], atol=1e-6)
