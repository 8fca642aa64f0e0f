"""The errors of images by odometry: found after any way, with turns known well or badly, and at any rate of images."""

import numpy as np
import pytest

from deepgps.tracking.fix import (
    MAX_COMPARISON_M,
    TRAIL_SPACING_M,
    Fix,
    Trail,
    add_image,
    begin_trail,
    break_off,
    extend,
    find_factor,
)
from deepgps.tracking.motion import make_motion

STATED_M = 0.01


def drive(distance_m: float, spacing_m: float, times: float, turn_std: float = 0.0, seed: int = 0) -> Trail:
    """The trail of a drive around a room, whose images err ``times`` as much as they state."""
    rng, trail, place, yaw = np.random.default_rng(seed), begin_trail(), np.zeros(2), 0.0
    for step in range(int(distance_m / spacing_m)):
        turn = np.pi / 2 if step % round(2.0 / spacing_m) == 0 else 0.0
        yaw += turn
        place = place + spacing_m * np.array([np.cos(yaw), np.sin(yaw)])
        trail = extend(trail, make_motion(0.0, 0.0, turn, 0.0, turn_std if turn else 0.0), 1.0)
        trail = extend(trail, make_motion(spacing_m, step_std_m=1e-4), 1.0)
        seen = place + times * STATED_M * rng.standard_normal(2)
        trail = add_image(trail, Fix(seen, STATED_M))
    return trail


def test_errors_are_found_after_any_way_however_badly_turns_are_known():
    for distance_m, turn_std in ((30.0, 0.0), (30.0, 0.3), (120.0, 0.02)):
        assert find_factor(drive(distance_m, 0.08, 5.0, turn_std)) == pytest.approx(5.0, rel=0.4)


def test_errors_are_found_at_any_rate_of_images():
    for spacing_m in (0.0075, 0.08, 0.3):
        trail = drive(40.0, spacing_m, 5.0)
        assert find_factor(trail) == pytest.approx(5.0, rel=0.4)
        assert len(trail.images) <= MAX_COMPARISON_M / TRAIL_SPACING_M + 2


def test_images_that_err_as_stated_keep_their_errors():
    assert find_factor(drive(60.0, 0.08, 1.0)) == pytest.approx(1.0, rel=0.4)
    assert find_factor(drive(60.0, 0.08, 0.0)) == 1.0
    assert find_factor(begin_trail()) == 1.0


def test_a_robot_that_stands_or_was_carried_compares_nothing():
    trail = drive(30.0, 0.08, 5.0)
    for _ in range(500):
        trail = add_image(extend(trail, make_motion(0.0), 1.0), Fix(np.zeros(2), STATED_M))
    assert len(trail.images) <= MAX_COMPARISON_M / TRAIL_SPACING_M + 2
    carried = break_off(trail)
    assert not carried.images
    assert find_factor(carried) == find_factor(trail)
