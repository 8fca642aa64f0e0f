"""Maps of segments with two readings: bars and look-alikes bring places back, and mixtures undo contraction."""

from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.sparse import csc_array

from deepgps.data.features import normalise
from deepgps.data.segments import Segments, read_segments
from deepgps.initial_map.distances import end_points
from deepgps.initial_map.distances.end_points import (
    _descend,
    find_end_point_map,
    find_look_alikes,
    find_mixture,
    fit_mixture,
    relax_ends,
)
from deepgps.learning.trainer import make_generator
from sim.alignment import fit_alignment
from sim.errors import InputError
from sim.recording.format import open_truth
from tests.helpers.toy import make_toy


def error(found: np.ndarray, place: np.ndarray) -> np.ndarray:
    return np.linalg.norm(fit_alignment(found, place, "E2").apply(found) - place, axis=1)


def make_ends(count: int = 400, seed: int = 0) -> tuple[np.ndarray, Segments]:
    """Places in a square, visited in an order by chance along straight bars."""
    rng = np.random.default_rng(seed)
    place = rng.uniform(-1, 1, (count, 2))
    index = np.stack([np.arange(count - 1), np.arange(1, count)], axis=1)
    driven = np.linalg.norm(place[index[:, 1]] - place[index[:, 0]], axis=1)
    distance = np.stack([np.zeros_like(driven), driven], axis=1).astype(np.float32)
    return place, Segments(torch.from_numpy(index), torch.from_numpy(distance), torch.full((count - 1,), 2), 0)


def test_bars_and_look_alikes_bring_places_back():
    place, segments = make_ends()
    apart = np.linalg.norm(place[:, None] - place[None], axis=2)
    i, j = np.nonzero((apart < 0.12) & (np.arange(400)[:, None] < np.arange(400)))
    rng = np.random.default_rng(1)
    false = rng.integers(0, 400, (2, 20))
    closures = (
        np.concatenate([i, false[0]]),
        np.concatenate([j, false[1]]),
        np.concatenate([apart[i, j], np.full(20, 0.05)]),
    )
    start = place + 0.15 * np.sin(2 * place[:, ::-1]) + rng.normal(0, 0.02, place.shape)
    found, cost = relax_ends(start, segments, closures)
    assert np.median(error(start, place)) > 0.05
    assert np.median(error(found, place)) < 0.07  # loop closures pull places together
    assert cost < relax_ends(rng.uniform(-1, 1, place.shape), segments, closures)[1]


def test_the_mixture_takes_the_contraction_back():
    place, segments = make_ends()
    mixture = find_mixture(torch.from_numpy(place).float())
    np.testing.assert_allclose(mixture.sum(axis=1), 1.0)
    bent = place * (1.0 - 0.1 * np.linalg.norm(place, axis=1, keepdims=True))
    found = fit_mixture(bent, segments, mixture)
    assert np.median(error(bent, place)) > 0.02
    assert np.median(error(found, place)) < 0.005
    unknown = np.where(np.arange(400)[:, None] == 7, np.nan, place)
    assert np.flatnonzero(np.isnan(fit_mixture(unknown, segments, mixture)).any(axis=1)).tolist() == [7]


def test_a_map_of_ends_is_unfolded(tmp_path: Path):
    recording = make_toy(tmp_path / "toy", samples=350, endpoint=True)
    segments, place = read_segments(recording), open_truth(recording.folder).pose[:, :2]
    features = normalise(recording.observation)[1]
    found, same = find_end_point_map(features, segments, make_generator(0, "start"))
    assert same is segments
    known = np.isfinite(found).all(axis=1)
    assert known.mean() > 0.95
    assert np.median(error(found[known], place[known])) < 0.3


def test_the_map_does_not_depend_on_where_the_places_are_numbered_from(tmp_path: Path):
    place, segments = make_ends(60)
    closures = find_look_alikes(torch.from_numpy(place).float(), segments, (5,))[0]
    found, cost = relax_ends(place, segments, closures)
    shifted, same = relax_ends(place + 5.0, segments, closures)
    np.testing.assert_allclose(shifted, found + 5.0, rtol=0, atol=1e-6)
    assert same == pytest.approx(cost)


def test_pairs_are_mutual_and_never_one_segment_and_need_a_short_one():
    place, segments = make_ends(200)
    features = torch.from_numpy(place).float()
    for i, j, length in find_look_alikes(features, segments, (4, 8)):
        assert (i < j).all() and (length < 0.3).all()
        assert (np.abs(i - j) > 1).all()
    far = Segments(segments.index, segments.distance + torch.tensor([0.0, 5.0]), segments.count, 0)
    with pytest.raises(InputError, match=r"learn\.start 'ends': no segment is shorter than 0\.5 m"):
        find_look_alikes(features, far, (5,))


def test_chunks_change_nothing(monkeypatch: pytest.MonkeyPatch):
    place, segments = make_ends(200)
    features = torch.from_numpy(np.cos(place @ np.random.default_rng(1).normal(size=(2, 40)) * 2)).float()
    whole, mixture = find_look_alikes(features, segments, (4, 8)), find_mixture(features)
    monkeypatch.setattr(end_points, "CHUNK", 37)
    for closures, same in zip(find_look_alikes(features, segments, (4, 8)), whole, strict=True):
        assert [part.tolist() for part in closures[:2]] == [part.tolist() for part in same[:2]]
        np.testing.assert_allclose(closures[2], same[2], rtol=1e-3)
    np.testing.assert_allclose(find_mixture(features).toarray(), mixture.toarray(), atol=1e-3)


def test_steps_are_those_of_a_direct_solver():
    rng = np.random.default_rng(0)
    slope = rng.normal(size=(90, 40)) * (rng.uniform(size=(90, 40)) < 0.1)
    weight, residual = rng.uniform(0.5, 2.0, 90), rng.normal(size=90)
    direct = np.linalg.solve((slope.T * weight) @ slope + 0.01 * np.eye(40), (slope.T * weight) @ residual)
    found = _descend(csc_array(slope), weight, residual, 0.01)
    np.testing.assert_allclose(found, -direct.reshape(-1, 2), rtol=1e-4, atol=1e-6)
