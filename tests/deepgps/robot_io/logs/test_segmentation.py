"""Segments and turns by the wheels: all of a made-up drive are found, whatever the wheels' noise and differences."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepgps.robot_io.logs.segmentation import follow
from deepgps.robot_io.logs.wheels import Wheels, clean_wheels
from sim.errors import InputError
from tests.helpers.robot_log import LENGTHS_M, RADIUS_M, TICK, TRACK_M, TURNS, make_motion

PERIOD_S = 0.05


def sample(lengths_m=LENGTHS_M, turns=TURNS, scale=(1.0, 1.0), noise: float = 0.0, seed: int = 0) -> Wheels:
    """Messages of the wheels, of which each step is off by a factor and by noise in proportion to it."""
    motion = make_motion(lengths_m, turns)
    time_s = np.arange(0.0, motion.time_s[-1], PERIOD_S)
    angle = np.column_stack([np.interp(time_s, motion.time_s, wheel) for wheel in motion.angle.T]) * scale
    step = np.diff(angle, axis=0)
    step *= 1.0 + noise * np.random.default_rng(seed).standard_normal(step.shape)
    angle = np.concatenate([angle[:1], angle[:1] + np.cumsum(step, axis=0)])
    return clean_wheels(time_s, np.rint(angle / TICK) * TICK, 4096, "/joint_states")


def find(wheels: Wheels) -> tuple[list[float], list[float]]:
    """Lengths of the segments [m] and turns [rad] that are found, in motions that cover the drive without overlap."""
    _, path, motions = follow(wheels, RADIUS_M, TRACK_M)
    assert motions[0].first == 0 and motions[-1].last == len(wheels.time_s) - 1
    assert all(one.last == other.first for one, other in pairwise(motions))
    lengths = [path.travelled_m[one.last] - path.travelled_m[one.first] for one in motions if one.kind == "straight"]
    return lengths, [path.turn(one) for one in motions if one.kind == "turn"]


def test_all_segments_and_turns_are_found_at_any_noise_and_wheels_that_differ_bend_none() -> None:
    for noise in (0.0, 0.02, 0.05, 0.1):
        lengths, turns = find(sample(noise=noise))
        np.testing.assert_allclose(lengths, LENGTHS_M, atol=0.002 + 0.15 * noise)
        np.testing.assert_allclose(turns, TURNS, atol=0.02 + 2.0 * noise)
    long = (2.0, 1.5, 1.0, 2.0, 1.5, 2.0)
    for scale in ((1.01, 1.0), (1.0, 1.015), (0.98, 0.99)):
        lengths, _ = find(sample(lengths_m=long, scale=scale))
        np.testing.assert_allclose(lengths, np.array(long) * np.mean(scale), atol=0.01)


@settings(max_examples=20, deadline=None)
@given(
    st.lists(st.tuples(st.floats(0.15, 2.0), st.floats(0.3, 3.0), st.booleans()), min_size=2, max_size=6),
)
def test_any_drive_of_segments_and_turns_is_found(parts: list[tuple[float, float, bool]]) -> None:
    lengths_m = tuple(length for length, _, _ in parts)
    turns = tuple(turn if left else -turn for _, turn, left in parts[1:])
    found, turned = find(sample(lengths_m, turns))
    np.testing.assert_allclose(found, lengths_m, atol=0.002)
    np.testing.assert_allclose(turned, turns, atol=0.02)


def test_an_arc_is_no_segment() -> None:
    time_s = np.arange(0.0, 20.0, PERIOD_S)
    ahead = np.where(time_s < 10.0, 0.2, 0.0) + np.where((time_s > 11.0) & (time_s < 18.0), 0.2, 0.0)
    rate = np.where((time_s > 11.0) & (time_s < 18.0), 0.15, 0.0)  # a radius of 1.3 m
    rim = np.column_stack([ahead - rate * TRACK_M / 2, ahead + rate * TRACK_M / 2]) * PERIOD_S / RADIUS_M
    driven = follow(clean_wheels(time_s, np.cumsum(rim, axis=0), 4096, "/joint_states"), RADIUS_M, TRACK_M)
    assert driven.sum_up("straight")["metres"] == pytest.approx(2.0, abs=0.05)
    assert driven.sum_up("arc")["metres"] == pytest.approx(1.4, abs=0.05)


@pytest.mark.parametrize("full", [2.0 * np.pi, 2**16 * TICK, 2**32 * TICK], ids=["a turn", "16 bits", "32 bits"])
@pytest.mark.parametrize("stride", [1, 2])
@pytest.mark.parametrize("rest_s", [0.0, 60.0], ids=["driving", "mostly at rest"])
def test_counters_that_wrap_are_unwrapped(full: float, stride: int, rest_s: float) -> None:
    wheels = sample()
    time_s, angle = wheels.time_s[::stride], wheels.angle[::stride]
    still_s = np.arange(PERIOD_S, rest_s, PERIOD_S)
    time_s = np.concatenate([time_s, time_s[-1] + still_s])
    angle = np.concatenate([angle, np.tile(angle[-1], (len(still_s), 1))])
    counted = (angle + full - 3.0) % full
    wrapped = clean_wheels(time_s, counted, 4096, "/joint_states")
    np.testing.assert_allclose(np.diff(wrapped.angle, axis=0), np.diff(angle, axis=0), atol=1e-5)
    assert "taken as their range" in wrapped.notes[0]
    assert not wrapped.broken.any()


@pytest.mark.parametrize("ticks", [2000, 9000, 12345])
def test_a_counter_that_always_restarts_at_one_count_is_unwrapped(ticks: int) -> None:
    """From 0 to its range, or as some drivers do from 0 to its range in both directions."""
    wheels = sample((2.0,) * 6)
    full = ticks * TICK
    for counted in (wheels.angle % full, np.fmod(wheels.angle, full)):
        found = clean_wheels(wheels.time_s, counted, 4096, "/joint_states")
        np.testing.assert_allclose(np.ptp(found.angle, axis=0), np.ptp(wheels.angle, axis=0), rtol=0.001)
        (note,) = found.notes
        assert not found.broken.any() and "taken as their range" in note
        assert abs(int(note.split(" after ")[1].split()[0]) - ticks) < 0.005 * ticks


def test_a_counter_that_loses_counts_as_it_restarts_has_no_range() -> None:
    """It is set to 0 when it is read beyond 20,000 ticks."""
    wheels, count = sample((2.0,) * 6), np.zeros(2)
    steps = np.diff(wheels.angle, axis=0, prepend=wheels.angle[:1])
    counted = np.array([count := np.where(np.abs(count + step) >= 20_000 * TICK, 0.0, count + step) for step in steps])
    (note,) = clean_wheels(wheels.time_s, counted, 4096, "/joint_states").notes
    assert "the counter restarted, so the way between is unknown" in note


def test_wheels_at_rest_may_differ_by_the_rounding_of_floats() -> None:
    time_s = PERIOD_S * np.arange(100)
    angle = 1e-12 * np.random.default_rng(0).standard_normal((100, 2))
    wheels = clean_wheels(time_s, angle, 4096, "/joint_states")
    assert not wheels.notes and not wheels.broken.any()


def test_a_counter_that_restarts_leaves_the_way_unknown_however_long_its_gap() -> None:
    wheels = sample()
    row = int(np.argmax(wheels.angle[:, 0] > 5.0))
    for seconds in (0.0, 3.0, 60.0):
        time_s, angle = wheels.time_s + seconds * (np.arange(len(wheels.time_s)) > row), wheels.angle.copy()
        angle[row + 1 :] -= angle[row + 1]
        restarted = clean_wheels(time_s, angle, 4096, "/joint_states")
        assert np.flatnonzero(restarted.broken).tolist() == [row]
        assert "the way between is unknown" in restarted.notes[0]
        assert restarted.count_breaks(time_s[[row, row + 1]]).tolist() == [0, 1]


@pytest.mark.parametrize("images", [False, True])
def test_a_pause_of_the_whole_log_leaves_the_way_unknown_and_one_of_resting_wheels_does_not(images: bool) -> None:
    wheels = sample(lengths_m=(1.0, 1.0), turns=(1.0,))
    still = int(np.argmax(np.abs(np.diff(wheels.angle, axis=0)).max(axis=1) < 1e-9))
    time_s = wheels.time_s + 60.0 * (np.arange(len(wheels.time_s)) > still)
    image_s = np.arange(time_s[0], time_s[-1], 0.5)
    if not images:
        image_s = image_s[(image_s < time_s[still] + 0.2) | (image_s > time_s[still + 1])]
    paused = clean_wheels(time_s, wheels.angle, 4096, "/joint_states", image_s)
    assert np.flatnonzero(paused.broken).tolist() == ([] if images else [still])


def test_angles_are_not_known_where_the_motion_is_not_and_outside_the_log() -> None:
    wheels = sample()
    broken = np.zeros(len(wheels.broken), bool)
    broken[100] = True
    at = np.array([-1.0, 1.0, wheels.time_s[100] + 0.02, 1e6])
    assert np.isnan(replace(wheels, broken=broken).at(at)).any(axis=1).tolist() == [True, False, True, True]


def test_messages_that_come_late_are_no_restarts() -> None:
    wheels = sample()
    for every in (50, 30, 20, 3):
        late = np.arange(len(wheels.time_s)) % every == 1
        found = clean_wheels(wheels.time_s + (PERIOD_S - 0.002) * late, wheels.angle, 4096, "/joint_states")
        assert not found.broken.any() and not found.notes


@pytest.mark.parametrize("trembling", [64 * TICK, TICK, 1e-5])
def test_encoders_that_tremble_at_rest_for_long_are_no_restarts(trembling: float) -> None:
    wheels, rng = sample(), np.random.default_rng(0)
    still_s = np.arange(PERIOD_S, 900.0, PERIOD_S)
    time_s = np.concatenate([wheels.time_s, wheels.time_s[-1] + still_s])
    angle = np.concatenate([wheels.angle, wheels.angle[-1] + trembling * rng.integers(0, 2, (len(still_s), 2))])
    assert not clean_wheels(time_s, angle, 4096, "/joint_states").broken.any()
    angle[300:] -= angle[300]
    assert np.flatnonzero(clean_wheels(time_s, angle, 4096, "/joint_states").broken).tolist() == [299]


@pytest.mark.parametrize("full", [2.0 * np.pi, 2**16 * TICK], ids=["a turn", "16 bits"])
def test_wheels_in_messages_of_their_own_are_unwrapped_before_they_are_interpolated(full: float) -> None:
    wheels = sample()
    counted, nothing = (wheels.angle + full - 3.0) % full, np.full(len(wheels.time_s), np.nan)
    time_s = np.concatenate([wheels.time_s, wheels.time_s + 0.007])
    apart = np.concatenate([np.column_stack([counted[:, 0], nothing]), np.column_stack([nothing, counted[:, 1]])])
    order = np.argsort(time_s)
    found = clean_wheels(time_s[order], apart[order], 4096, "/joint_states")
    assert not found.broken.any()
    travelled = np.ptp(wheels.angle[:, 0])
    assert np.ptp(found.angle[:, 0]) == pytest.approx(travelled, abs=0.1)


@pytest.mark.parametrize("every", [1, 3, 7, 20, 40])
def test_another_program_that_publishes_the_same_joints_is_refused_however_seldom(every: int) -> None:
    wheels = sample((2.0,) * 6)
    rows = np.arange(3, len(wheels.time_s), every)
    time_s = np.concatenate([wheels.time_s, wheels.time_s[rows] + 0.01])
    angle = np.concatenate([wheels.angle, np.zeros((len(rows), 2))])
    with pytest.raises(InputError, match=r"/joint_states at .* more than one program published"):
        clean_wheels(time_s, angle, 4096, "/joint_states")


def test_a_clock_that_is_set_back_and_too_few_messages_are_refused() -> None:
    wheels = sample()
    for back_s in (0.712, 1.013):
        time_s = wheels.time_s - back_s * (wheels.time_s > 2.0)
        with pytest.raises(InputError, match="or the recorder's clock was set back"):
            clean_wheels(time_s, wheels.angle, 4096, "/joint_states")
    with pytest.raises(InputError, match="/joint_states has 3 messages with both wheels; a drive has at least 20"):
        clean_wheels(np.arange(3.0), np.zeros((3, 2)), 4096, "/joint_states")
