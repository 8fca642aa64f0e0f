"""A traced drive is the drive of the recording, and what is observed in it agrees with the physics."""

import numpy as np
import pytest

from sim.recording.chunks import drive_chunk
from sim.recording.turns import KINDS
from sim.rng import stream
from sim.robot.model import TRACK_M, WHEEL_RADIUS_M
from sim.robot.world import RoomWorld
from sim.robot_log.observe import Observed, TracedWorld, join, make_base_clock, observe, trace_drive
from sim.settings import DriveSettings, SimSettings
from tests.helpers.small_room import furnished

ARCS = SimSettings(drive=DriveSettings(samples=300, arcs=0.5))


def trace(settings: SimSettings, seed: int = 0) -> Observed:
    world, base = TracedWorld(settings, furnished()), make_base_clock(seed)
    return join([observe(world, stretch, base) for stretch in trace_drive(world, seed)])


@pytest.fixture(scope="module")
def observed() -> Observed:
    return trace(ARCS)


def test_tracing_changes_no_bit_of_the_drive():
    settings = SimSettings(drive=DriveSettings(samples=120))
    world, traced, rng = RoomWorld(settings, furnished()), TracedWorld(settings, furnished()), stream(0, "drive")
    stretches, chunk = list(trace_drive(traced, 0)), None
    for stretch in stretches:
        chunk = drive_chunk(world, settings, rng, chunk)
        np.testing.assert_array_equal(stretch.wheel_angle, chunk["wheel_angle"])
        at_samples = {state.tobytes() for state in stretch.state}
        begun = stretch is stretches[0]  # whose first sample is before all steps
        assert all(state.tobytes() in at_samples for state in chunk["state"][begun:])
        assert stretch.observations == chunk["observations"]


def test_stretches_follow_each_other_without_a_gap():
    world = TracedWorld(ARCS, furnished())
    time = np.concatenate([stretch.time for stretch in trace_drive(world, 0)])
    np.testing.assert_allclose(np.diff(time), 0.005, atol=1e-9)


@pytest.mark.parametrize(("name", "period_s"), [("picture", 0.1), ("joint", 0.05), ("ray", 0.2), ("truth", 0.05)])
def test_everything_is_read_at_its_rate_from_the_beginning_to_the_end(observed, name, period_s):
    time = getattr(observed, f"{name}_time")
    np.testing.assert_allclose(np.diff(time), period_s, atol=0.0051)
    assert time[0] < 2 * period_s
    assert time[-1] > observed.truth_time[-1] - 2 * period_s


def test_wheels_and_truth_tell_the_same_way(observed):
    """Odometry by the ideal wheel angles follows the true heading in turns and arcs, except for slip and contacts."""
    turned = (observed.joint_angle[:, 1] - observed.joint_angle[:, 0]) * WHEEL_RADIUS_M / TRACK_M
    truly = np.interp(observed.joint_time, observed.truth_time, np.unwrap(observed.truth_pose[:, 2]))
    assert np.median(np.abs(np.diff(turned) - np.diff(truly))) < 0.002


def test_arcs_are_driven_only_where_they_are_set(observed):
    def count_arcs(seen: Observed) -> int:
        left, right = (np.diff(seen.joint_angle, axis=0) * WHEEL_RADIUS_M).T
        driven, turn = (left + right) / 2, (right - left) / TRACK_M
        bends = (np.abs(turn) > 0.5 * np.abs(driven)) & (np.abs(turn) < 4 * np.abs(driven)) & (np.abs(driven) > 0.005)
        return int((np.convolve(bends, np.ones(10)) >= 10).sum())  # half a second long

    assert count_arcs(observed) > 10
    assert count_arcs(trace(SimSettings(drive=DriveSettings(samples=300)))) == 0


def test_rays_are_the_nearest_of_the_range_finder(observed):
    world = TracedWorld(ARCS, furnished())
    at = np.searchsorted(observed.truth_time, observed.ray_time[7] - 0.01)
    world.place(observed.truth_pose[at])
    nearest = world.ranges().reshape(-1, observed.ray_m.shape[1]).min(axis=0)
    np.testing.assert_allclose(np.median(np.abs(nearest - observed.ray_m[7])), 0, atol=0.02)


def test_a_recording_knows_nothing_of_the_way_along_an_arc():
    chunk = drive_chunk(RoomWorld(ARCS, furnished()), ARCS, stream(0, "drive"), None)
    kinds = [KINDS[kind] for kind in chunk["turn_kind"]]
    assert chunk["relocated"] == 0
    assert 3 < kinds.count("relocated") < len(kinds)
    np.testing.assert_array_equal(np.diff(chunk["segment"])[np.diff(chunk["observation"]) == 0], 1)
