"""Messages: joints by their names, quaternions of any length give the yaw, and those of none give no pose."""

import math
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deepgps.robot_io.logs.messages import JointLog, OdometryLog, PoseLog, read_yaw
from deepgps.robot_io.logs.robot_config import WheelConfig
from deepgps.robot_io.logs.sample import Sample
from sim.errors import InputError
from sim.geometry import wrap
from tests.helpers.robot_log import CONFIG, JOINTS


def turn(yaw: float, lean: float, length: float) -> SimpleNamespace:
    """A quaternion message of a length: a yaw, then a lean about the robot's front."""
    half, side = yaw / 2, lean / 2
    axes = {"w": math.cos(half) * math.cos(side), "x": math.cos(half) * math.sin(side)}
    axes |= {"y": math.sin(half) * math.sin(side), "z": math.sin(half) * math.cos(side)}
    return SimpleNamespace(**{name: length * value for name, value in axes.items()})


@given(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(1e-5, 1e200))
def test_a_quaternion_of_any_length_gives_the_yaw(yaw: float, lean: float, length: float) -> None:
    assert abs(wrap(read_yaw(turn(yaw, lean, length)) - yaw)) < 1e-6
    for nothing in (0.0, 1e-9, math.nan, math.inf):
        assert math.isnan(read_yaw(turn(0.5, 0.0, nothing)))


def read_joints(*messages: tuple[list[str], list[float]], **wheels: Any) -> JointLog:
    read = JointLog(WheelConfig.model_validate({**CONFIG["wheels"], "left": "l", "right": "r", **wheels}))
    for number, (names, angles) in enumerate(messages):
        read.take(Sample("/j", number, number, partial(SimpleNamespace, name=names, position=angles)))
    read.check()
    return read


def test_joints_are_found_in_any_order_and_may_be_missing() -> None:
    known = (["l", "r"], [1.0, 2.0]), (["r", "l"], [2.0, 1.0]), (["arm", "l", "r"], [9.0, 1.0, 2.0])
    read = read_joints(*known, (["l", "r"], [1.0]), (["arm"], [3.0]), (["l", "r"], []))
    np.testing.assert_array_equal(read.angle, [[1.0, 2.0]] * 3 + [[1.0, np.nan]])
    assert read.without == 2 and read.list_notes() == [
        "/joint_states: 2 messages are left out: they hold neither wheel"
    ]
    for backward, signs in (("left", (-1, 1)), ("right", (1, -1)), ("both", (-1, -1))):
        np.testing.assert_array_equal(read_joints(*known, backward=backward).angle, [[1.0, 2.0] * np.array(signs)] * 3)
    for message, said in (
        (
            (["l", "r"], []),
            "/joint_states: positions are empty or nan in all messages, and the wheels' angles are needed",
        ),
        ((["l", "r"], [np.nan, np.nan]), "/joint_states: positions are empty or nan in all messages"),
        ((["l", "x"], [1.0, 2.0]), "/joint_states has no position of a joint 'r'; its joints are l, x"),
    ):
        with pytest.raises(InputError, match=said):
            read_joints(message)
    for name, turned in (("r", [0.5, 2.0]), ("l", [1.0, 0.5])):
        with pytest.raises(InputError, match=f"the joint '{name}' never turns, and the other one does"):
            read_joints(known[0], (["l", "r"], turned))


@pytest.mark.parametrize("jump_m", [0.0, 0.01])
def test_an_odometry_that_is_corrected_aside_is_noted(jump_m: float) -> None:
    """A drive on a curve, of 1 cm and 0.01 rad a message; each twentieth, other sensors move it aside."""
    wheels, at, yaw = OdometryLog(WheelConfig.model_validate(CONFIG["wheels"])), 0j, 0.0
    for number in range(100):
        at += 0.01 * np.exp(1j * (yaw + 0.005)) + 1j * np.exp(1j * yaw) * jump_m * (number % 20 == 7)
        yaw += 0.01
        position = SimpleNamespace(x=at.real, y=at.imag)
        pose = SimpleNamespace(position=position, orientation=turn(yaw, 0.0, 1.0))
        wheels.take(Sample("/odom", number, number, partial(SimpleNamespace, pose=SimpleNamespace(pose=pose))))
    notes = [note for note in wheels.list_notes() if "aside" in note]
    assert len(notes) == (jump_m > 0.0) and all("jumps aside 5 times, by up to 1.0 cm" in note for note in notes)


def test_poses_and_odometries_without_an_orientation_are_left_out_or_refused() -> None:
    config = WheelConfig.model_validate(CONFIG["wheels"])
    for every in (3, 1):
        poses, wheels = PoseLog("/pose"), OdometryLog(config)
        for number in range(10):
            turned = turn(0.3, 0.0, 0.0 if number % every == 0 else 2.0)
            pose = SimpleNamespace(position=SimpleNamespace(x=1.0, y=2.0), orientation=turned)
            for one in (poses, wheels):
                one.take(Sample("/p", number, number, partial(SimpleNamespace, pose=SimpleNamespace(pose=pose))))
        assert poses.without == wheels.without == math.ceil(10 / every)
        assert len(poses.pose) == len(wheels.angle) == 10 - poses.without
    for one, topic in ((poses, "/pose"), (wheels, JOINTS)):
        with pytest.raises(
            InputError, match=rf"{topic} holds no message that can be used: 10 are left out: .* quaternion is 0"
        ):
            one.check()
