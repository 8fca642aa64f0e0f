"""Segments: their distances, paths and draws, and stretches of a mask."""

import shutil
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


def test_no_distance_at_all_is_refused():
    with pytest.raises(InputError, match="made-up: no segment has two readings"):
        read_segments(recording_of([[0, 0, 0, 0], [1, 1, 5, 5]]))


def test_missing_odometry_is_named():
    with pytest.raises(
        InputError, match=r"manifest: odometry.ticks_per_rev must be a number from 1 to .*, and is None"
    ):
        travel(np.zeros((1, 2)), {"wheel_radius_m": 0.03, "track_m": 0.1})


def test_toy_distances_are_whole_spacings(tmp_path: Path):
    segments = read_segments(make_toy(tmp_path / "toy"))
    gap = (segments.distance[:, 1:] - segments.distance[:, :-1])[segments.valid[:, 1:]]
    assert torch.allclose(gap, torch.full_like(gap, SPACING_M), atol=1e-5)


def test_truth_is_not_needed(tmp_path: Path):
    recording = make_toy(tmp_path / "toy")
    shutil.rmtree(recording.folder / "truth")
    assert len(read_segments(recording).count) > 10
    assert len(dead_reckon(recording)) == len(recording.reading)


def test_dead_reckoning_with_exact_encoders_is_the_path_driven(tmp_path: Path):
    recording = make_toy(tmp_path / "toy")
    driven = np.load(recording.folder / "truth" / "pose.npy")[recording.reading[:, 1]]
    path = dead_reckon(recording)
    # The path starts at the first reading, after the first turn.
    turn = np.arctan2(driven[1, 1], driven[1, 0])
    turned = path[:, :2] @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    assert np.allclose(turned, driven[:, :2], atol=5e-3)


def test_a_left_turn_is_positive():
    path = dead_reckon(recording_of([[0, 0, 0, 0], [0, 1, 100, 100], [1, 1, 0, 200], [1, 2, 100, 300]]))
    # 200 mm of difference over a track of 200 mm is one radian.
    assert np.allclose(path[-1], [0.1 + 0.1 * np.cos(1.0), 0.1 * np.sin(1.0), 1.0])


def test_way_between_segments_lies_before_the_turn():
    # 50 mm back from what was touched, then a radian to the left, then 100 mm on
    path = dead_reckon(recording_of([[0, 0, 0, 0], [0, 1, 100, 100], [1, 2, -50, 150], [1, 3, 50, 250]]))
    assert np.allclose(path[2], [0.05, 0.0, 1.0])
    assert np.allclose(path[-1], [0.05 + 0.1 * np.cos(1.0), 0.1 * np.sin(1.0), 1.0])


def test_draws_are_different_readings_of_one_segment(tmp_path: Path):
    segments = read_segments(make_toy(tmp_path / "toy"))
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


def test_ticks_become_metres():
    assert np.allclose(travel(np.array([[65536, 0]]), ODOMETRY), [[2.0 * np.pi * 0.033, 0.0]])


def test_a_short_recording_is_kept_whole(tmp_path: Path):
    recording = make_toy(tmp_path / "toy", samples=300)
    segments = read_segments(recording)
    kept, chosen = subsample(segments, 300, 300)
    assert kept is segments
    assert chosen.tolist() == list(range(300))


def test_of_a_long_recording_whole_segments_are_kept_spread_evenly(tmp_path: Path):
    segments = read_segments(make_toy(tmp_path / "toy", samples=3000))
    kept, chosen = subsample(segments, 3000, 1000)
    assert 900 < len(chosen) <= 1000
    thirds = torch.histc(chosen.float(), 3, 0, 3000)
    assert thirds.min() > 250
    wholes = [segments.index[row, :count].tolist() for row, count in enumerate(segments.count.tolist())]
    for row, count in enumerate(kept.count.tolist()):
        index = chosen[kept.index[row, :count]].tolist()
        assert segments.distance[wholes.index(index), :count].equal(kept.distance[row, :count])


def test_labels_on_segments_held_out_alone_are_not_enough(tmp_path: Path):
    recording = make_toy(tmp_path / "toy", samples=1500)
    segments, count = read_segments(recording), len(recording.observation)
    held = find_held_out(segments, count).nonzero()[:, 0]
    places = torch.zeros((len(held), 2))
    with pytest.raises(InputError, match="only segments that are held out have labels"):
        leave_held_out(held, places, segments, count)
    index, left = leave_held_out(torch.arange(count), torch.zeros((count, 2)), segments, count)
    assert len(index) == len(left) == count - len(held)


def test_a_segment_that_is_longer_than_what_is_fitted_is_refused():
    segments = read_segments(recording_of([[0, row, 10 * row, 10 * row] for row in range(40)]))
    with pytest.raises(InputError, match="a segment has 40 readings, more than the 30 that are fitted at once"):
        subsample(segments, 40, 30)


@given(st.lists(st.booleans(), max_size=40))
def test_a_mask_is_that_of_its_stretches(values: list[bool]):
    mask = np.array(values, bool)
    found = find_stretches(mask)
    assert (fill_stretches(found.tolist(), len(mask)) == mask).all()
    assert (found[1:, 0] > found[:-1, 1] + 1).all()


def test_a_stretch_ends_with_its_last_index():
    assert find_stretches(np.array([True, True, False, True])).tolist() == [[0, 1], [3, 3]]
