"""Images at segments and turns: evenly spaced, shared at turns in place, none where wheels may have slipped."""

import numpy as np
import pytest

from deepgps.robot_io.logs.matching import Images, Plan, plan_recording
from deepgps.robot_io.logs.segmentation import find_path, follow
from deepgps.robot_io.logs.wheels import clean_wheels
from sim.recording.turns import check_turns
from tests.helpers.robot_log import RADIUS_M, TICK, TRACK_M

STEP_S = 0.05


def drive(*parts: tuple[float, float], rest_s: float = 0.5) -> np.ndarray:
    """Wheel angles (n, 2) of a drive in parts of a distance [m] and a turn [rad] each, with rests between."""
    rest = np.zeros((round(rest_s / STEP_S), 2))
    steps = [rest]
    for distance, turn in parts:
        count = round(max(abs(distance) / 0.2, abs(turn) / 1.5) / STEP_S)
        rim = np.array([distance - turn * TRACK_M / 2, distance + turn * TRACK_M / 2]) / count
        steps += [np.tile(rim, (count, 1)), rest]
    return np.cumsum(np.concatenate(steps), axis=0) / RADIUS_M


def plan(angle: np.ndarray, spacing_m: float = 0.1, every: int = 2, lag_s: float = 0.0) -> tuple[Plan, Images]:
    """The plan of a drive with an image at every second message of the wheels, which come late by a lag."""
    time_s = np.arange(len(angle)) * STEP_S
    wheels = clean_wheels(time_s, angle, 4096, "/joint_states")
    driven = follow(wheels, RADIUS_M, TRACK_M)
    seen = np.arange(0, len(angle), every)
    there = find_path(wheels.angle[seen], RADIUS_M, TRACK_M)
    images = Images(seen // every, time_s[seen] - lag_s, time_s[seen], wheels.angle[seen], there)
    found = plan_recording(driven, range(len(driven.motions)), images, spacing_m, 4096)
    check_turns(found.turns, len(found.observation), len(found.turn_image), found.reading[:, 0])
    return found, images


def lengths(found: Plan) -> list[float]:
    groups = [found.reading[found.reading[:, 0] == number] for number in np.unique(found.reading[:, 0])]
    return [float((rows[-1, 2:] - rows[0, 2:]).mean() * TICK * RADIUS_M) for rows in groups]


def test_images_are_spaced_and_turning_places_are_shared() -> None:
    found, images = plan(drive((1.0, 0), (0, 2.0), (0.6, 0), (0, -1.2), (0.8, 0)))
    assert lengths(found) == pytest.approx([1.0, 0.6, 0.8], abs=1e-3)
    place = images.path.travelled_m[found.observation]
    assert np.diff(place).min() > 0.03 and np.diff(place).max() < 0.125
    assert found.turns[:, 3].tolist() == [0, 0] and found.turns[:, 1].tolist() == [0, 1]
    before, after = images.path.yaw[found.observation[found.turns[:, 0]]], images.path.yaw[found.turn_image]
    np.testing.assert_allclose(after - before, [2.0, -1.2], atol=0.01)
    assert (np.diff(found.time_s) > 0).all() and found.reading[found.turns[:, 2], 1].tolist() == found.turns[
        :, 0
    ].tolist()


@pytest.mark.parametrize("lag_s", [-0.2, 0.05, 0.5])
def test_wheels_that_come_late_change_nothing(lag_s: float) -> None:
    angle = drive((1.0, 0), (0, 2.0), (0.6, 0), (0, -1.2), (0.8, 0), rest_s=0.1)
    (found, _), (late, _) = plan(angle), plan(angle, lag_s=lag_s)
    for name in ("reading", "observation", "turn_image", "turns"):
        np.testing.assert_array_equal(getattr(late, name), getattr(found, name))


def test_the_last_way_before_backing_off_is_left_out() -> None:
    found, images = plan(drive((1.0, 0), (-0.06, 0), (0, 2.0), (0.6, 0)))
    first = images.path.travelled_m[found.observation[found.reading[found.reading[:, 0] == 0, 1]]]
    assert 0.8 < first.max() <= 0.88
    assert found.turns[:, 3].tolist() == [1] and found.turns[:, 1].tolist() == [-1]


def test_after_an_arc_nothing_is_known_of_the_turn() -> None:
    found, _ = plan(drive((1.0, 0), (0.7, 1.4), (0.6, 0)))
    assert lengths(found) == pytest.approx([1.0, 0.6], abs=0.02)
    assert found.turns[:, 3].tolist() == [2]


def test_without_images_at_rest_a_turn_has_none_of_its_own() -> None:
    found, _ = plan(drive((1.0, 0), (0, 2.0), (0.6, 0), rest_s=0.05), every=5)
    assert found.turns[:, 1].tolist() == [-1] and found.turns[:, 3].tolist() == [0]


def test_a_stop_on_the_way_divides_nothing() -> None:
    found, _ = plan(drive((0.5, 0), (0.5, 0), (0, 2.0), (0.6, 0)))
    assert lengths(found) == pytest.approx([1.0, 0.6], abs=1e-3)


def test_segments_that_share_a_rest_share_no_image() -> None:
    """Slight curves that together bend too far for one segment are divided by a rest alone."""
    found, _ = plan(drive(*[(1.0, turn) for turn in (0.12, 0.12, -0.12, -0.12) * 3], rest_s=0.3))
    assert len(np.unique(found.reading[:, 0])) > 3
    assert (np.diff(found.time_s) > 0).all()
