"""The room as a dm_env environment: dm_env's own conformance test, and the laws it does not know."""

import sys
import unittest
from collections.abc import Iterator

import numpy as np
import pytest

pytest.importorskip("dm_control", reason="dm-control has no wheels for Python 3.13 and 3.14")

from dm_env import StepType, test_utils

from sim.environment import RoomEnvironment
from sim.errors import InputError, WorkError
from sim.robot.model import CONTROL_PERIOD_S, wheel_speeds
from sim.settings import CameraSettings, RobotSettings, SimSettings
from tests.sim.robot.test_own import EXAMPLE

SETTINGS = SimSettings(camera=CameraSettings(rings=8, sectors=32, face_px=16))


class TestConformance(test_utils.EnvironmentTestMixin, unittest.TestCase):
    """dm_env's own test, over episodes that end."""

    def make_object_under_test(self) -> RoomEnvironment:
        return RoomEnvironment(SETTINGS, np.random.default_rng(0), episode_s=0.4)


@pytest.fixture(scope="module")
def environment() -> Iterator[RoomEnvironment]:
    made = RoomEnvironment(SETTINGS, np.random.default_rng(3), episode_s=0.8)
    yield made
    made.close()


def test_an_episode_ends_after_its_time_and_is_cut_off_not_lost(environment: RoomEnvironment) -> None:
    environment.reset()
    steps = [environment.step(np.zeros(2)) for _ in range(21)]
    assert [step.step_type for step in steps] == [StepType.MID] * 19 + [StepType.LAST, StepType.FIRST]
    assert steps[19].discount == 1.0
    assert {step.reward for step in steps[:20]} == {0.0}


def test_driving_counts_ticks_forward_and_turning_counts_them_apart(environment: RoomEnvironment) -> None:
    first = environment.reset().observation
    assert np.all(np.abs(first["ticks"]) <= 1)
    for _ in range(15):
        turned = environment.step(wheel_speeds(0.0, 1.5)).observation
    left, right = turned["ticks"]
    assert left < -20 < 20 < right
    assert not np.array_equal(first["polar"], turned["polar"])


def test_dm_control_sees_the_same_state(environment: RoomEnvironment) -> None:
    environment.reset()
    environment.step(np.array([3.0, 3.0]))
    assert environment.physics.time() == pytest.approx(CONTROL_PERIOD_S)
    np.testing.assert_array_equal(
        environment.physics.named.data.xpos["robot/base"], environment.physics.data.ptr.body("robot/base").xpos
    )
    assert environment.physics.control().tolist() == [3.0, 3.0]


def test_the_same_seed_gives_the_same_bytes() -> None:
    def roll() -> list[bytes]:
        environment = RoomEnvironment(SETTINGS, np.random.default_rng(5))
        try:
            seen = [environment.reset()] + [environment.step(np.array([4.0, 5.0])) for _ in range(5)]
        finally:
            environment.close()
        return [step.observation[name].tobytes() for step in seen for name in ("polar", "ticks", "ranges")]

    assert roll() == roll()


def test_drawn_faults_a_faulty_camera_and_impossible_times_are_refused() -> None:
    wrong: list[tuple[dict, dict, str]] = [
        ({"camera_mount": {"roll_deg": 1.0}}, {}, "camera_mount must keep its default")
    ]
    for fault in ("slip_per_m", "step_noise", "dropout", "stuck_fraction"):
        wrong.append(({"encoder": {fault: 0.1}}, {}, rf"encoder\.{fault} 0\.1 must be 0 in the environment"))
    for episode_s in (0.01, np.nan, np.inf):
        wrong.append(({}, {"episode_s": episode_s}, rf"episode_s {episode_s} must be at least .* 0\.04 s, and finite"))
    for step_s in (0.0, 0.03, 0.1, np.nan, np.inf):
        wrong.append(({}, {"step_s": step_s}, rf"step_s {step_s} must be a multiple of the control period, 0\.04 s"))
    for changes, times, message in wrong:
        with pytest.raises(InputError, match=message):
            RoomEnvironment(SimSettings.model_validate(changes), np.random.default_rng(0), **times)


def test_a_long_step_is_as_many_short_ones(environment: RoomEnvironment) -> None:
    longer = RoomEnvironment(SETTINGS, np.random.default_rng(3), episode_s=0.8, step_s=0.2)
    shorter = RoomEnvironment(SETTINGS, np.random.default_rng(3), episode_s=0.8)
    try:
        longer.reset()
        shorter.reset()
        once = [longer.step(np.array([4.0, 6.0])) for _ in range(4)]
        each = [shorter.step(np.array([4.0, 6.0])) for _ in range(20)]
    finally:
        longer.close()
        shorter.close()
    assert [step.step_type for step in once] == [StepType.MID] * 3 + [StepType.LAST]
    for one, other in zip(once, each[4::5], strict=True):
        assert one.observation["ticks"].tolist() == other.observation["ticks"].tolist()
        assert np.array_equal(one.observation["polar"], other.observation["polar"])


def test_the_true_pose_and_angles_are_those_that_the_wheels_drove(environment: RoomEnvironment) -> None:
    environment.reset()
    start = environment.true_pose()
    for _ in range(15):
        environment.step(wheel_speeds(0.1, 0.0))
    end, odometry = environment.true_pose(), environment.odometry
    driven_m = environment.wheel_angle().mean() * odometry["wheel_radius_m"]
    along = np.array([np.cos(start[2]), np.sin(start[2])]) @ (end - start)[:2]
    assert along == pytest.approx(driven_m, abs=0.003)
    assert 0.03 < driven_m < 0.06
    assert environment.physics.data.qpos[:2].tolist() == end[:2].tolist()


def test_without_dm_control_the_error_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "dm_env", None)
    monkeypatch.delitem(sys.modules, "sim.environment")
    with pytest.raises(WorkError, match=r"needs dm-control, which has no wheels for this Python: use Python 3\.11"):
        __import__("sim.environment")


def test_motors_without_limits_take_any_speed() -> None:
    own = RobotSettings(mjcf=str(EXAMPLE), left_joint="left_drive", right_joint="right_drive", camera_site="eye")
    made = RoomEnvironment(SETTINGS.model_copy(update={"robot": own}), np.random.default_rng(0))
    made.action_spec().validate(np.array([3.0, -3.0]))
    made.close()
