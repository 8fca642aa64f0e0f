"""Turns by images: as the robot turned, whatever its wheels say, with the readings that are left."""

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch

from deepgps.data.segments import Segments, find_runs
from deepgps.data.turns import (
    BACK_OFF_STD_M,
    MEETING_STD_M,
    _join,
    compare_headings,
    find_next,
    measure_curvature,
    measure_turns,
)
from deepgps.initial_map.compass.bars import turn
from sim.errors import InputError
from sim.geometry import wrap
from sim.recording.format import Recording, open_recording, open_truth
from sim.recording.turns import KINDS, list_turns, lose_turns


@pytest.fixture(scope="module")
def recording(small_recording: Path) -> Recording:
    return open_recording(small_recording)


@pytest.fixture(scope="module")
def turned(recording: Recording) -> np.ndarray:
    """True turn between consecutive segments with two readings or more [rad]."""
    place = open_truth(recording.folder).pose[:, :2]
    runs = [recording.reading[run, 1] for run in find_runs(recording) if len(run) >= 2]
    ahead = np.array([place[run[-1]] - place[run[0]] for run in runs])
    return np.diff(np.arctan2(ahead[:, 1], ahead[:, 0]))


def test_turns_are_the_true_ones(recording: Recording, turned: np.ndarray):
    turns = measure_turns(recording)
    error = wrap(turns.angle - turned)
    known = turns.jump_std < BACK_OFF_STD_M
    assert known.sum() > 10
    assert np.sqrt((error[known] ** 2).mean()) < np.radians(1.0), "32 sectors are 11 degrees each"
    assert np.abs(error).max() < np.radians(15.0)


def test_wheels_that_err_in_each_turn_change_no_angle(recording: Recording):
    ticks, rng = recording.reading.copy(), np.random.default_rng(0)
    turns = recording.turns
    assert turns is not None
    for row in turns.after:  # the right wheel slips by up to 9 degrees in each turn
        ticks[row:, 3] += round(rng.uniform(-500, 500))
    slipped = measure_turns(replace(recording, reading=ticks))
    right = measure_turns(recording)
    np.testing.assert_allclose(wrap(slipped.angle - right.angle), 0.0, atol=1e-9)


def test_turns_of_readings_that_are_lost_are_joined(recording: Recording, turned: np.ndarray):
    assert recording.turns is not None
    kept = np.ones(len(recording.reading), bool)
    kept[find_runs(recording)[5]] = False
    turns = lose_turns(recording.turns, recording.reading[:, 0], kept)
    left = replace(recording, reading=recording.reading[kept], time=recording.time[kept], turns=turns)
    assert len(turns.before) == len(recording.turns.before) - 1
    turns = measure_turns(left)
    assert len(turns.angle) == len(turned) - 1
    assert turns.angle_std.max() > 1.0, "of the turns before and after it only one is known"


def test_a_recording_without_turns_is_refused_in_one_line(recording: Recording):
    with pytest.raises(InputError, match=r"has no images after turns \(turns\.npy\), which a compass needs"):
        measure_turns(replace(recording, turns=None, turn_observation=None))


@pytest.mark.parametrize("lost", ["before", "after", "both"])
def test_where_the_robot_turned_is_known_from_one_of_the_two_readings_there(lost: str, recording: Recording):
    assert recording.turns is not None
    arrived = np.ones(len(recording.reading), bool)
    for row in recording.turns.after[recording.turns.kind == KINDS.index("in_place")]:
        arrived[{"before": [row - 1], "after": [row], "both": [row - 1, row]}[lost]] = False
    left = lose_turns(recording.turns, recording.reading[:, 0], arrived)
    drive = replace(recording, reading=recording.reading[arrived], turns=left)
    turns, pose = measure_turns(drive), open_truth(recording.folder).pose
    runs = [drive.reading[run, 1] for run in find_runs(drive) if len(run) >= 2]
    apart = np.array([pose[after[0], :2] - pose[before[-1], :2] for before, after in pairwise(runs)])
    true = turn(-np.array([pose[before[-1], 2] for before in runs[:-1]]), apart)
    error, known = np.linalg.norm(turns.jump - true, axis=1), turns.jump_std < BACK_OFF_STD_M
    assert known.sum() > 10
    if lost == "both":
        assert 0.4 < np.sqrt(np.mean((error / turns.jump_std)[known] ** 2) / 2) < 1.3
    else:
        np.testing.assert_allclose(turns.jump_std[known], MEETING_STD_M)
        assert error[known].max() < 5 * MEETING_STD_M


