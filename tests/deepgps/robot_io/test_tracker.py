"""Tracking while images come: wrong images are outvoted, and a mirrored map gives the mirrored path."""

import numpy as np
import pytest

from deepgps.positioner.pose import Poses
from deepgps.robot_io.locate import Tracker
from sim.geometry import wrap

STEP_M, TURN_RAD = 0.1, 0.06


def drive(count: int) -> np.ndarray:
    """Poses (count, 3) along an arc."""
    yaw = np.arange(count) * TURN_RAD
    middle = yaw - TURN_RAD / 2
    place = np.cumsum(STEP_M * np.stack([np.cos(middle), np.sin(middle)], axis=1), axis=0)
    return np.column_stack([place - place[0], yaw])


def track(seen: np.ndarray, odometry: np.ndarray, mirrored: bool) -> np.ndarray:
    """Tracked poses (count, 3) by images' poses (count, 3) and by distance and heading (count, 2)."""
    tracker, found = Tracker(mirrored), []
    for (x, y, yaw), (way, turned) in zip(seen, odometry, strict=True):
        single = Poses(
            np.array([x, y]),
            yaw=np.array(yaw),
            yaw_std=np.array(0.02),
            radius_68=np.array(0.03),
        )
        pose = tracker.step(single, way, turned)
        assert pose.yaw is not None and pose.radius_68 is not None and pose.radius_95 is not None
        assert pose.radius_68 < pose.radius_95
        found.append([*pose.position, pose.yaw])
    return np.array(found)


@pytest.mark.parametrize("mirrored", [False, True])
def test_wrong_images_are_outvoted(mirrored: bool):
    rng, true = np.random.default_rng(0), drive(60)
    odometry = np.column_stack([np.arange(60) * STEP_M + 7.0, true[:, 2] - 1.0])
    true = true * [1, -1, -1] if mirrored else true
    seen = true + rng.normal(size=(60, 3)) * [0.01, 0.01, 0.02]
    seen[[30, 40, 50], :2] += 1.5
    found = track(seen, odometry, mirrored)
    away = found - true
    away[:, 2] = wrap(away[:, 2])
    assert np.linalg.norm(away, axis=1)[10:].max() < 0.1


def test_without_odometry_nothing_is_known_but_the_image():
    seen = drive(10)
    found = track(seen, np.full((10, 2), np.nan), False)
    np.testing.assert_allclose(found, seen, atol=1e-6)


def test_images_at_rest_do_not_make_up_for_what_was_seen_on_the_way():
    way = np.arange(60) * STEP_M
    ahead = np.column_stack([way, np.zeros(60), np.zeros(60)])
    wrong = np.tile([2.0, 1.0, 0.5], (300, 1))
    odometry = np.column_stack([np.append(way, np.full(300, way[-1])), np.zeros(360)])
    found = track(np.concatenate([ahead, wrong]), odometry, False)
    assert np.linalg.norm(found[-1, :2] - ahead[-1, :2]) < 0.1
