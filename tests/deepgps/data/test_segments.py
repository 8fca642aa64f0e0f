"""Segments: their distances, paths and draws, and stretches of a mask."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from deepgps.data.segments import (
    dead_reckon,
    fill_stretches,
    find_held_out,
    find_owners,
    find_stretches,
    leave_held_out,
    read_segments,
    subsample,
    travel,
)
from deepgps.learning.batches import sample_batch
from sim.errors import InputError
from sim.recording.format import Recording
from sim.recording.manifest import Manifest
from tests.helpers.toy import ODOMETRY, SPACING_M, make_toy

# 1000 ticks a revolution of a wheel of radius 1 / (2 pi): one tick is a millimetre.
MILLIMETRES = {"wheel_radius_m": 1.0 / (2.0 * np.pi), "track_m": 0.2, "ticks_per_rev": 1000}


def recording_of(reading: list[list[int]], odometry: dict | None = None) -> Recording:
    table = np.array(reading, np.int64)
    empty = np.zeros((0, 2))
    return Recording(
        Path("made-up"), Manifest(odometry=odometry or MILLIMETRES), empty, table, np.zeros(len(table)), empty
    )


def test_distances_are_the_mean_of_both_wheels_since_the_first_reading():
    segments = read_segments(
        recording_of([[0, 0, 100, 200], [0, 1, 180, 280], [0, 2, 250, 360], [1, 2, 300, 310], [1, 3, 200, 210]])
    )
    assert segments.count.tolist() == [3, 2]
    assert segments.index.tolist() == [[0, 1, 2], [2, 3, 0]]
    assert np.allclose(segments.distance, [[0.0, 0.080, 0.155], [0.0, 0.100, 0.0]])
    assert segments.valid.tolist() == [[True, True, True], [True, True, False]]


def test_segments_with_fewer_than_two_readings_are_counted_and_left_out():
    segments = read_segments(recording_of([[0, 0, 0, 0], [1, 1, 5, 5], [1, 2, 9, 9], [4, 3, 9, 9]]))
    assert segments.skipped == 2
    assert segments.index.tolist() == [[1, 2]]
    with pytest.raises(InputError, match="made-up: no segment has two readings"):
        read_segments(recording_of([[0, 0, 0, 0], [1, 1, 5, 5]]))


def test_ticks_become_metres_by_constants_that_are_all_there():
    assert np.allclose(travel(np.array([[65536, 0]]), ODOMETRY), [[2.0 * np.pi * 0.033, 0.0]])
    with pytest.raises(InputError, match=r"odometry.ticks_per_rev must be a number from 1 to .*, and is None"):
        travel(np.zeros((1, 2)), {"wheel_radius_m": 0.03, "track_m": 0.1})


@pytest.fixture(scope="module")
def toy(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return make_toy(tmp_path_factory.mktemp("segments") / "toy", samples=1500)


def test_toy_distances_are_whole_spacings_and_need_no_truth(toy: Recording, tmp_path: Path):
    segments = read_segments(toy)
    gap = (segments.distance[:, 1:] - segments.distance[:, :-1])[segments.valid[:, 1:]]
    assert torch.allclose(gap, torch.full_like(gap, SPACING_M), atol=1e-5)
    blind = replace(toy, folder=tmp_path / "nowhere")
    assert len(read_segments(blind).count) == len(segments.count) and len(dead_reckon(blind)) == len(toy.reading)


def test_dead_reckoning_with_exact_encoders_is_the_path_driven(toy: Recording):
    driven, path = np.load(toy.folder / "truth" / "pose.npy")[toy.reading[:, 1]], dead_reckon(toy)
    # The path starts at the first reading, after the first turn.
    turn = np.arctan2(driven[1, 1], driven[1, 0])
    turned = path[:, :2] @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    assert np.allclose(turned, driven[:, :2], atol=5e-3)


def test_a_left_turn_is_positive_and_the_distance_between_segments_lies_before_it():
    path = dead_reckon(recording_of([[0, 0, 0, 0], [0, 1, 100, 100], [1, 1, 0, 200], [1, 2, 100, 300]]))
    # 200 mm of difference over a track of 200 mm is one radian.
    assert np.allclose(path[-1], [0.1 + 0.1 * np.cos(1.0), 0.1 * np.sin(1.0), 1.0])
    # 50 mm back from what was touched, then a radian to the left, then 100 mm on
    path = dead_reckon(recording_of([[0, 0, 0, 0], [0, 1, 100, 100], [1, 2, -50, 150], [1, 3, 50, 250]]))
    assert np.allclose(path[2], [0.05, 0.0, 1.0])
    assert np.allclose(path[-1], [0.05 + 0.1 * np.cos(1.0), 0.1 * np.sin(1.0), 1.0])


def test_draws_are_different_readings_of_one_segment(toy: Recording):
    segments = read_segments(toy)
    batch = sample_batch(segments, 50, 8, torch.Generator().manual_seed(0))
    index, along, valid = batch.index, batch.target, batch.valid
    assert index.shape == along.shape == valid.shape == (50, 8)
    rows = [set(row.tolist()) for row in segments.index]
    for one, use in zip(index, valid, strict=True):
        chosen = one[use].tolist()
        assert len(set(chosen)) == len(chosen) >= 2
        assert any(set(one.tolist()) <= row for row in rows), "what fills a short segment is its own"


def test_each_reading_is_drawn_equally_often():
    reading = [[0, k, k, k] for k in range(10)] + [[1, 10 + k, k, k] for k in range(30)]
    segments = read_segments(recording_of(reading))
    index = sample_batch(segments, 4000, 1, torch.Generator().manual_seed(0)).index
    often = torch.bincount(index.flatten(), minlength=40)
    assert often.min() > 60 and often.max() < 145


def test_owners_of_a_turning_place_are_both_segments():
    segments = read_segments(recording_of([[0, 0, 0, 0], [0, 1, 5, 5], [1, 1, 5, 5], [1, 2, 9, 9]]))
    first, last = find_owners(segments, 4)
    assert first.tolist() == [0, 0, 1, -1]
    assert last.tolist() == [0, 1, 1, -1]


def test_of_a_long_recording_whole_segments_are_kept_spread_evenly(toy: Recording):
    segments = read_segments(toy)
    assert subsample(segments, 1500, 1500)[0] is segments
    kept, chosen = subsample(segments, 1500, 500)
    assert 450 < len(chosen) <= 500
    assert torch.histc(chosen.float(), 3, 0, 1500).min() > 110
    wholes = [segments.index[row, :count].tolist() for row, count in enumerate(segments.count.tolist())]
    for row, count in enumerate(kept.count.tolist()):
        index = chosen[kept.index[row, :count]].tolist()
        assert segments.distance[wholes.index(index), :count].equal(kept.distance[row, :count])
    one = read_segments(recording_of([[0, row, 10 * row, 10 * row] for row in range(40)]))
    with pytest.raises(InputError, match="a segment has 40 readings, more than the 30 that are fitted at once"):
        subsample(one, 40, 30)


def test_labels_on_segments_held_out_alone_are_not_enough(toy: Recording):
    segments, count = read_segments(toy), len(toy.observation)
    held = find_held_out(segments, count).nonzero()[:, 0]
    with pytest.raises(InputError, match="only segments that are held out have labels"):
        leave_held_out(held, torch.zeros((len(held), 2)), segments, count)
    index, left = leave_held_out(torch.arange(count), torch.zeros((count, 2)), segments, count)
    assert len(index) == len(left) == count - len(held)


@given(st.lists(st.booleans(), max_size=40))
def test_a_mask_is_that_of_its_stretches(values: list[bool]):
    mask = np.array(values, bool)
    found = find_stretches(mask)
    assert (fill_stretches(found.tolist(), len(mask)) == mask).all()
    assert (found[1:, 0] > found[:-1, 1] + 1).all()
    assert find_stretches(np.array([True, True, False, True])).tolist() == [[0, 1], [3, 3]]
