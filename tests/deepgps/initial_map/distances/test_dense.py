from dataclasses import replace

import numpy as np
import pytest
import torch

from deepgps.initial_map.distances import dense
from deepgps.initial_map.distances.dense import find_affine_maps, find_initial_map
from deepgps.initial_map.distances.isomap import find_loop_closures
from deepgps.initial_map.distances.pose_graph import Relaxed
from tests.deepgps.initial_map.distances.test_pose_graph import error


def test_the_map_is_exact_to_a_centimetre(toy):
    features, segments, place = toy
    found, _ = find_initial_map(features, segments, torch.Generator().manual_seed(0))
    assert np.sqrt(np.mean(error(found, place) ** 2)) < 0.01


def test_it_is_so_by_straightness_alone_and_by_paths_alone(toy, monkeypatch: pytest.MonkeyPatch):
    features, segments, place = toy
    for name, only in (("find_affine_maps", lambda *_: []), ("NEIGHBOURS", (3,))):
        with monkeypatch.context() as patched:
            patched.setattr(dense, name, only)
            if name == "NEIGHBOURS":
                patched.setattr(dense, "map_by_paths", lambda count, *_: np.zeros((count, 2)))
            found, _ = find_initial_map(features, segments, torch.Generator().manual_seed(0))
        assert np.sqrt(np.mean(error(found, place) ** 2)) < 0.01


@pytest.mark.parametrize(("costs", "overlaps", "best"), [((3, 1, 2), (0, 0, 0), 1), ((3, 1, 2), (0, 0.3, 0), 2)])
def test_the_cheapest_map_is_kept_unless_it_lays_unlike_places_together(
    toy, monkeypatch: pytest.MonkeyPatch, costs: tuple[int, ...], overlaps: tuple[float, ...], best: int
):
    features, segments, _ = toy
    made, cost, overlap = [np.zeros((len(features), 2)) for _ in costs], iter(costs), iter(overlaps)
    monkeypatch.setattr(dense, "map_by_paths", lambda *_: made[0])
    monkeypatch.setattr(dense, "NEIGHBOURS", (3,))
    monkeypatch.setattr(dense, "find_affine_maps", lambda *_: made[1:])
    monkeypatch.setattr(dense, "relax", lambda places, *_: (places, float(next(cost))))
    monkeypatch.setattr(dense, "measure_overlap", lambda *_: next(overlap))
    monkeypatch.setattr(dense, "relax_unevenly", lambda places, *_: Relaxed(places, segments, 0.0))
    assert find_initial_map(features, segments, torch.Generator().manual_seed(0))[0] is made[best]


def test_short_drives_have_a_map_too(toy):
    features, segments, _ = toy
    few = segments.take(torch.arange(8))
    closures = find_loop_closures(features, few, (3,))[0]
    assert len(list(find_affine_maps(len(features), few, closures))) >= 1
    found, _ = find_initial_map(features, few, torch.Generator().manual_seed(0))
    assert np.isfinite(found[few.index[0, 0]]).all()


def test_same_generator_same_map(toy):
    features, segments = toy.features, toy.segments.take(torch.arange(20))
    first, second = (find_initial_map(features, segments, torch.Generator().manual_seed(3))[0] for _ in range(2))
    assert np.array_equal(first, second, equal_nan=True)


def test_encoders_that_count_nothing_in_most_gaps_have_a_map_too(toy):
    features, segments, place = toy
    tick_m = 3.3 * float(segments.distance[0, 1])
    coarse = replace(segments, distance=(segments.distance / tick_m).floor() * tick_m)
    found, _ = find_initial_map(features, coarse, torch.Generator().manual_seed(0))
    assert np.sqrt(np.nanmean(error(found, place) ** 2)) < 2.0 * tick_m
