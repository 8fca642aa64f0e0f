"""The ROS 2 example: its logic follows REP-105, and its node says that it was not run."""

import ast
import importlib.util
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

ROS2 = Path(__file__).parents[1] / "docs" / "examples" / "ros2"
META = {"mirrored": False, "outputs": {"yaw": ""}}
SEEN_FIX = {"position": np.array([1.0, 2.0]), "yaw": np.float32(0.5), "yaw_std": np.float32(0.01)}
POSES = arrays(float, 3, elements=st.floats(-3.0, 3.0))


def load():
    """The module with the logic."""
    spec = importlib.util.spec_from_file_location("localizer", ROS2 / "localizer.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


LOGIC = load()


@given(POSES, POSES, POSES)
def test_poses_are_a_group(one: np.ndarray, two: np.ndarray, three: np.ndarray):
    compose, invert = LOGIC.compose, LOGIC.invert
    np.testing.assert_allclose(compose(one, invert(one)), 0.0, atol=1e-12)
    left, right = compose(compose(one, two), three), compose(one, compose(two, three))
    away = left - right
    away[2] = (away[2] + np.pi) % (2 * np.pi) - np.pi
    np.testing.assert_allclose(away, 0.0, atol=1e-12)


@given(POSES, POSES)
def test_odometry_in_its_frame_leads_to_the_pose_in_the_map(pose: np.ndarray, odometry: np.ndarray):
    found = {**SEEN_FIX, "position": pose[:2], "yaw": pose[2], "radius_68": np.float32(0.15)}
    fix = LOGIC.Localizer(lambda _: found, META).see(np.zeros((2, 2, 3), np.uint8), odometry)
    np.testing.assert_allclose(LOGIC.compose(fix.map_to_odom, odometry), fix.map_to_base, atol=1e-12)
    np.testing.assert_allclose(fix.map_to_base, pose)


def test_a_perfect_odometry_does_not_move_its_frame():
    frame, rng = np.array([0.3, -1.0, 2.0]), np.random.default_rng(0)
    for odometry in rng.uniform(-2.0, 2.0, (20, 3)):
        pose = LOGIC.compose(frame, odometry)
        found = {**SEEN_FIX, "position": pose[:2], "yaw": pose[2], "radius_68": np.float32(0.01)}
        fix = LOGIC.Localizer(lambda _, found=found: found, META).see(np.zeros((2, 2, 3), np.uint8), odometry)
        np.testing.assert_allclose(fix.map_to_odom, frame, atol=1e-12)


@pytest.mark.parametrize("refused", [{"accepted": np.bool_(False)}, {"yaw": np.float32(np.nan)}])
def test_an_image_that_is_refused_leaves_the_frame_where_it_is(refused: dict):
    answers = iter([{**SEEN_FIX, "radius_68": 0.01}, {**SEEN_FIX, "radius_68": 0.01, **refused}])
    localizer, image = LOGIC.Localizer(lambda _: next(answers), META), np.zeros((2, 2, 3), np.uint8)
    first = localizer.see(image, np.zeros(3))
    assert localizer.see(image, np.ones(3)) is None
    np.testing.assert_array_equal(localizer.map_to_odom, first.map_to_odom)


def test_the_covariance_is_that_of_the_radius():
    rng = np.random.default_rng(1)
    covariance = LOGIC.find_covariance({**SEEN_FIX, "radius_68": 0.15})
    assert covariance.shape == (6, 6) and covariance[5, 5] == pytest.approx(1e-4)
    assert not covariance[2:5].any() and not covariance[:, 2:5].any()
    drawn = rng.multivariate_normal(np.zeros(2), covariance[:2, :2], 20000)
    assert (np.linalg.norm(drawn, axis=1) < 0.15).mean() == pytest.approx(0.68, abs=0.01)


@pytest.mark.parametrize("meta", [{**META, "mirrored": True}, {**META, "outputs": {"position": ""}}])
def test_a_mirrored_map_or_one_without_yaw_has_no_place_for_an_odometry(meta: dict):
    with pytest.raises(ValueError, match="mirrored or gives no yaw"):
        LOGIC.Localizer(lambda _: SEEN_FIX, meta)


def test_the_node_is_short_and_says_that_it_was_not_run():
    text = (ROS2 / "locate_node.py").read_text()
    assert len(text.splitlines()) <= 60
    assert "Not run yet" in (ast.get_docstring(ast.parse(text)) or "")
    assert "sendTransform" in text and "map -> odom" in text
