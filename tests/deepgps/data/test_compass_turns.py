"""Turns by compass: as the robot turned, whatever its wheels say, and with the readings that are left."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deepgps.data.compass_turns import BACKED_OFF_M, measure_turns
from deepgps.data.plausible_readings import keep_plausible
from deepgps.data.segments import find_runs
from sim.errors import InputError
from sim.geometry import wrap
from sim.recording.format import Recording, open_recording, open_truth
from sim.recording.turns import KINDS


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
    known = turns.jump_std < BACKED_OFF_M
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


def test_turns_of_readings_that_are_left_out_are_joined(recording: Recording, turned: np.ndarray):
    assert recording.turns is not None
    times = recording.time.copy()
    run = find_runs(recording)[5]
    times[run] = np.nan  # a complete segment cannot be
    left = keep_plausible(replace(recording, time=times))
    assert left.turns is not None and len(left.turns.before) == len(recording.turns.before) - 1
    turns = measure_turns(left)
    assert len(turns.angle) == len(turned) - 1
    assert turns.angle_std.max() > 1.0, "of the turns before and after it only one is known"


def test_a_recording_without_turns_is_refused_in_one_line(recording: Recording):
    with pytest.raises(InputError, match=r"has no images after turns \(turns\.npy\), which a compass needs"):
        measure_turns(replace(recording, turns=None, turn_observation=None))


def test_where_the_robot_backed_off_the_next_segment_begins_behind_the_last(recording: Recording):
    assert recording.turns is not None
    backed = np.flatnonzero(recording.turns.kind == KINDS.index("backed_off"))
    turns = measure_turns(recording)
    if len(backed):
        assert (turns.jump[turns.jump_std >= BACKED_OFF_M, 0] < 0.2).all()
    np.testing.assert_array_equal(turns.jump[turns.jump_std < BACKED_OFF_M], 0.0)