@pytest.mark.parametrize("lost", [0.0, 0.3, 0.6])
def test_where_the_robot_backed_off_the_next_segment_begins_behind_the_last(lost: float, recording: Recording):
    drive, place, heading = drive_backing_off(recording, lost)
    assert drive.turns is not None
    angle = np.diff(heading)[drive.reading[drive.turns.after, 0] - 1]
    turns = _join(drive, angle, np.full(len(angle), 1e-6))
    ends = [(run[0], run[-1]) for run in find_runs(drive) if len(run) >= 2]
    apart = np.array([place[first] - place[last] for (_, last), (first, _) in pairwise(ends)])
    true = turn(-heading[drive.reading[[last for _, last in ends[:-1]], 0]], apart)
    known = turns.jump_std < 1.0
    assert known.sum() > 30
    error = np.linalg.norm(turns.jump - true, axis=1)[known] / turns.jump_std[known]
    assert np.sqrt(np.mean(error**2) / 2) < 1.3


def drive_backing_off(recording: Recording, lost: float) -> tuple[Recording, np.ndarray, np.ndarray]:
    """Sixty segments of nine images, 8 cm apart, each after backing off by 12 cm and a turn; some readings are lost.

    Returns:
        The drive, true positions of its readings (R, 2) [m], and headings of its segments (60,) [rad].
    """
    rng, odometry = np.random.default_rng(0), recording.manifest.odometry
    heading = np.cumsum(rng.uniform(-2.5, 2.5, 60))
    place, reading, end, rolled = [], [], np.zeros(2), np.zeros(2)
    for segment, yaw in enumerate(heading):
        ahead = np.array([np.cos(yaw), np.sin(yaw)])
        for number in range(9):
            place.append(end + 0.08 * number * ahead)
            observation = 9 * segment + number
            reading.append([segment, observation, *np.rint((rolled + 0.08 * number) * ticks_per_metre(odometry))])
        end = place[-1] - 0.12 * ahead
        turned = np.diff(heading)[segment] if segment < 59 else 0.0
        rolled = rolled + 0.64 - 0.12 + turned * odometry["track_m"] / 2 * np.array([-1.0, 1.0])
    rows, kinds = np.array(reading, np.int64), np.full(60, KINDS.index("backed_off"))
    turns = list_turns(rows[:, 0], rows[:, 1], kinds)
    arrived = rng.random(len(rows)) >= lost
    kept = lose_turns(turns, rows[:, 0], arrived)
    return replace(recording, reading=rows[arrived], turns=kept), np.array(place)[arrived], heading


def ticks_per_metre(odometry: Mapping[str, float]) -> float:
    return odometry["ticks_per_rev"] / (2 * np.pi * odometry["wheel_radius_m"])


def test_after_backing_off_the_image_is_the_first_of_the_segment_though_its_reading_was_lost(recording: Recording):
    drive, _, _ = drive_backing_off(recording, 0.6)
    assert drive.turns is not None
    np.testing.assert_array_equal(find_next(drive, drive.turns), drive.turns.before + 1)
    assert (drive.reading[drive.turns.after, 1] > drive.turns.before + 1).any()


SECTORS = 64


def draw(seed: int, count: int) -> np.ndarray:
    """Smooth polar images (count, 16, SECTORS, 3)."""
    rng = np.random.default_rng(seed)
    wave = np.arange(1, 9)
    phase = 2 * np.pi * np.arange(SECTORS)[:, None] / SECTORS * wave
    shares = rng.normal(size=(2, count, 16, 8, 3))
    images = np.einsum("sw,nrwc->nrsc", np.cos(phase), shares[0]) + np.einsum("sw,nrwc->nrsc", np.sin(phase), shares[1])
    return (128 + 8 * images).clip(0, 255).astype(np.uint8)


def test_a_turned_image_tells_the_turn_at_every_sector():
    image = draw(0, 1)
    turned = np.concatenate([np.roll(image, -k, axis=2) for k in range(SECTORS)])
    found = compare_headings(turned, np.zeros(SECTORS, int), np.arange(SECTORS))
    true = 2 * np.pi * np.arange(SECTORS) / SECTORS
    assert found.clear.all()
    np.testing.assert_allclose(np.angle(np.exp(1j * (found.turn - true))), 0.0, atol=np.radians(0.2))


def test_an_image_with_two_fold_symmetry_leaves_the_heading_open():
    half = draw(1, 1)[:, :, : SECTORS // 2]
    found = compare_headings(np.concatenate([half, half], axis=2), np.zeros(1, int), np.zeros(1, int))
    assert not found.clear.any()


def test_the_curvature_of_a_drive_is_its_turn_for_each_metre():
    image = draw(2, 1)
    images = np.concatenate([np.roll(image, -k, axis=2) for k in range(6)])  # a sector for each step of 0.5 m
    index = torch.arange(6)[None]
    segments = Segments(index, 0.5 * index.float(), torch.tensor([6]), 0)
    assert abs(measure_curvature(images, segments) - 2 * np.pi / SECTORS / 0.5) < 0.01
