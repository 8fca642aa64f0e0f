"""Maps by shortest paths: no folds, loop closures that join near places, however pairs are compared."""

import numpy as np
import pytest
import torch

from deepgps.data.segments import read_segments
from deepgps.initial_map.distances.isomap import find_loop_closures, has_lines, map_by_paths, scale_classically
from sim.alignment import fit_alignment
from sim.errors import InputError
from tests.deepgps.data.test_segments import recording_of


def test_scaling_euclidean_distances_gives_the_places_back():
    place = np.random.default_rng(0).normal(size=(40, 2))
    landmark = np.arange(0, 40, 3)
    path = np.linalg.norm(place[landmark][:, None] - place, axis=-1)
    found = scale_classically(path, landmark)
    assert np.allclose(fit_alignment(found, place, "E2").apply(found), place, atol=1e-9)


def test_the_map_is_not_folded_and_the_same_for_a_generator(toy):
    features, segments, place = toy
    closures = find_loop_closures(features, segments, (3,))[0]
    found, same = (map_by_paths(len(features), segments, closures, torch.Generator().manual_seed(0)) for _ in range(2))
    error = np.linalg.norm(fit_alignment(found, place, "E2").apply(found) - place, axis=1)
    # Paths zigzag a little; a fold would cost a good part of the 2 m.
    assert np.sqrt(np.mean(error**2)) < 0.2
    assert error.max() < 0.6
    assert np.array_equal(found, same)


def test_links_join_places_that_lie_together(toy):
    features, segments, place = toy
    first, second, length = find_loop_closures(features, segments, (3,))[0]
    apart = np.linalg.norm(place[first] - place[second], axis=1)
    assert len(first) > 500
    assert np.mean(apart > 0.3) < 0.01
    assert 0.7 < np.median(length / apart.clip(1e-3)) < 1.5
    pairs = set(zip(first.tolist(), second.tolist(), strict=True))
    assert all((j, i) in pairs for i, j in pairs)


def test_chunks_find_what_a_comparison_of_all_pairs_finds(toy, monkeypatch: pytest.MonkeyPatch):
    features, segments, _ = toy
    monkeypatch.setattr("deepgps.initial_map.distances.isomap.PAIR_BATCH", 7 * len(features))
    first, second, _ = find_loop_closures(features, segments, (3,))[0]
    apart = torch.cdist(features, features, compute_mode="donot_use_mm_for_euclid_dist")
    for index, count in zip(segments.index, segments.count, strict=True):
        apart[index[:count, None], index[None, :count]] = torch.inf
    near = torch.zeros(apart.shape, dtype=torch.bool).scatter_(1, apart.topk(3, largest=False).indices, True)
    mutual = near & near.T & (apart < torch.inf)
    # only pairs of observations farther apart than two steps are left out
    assert mutual[first, second].all()
    assert len(first) > 0.95 * mutual.sum()


def test_lines_need_three_readings_and_paths_segments_that_hang_together():
    two = read_segments(recording_of([[0, 0, 0, 0], [0, 1, 9, 9], [1, 1, 9, 9], [1, 2, 20, 20]]))
    three = read_segments(recording_of([[0, 0, 0, 0], [0, 1, 9, 9], [0, 2, 20, 20]]))
    assert not has_lines(two)
    assert has_lines(three)
    apart = read_segments(recording_of([[0, 0, 0, 0], [0, 1, 9, 9]]))
    with pytest.raises(InputError, match="segments do not hang together"):
        map_by_paths(4, apart, find_loop_closures(torch.eye(4), apart, (3,))[0], torch.Generator())
