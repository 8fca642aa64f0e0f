"""Poses of logs: quaternions of any length give the yaw, and those of none give no pose."""

import math
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deepgps.robot_io.logs.containers import open_log
from deepgps.robot_io.logs.messages import open_poses, open_wheels, read_yaw
from deepgps.robot_io.logs.robot_config import WheelConfig
from deepgps.terminal.progress import ignore
from sim.errors import InputError
from sim.geometry import wrap
from tests.helpers.robot_log import CONFIG, JOINTS, TRUTH, Note, change, make_notes, set_fields, write_log


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


def without_orientation(every: int) -> Callable[[int, Note], Note]:
    return lambda number, note: set_fields(note, length=0.0) if number % every == 0 else note


def test_poses_without_an_orientation_are_left_out(tmp_path: Path) -> None:
    notes = make_notes("image/jpeg")
    for every in (3, 1):
        log = write_log(tmp_path / f"log{every}", change(notes, TRUTH, without_orientation(every)), "mcap_lz4")
        with open_log(log) as opened:
            poses = open_poses(opened, TRUTH)
            opened.feed({TRUTH: poses.take}, ignore)
        count = sum(note.topic == TRUTH for note in notes)
        assert poses.without == math.ceil(count / every) and len(poses.pose) == count - poses.without
    with pytest.raises(InputError, match=rf"pose.topic {TRUTH} holds no pose: in {count} messages .* quaternion is 0"):
        poses.check()


def test_an_odometry_without_orientations_is_refused(tmp_path: Path) -> None:
    notes = change(make_notes("image/jpeg", odometry=True), JOINTS, without_orientation(1))
    config = WheelConfig.model_validate(CONFIG["wheels"])
    with open_log(write_log(tmp_path / "log", notes, "mcap_lz4")) as opened:
        wheels = open_wheels(opened, config)
        opened.feed({JOINTS: wheels.take}, ignore)
    assert not np.isfinite(wheels.angle).any()
    with pytest.raises(InputError, match=rf"{JOINTS} holds no message of wheels: in \d+ messages .* quaternion is 0"):
        wheels.check()
