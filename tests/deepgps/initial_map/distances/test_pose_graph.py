from pathlib import Path

import numpy as np
import pytest
import torch

from deepgps.data.segments import Segments, read_segments
from deepgps.initial_map.distances.isomap import LoopClosures, find_loop_closures, map_by_paths
from deepgps.initial_map.distances.pose_graph import relax
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


def test_a_rough_map_becomes_exact_to_a_centimetre(mapped: Mapped):
    rough, segments, closures, place = mapped
    found, _ = relax(rough, segments, closures)
    assert np.sqrt(np.mean(error(rough, place) ** 2)) > 0.05
    assert np.sqrt(np.mean(error(found, place) ** 2)) < 0.01


def test_distances_on_a_segment_are_those_driven(mapped: Mapped):
    rough, segments, closures, _ = mapped
    found, _ = relax(rough, segments, closures)
    for row in range(len(segments.count)):
        # A turning place lies on two bars, which meet only nearly.
        driven = segments.distance[row, : int(segments.count[row])].numpy()
        assert along(found, segments, row) == pytest.approx(driven, abs=0.005)


def test_a_few_false_look_alikes_are_not_believed(mapped: Mapped):
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


def test_a_right_map_stays(mapped: Mapped):
    _, segments, closures, place = mapped
    assert error(relax(place, segments, closures)[0], place).max() < 0.06


def test_observations_on_no_segment_stay_where_they_are(mapped: Mapped):
    rough, segments, closures, _ = mapped
    more = np.concatenate([rough, [[7.0, 8.0]]])
    assert np.array_equal(relax(more, segments, closures)[0][-1], [7.0, 8.0])


def test_a_right_map_costs_less_than_a_bent_one(mapped: Mapped):
    _, segments, closures, place = mapped
    bent = place.copy()
    bent[place[:, 0] > place[:, 0].mean(), 1] *= -1.0
    assert relax(place, segments, closures)[1] < 0.9 * relax(bent, segments, closures)[1]


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
