"""A traced drive is the drive of the recording, and what is observed in it agrees with the physics; two clocks."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.geometry import planar_pose
from sim.recording.chunks import drive_chunk, find_least
from sim.rng import stream
from sim.robot.model import TRACK_M, WHEEL_RADIUS_M
from sim.robot.world import RoomWorld
from sim.robot_log.log import JOINT_S, PICTURE_S, find_wheels
from sim.robot_log.observe import (
    DRIFT,
    EPOCH_NS,
    OFFSET_S,
    RECORDER,
    Clock,
    Trace,
    TracedWorld,
    make_base_clock,
    trace_drive,
)
from sim.settings import DriveSettings, SimSettings
from tests.helpers.small_room import furnished

SETTINGS = SimSettings(drive=DriveSettings(samples=300))
BASE = make_base_clock(0)


def trace(settings: SimSettings, samples: int = 0) -> tuple[TracedWorld, Trace, np.ndarray]:
    world = TracedWorld(settings, furnished())
    return world, *trace_drive(world, 0, samples, lambda *_: None)


@pytest.fixture(scope="module")
def drive() -> tuple[TracedWorld, Trace, np.ndarray]:
    return trace(SETTINGS)


def test_tracing_changes_no_bit_of_the_drive_and_keeps_every_step(drive):
    world, rng, chunk, angle = RoomWorld(SETTINGS, furnished()), stream(0, "drive"), None, []
    _, found, wheel_angle = drive
    kept = {state.tobytes() for state in found.state}
    while chunk is None or chunk["observations"] < SETTINGS.drive.samples:
        begun = chunk is None  # the first sample is before all steps
        chunk = drive_chunk(world, SETTINGS, rng, chunk)
        angle.append(chunk["wheel_angle"])
        assert all(state.tobytes() in kept for state in chunk["state"][begun:])
    assert len(angle) > 1
    np.testing.assert_array_equal(wheel_angle, np.concatenate(angle))
    np.testing.assert_allclose(np.diff(found.time), 0.005, atol=1e-9)


def test_a_drive_that_is_done_early_is_traced_to_its_end():
    until = {"headings": "map", "samples": 5000, "until": {"unseen": 0.5}}
    settings = SimSettings.model_validate({"drive": until})
    _, found, wheel_angle = trace(settings)
    world, rng = RoomWorld(settings, furnished()), stream(0, "drive")
    chunk = drive_chunk(world, settings, rng, None)
    assert chunk["unseen"][0] <= 0.5 and len(found.time) > len(wheel_angle)
    np.testing.assert_array_equal(wheel_angle, chunk["wheel_angle"])
    more = drive_chunk(world, settings, rng, chunk, find_least(int(chunk["observations"])))
    _, _, further = trace(settings, int(more["observations"]))
    np.testing.assert_array_equal(further, np.concatenate([wheel_angle, more["wheel_angle"]]))


@pytest.mark.parametrize("clock", [RECORDER, BASE])
def test_everything_is_read_at_its_rate_from_the_beginning_to_the_end(drive, clock):
    _, found, _ = drive
    for period_s in (JOINT_S, PICTURE_S):
        time, state = found.find(clock, period_s)
        np.testing.assert_allclose(np.diff(time), period_s, atol=0.0051)
        assert time[0] < 2 * period_s
        assert time[-1] > found.time[-1] - 2 * period_s
        np.testing.assert_array_equal(state, found.state[np.isin(found.time, time)])


def test_wheels_and_truth_tell_the_same_way(drive):
    """Odometry by the ideal wheel angles follows the true heading in turns, except for slip and contacts."""
    world, found, _ = drive
    _, state = found.find(BASE, JOINT_S)
    wheels = state[:, find_wheels(world)]
    turned = (wheels[:, 1] - wheels[:, 0]) * WHEEL_RADIUS_M / TRACK_M
    assert np.median(np.abs(np.diff(turned) - np.diff(np.unwrap(planar_pose(state)[:, 2])))) < 0.002


@given(st.builds(Clock, st.floats(-5, 5), st.floats(-1e-3, 1e-3)))
def test_a_timer_s_period_is_exact_by_its_own_clock(clock):
    read = clock.read(clock.fire(0.1, 100.0)) - clock.read(np.zeros(1))
    np.testing.assert_allclose(read, 1e8 * np.arange(1, len(read) + 1), atol=2)


def test_the_computers_disagree_within_the_limits_and_the_recorder_reads_the_simulation_s_time():
    for seed in range(20):
        clock = make_base_clock(seed)
        assert OFFSET_S[0] <= abs(clock.offset_s) <= OFFSET_S[1]
        assert DRIFT[0] <= abs(clock.drift) <= DRIFT[1]
        assert clock == make_base_clock(seed) != make_base_clock(seed + 1)
        apart_s = (clock.read(np.array([0.0, 1000.0])) - RECORDER.read(np.array([0.0, 1000.0]))) / 1e9
        assert apart_s[1] - apart_s[0] == pytest.approx(1000 * clock.drift, abs=1e-6)
    assert RECORDER.read(np.array([1.5])) == EPOCH_NS + 1_500_000_000
