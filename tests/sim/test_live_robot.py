"""A robot for a controller from outside: it continues exactly, and its sensors have the faults that are set."""

import numpy as np
import pytest

from sim.live_robot import LiveRobot
from sim.sensors.encoder import count_ticks
from sim.settings import EncoderSettings, ImageFaultSettings, SimSettings


def make_robot(settings: SimSettings, slip_per_m: float = 0.0, read_noise: float = 0.0) -> LiveRobot:
    """A robot at its room's start."""
    faults = {
        "encoder": EncoderSettings(slip_per_m=slip_per_m),
        "image_faults": ImageFaultSettings(read_noise=read_noise),
    }
    robot = LiveRobot(settings.model_copy(update=faults))
    robot.begin(np.random.default_rng(0))
    robot.put(np.array((*robot.free_space.start, 0.5)))
    return robot


def drive(robot: LiveRobot, steps: int = 15) -> list[np.ndarray]:
    """What it senses, and where it is, after some steps."""
    for _ in range(steps):
        robot.drive(0.1, 0.4)
    return [robot.ticks(), robot.image(), robot.pose(), np.array([robot.clear_m(1.0), robot.clear_m(1.0, 0.7)])]


def test_a_robot_continues_exactly_from_another(small_settings: SimSettings):
    robot = make_robot(small_settings, slip_per_m=0.05, read_noise=0.02)
    drive(robot)
    other, third = (make_robot(small_settings, slip_per_m=0.05, read_noise=0.02) for _ in range(2))
    for one in (other, third):
        one.unpack(robot.pack())
    robot.begin(np.random.default_rng(1))
    other.begin(np.random.default_rng(1))
    seen = drive(robot)
    assert all(np.array_equal(one, two) for one, two in zip(seen, drive(other), strict=True))
    third.begin(np.random.default_rng(2))
    again = drive(third)
    assert not np.array_equal(again[0], seen[0]) and not np.array_equal(again[1], seen[1])  # noise of its own
    assert np.array_equal(again[2], seen[2])


def test_wheels_without_faults_count_what_the_joints_turn_and_a_carried_robot_counts_nothing(
    small_settings: SimSettings,
):
    robot = make_robot(small_settings)
    ticks, image, pose, _ = drive(robot)
    assert np.array_equal(ticks, count_ticks(robot.wheel_angle(), EncoderSettings()))
    assert ticks[1] > ticks[0] > 0 and pose[2] > 0.5 and image.dtype == np.uint8
    robot.put(np.array((*robot.free_space.start, 0.5)))
    assert np.array_equal(robot.ticks(), ticks)
    drive(robot)
    assert robot.ticks() == pytest.approx(2 * ticks, abs=2)


def test_a_robot_knows_where_it_fits(small_settings: SimSettings):
    robot = make_robot(small_settings)
    assert robot.is_free(robot.free_space.start) and not robot.is_free(np.array([9.0, 9.0]))
    assert not robot.bumped() and robot.odometry["slip_per_m"] == 0.0
