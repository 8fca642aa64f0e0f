import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from sim.geometry import compose, integrate_wheels, rotation, wrap_angle

angles = st.floats(-50.0, 50.0)


@given(angles)
def test_wrapping_keeps_the_direction(angle):
    wrapped = wrap_angle(angle)
    assert -np.pi <= wrapped < np.pi
    np.testing.assert_allclose([np.cos(wrapped), np.sin(wrapped)], [np.cos(angle), np.sin(angle)], atol=1e-9)


@given(angles, angles)
def test_rotations_compose(a, b):
    np.testing.assert_allclose(rotation(a) @ rotation(b), rotation(a + b), atol=1e-9)


@given(st.lists(st.floats(-3.0, 3.0), min_size=9, max_size=9))
def test_composition_is_associative(numbers):
    a, b, c = np.array(numbers).reshape(3, 3)
    left, right = compose(compose(a, b), c), compose(a, compose(b, c))
    np.testing.assert_allclose(left[:2], right[:2], atol=1e-9)
    assert abs(wrap_angle(left[2] - right[2])) < 1e-9


def test_equal_wheels_drive_straight():
    way = np.array([[0.0, 0.0], [1.0, 1.0], [3.0, 3.0]])
    np.testing.assert_allclose(integrate_wheels(way, 0.16), [[0, 0, 0], [1, 0, 0], [3, 0, 0]], atol=1e-12)


def test_a_circle_closes():
    track, radius, steps = 0.16, 0.5, 37
    angle = np.linspace(0.0, 2 * np.pi, steps)
    way = np.stack([angle * (radius - track / 2), angle * (radius + track / 2)], axis=1)
    path = integrate_wheels(way, track)
    np.testing.assert_allclose(path[-1], [0.0, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(path[:, :2] - [0.0, radius], axis=1), radius, atol=1e-9)


def test_steps_agree_with_composition():
    rng = np.random.default_rng(0)
    way = np.cumsum(rng.uniform(-0.1, 0.2, (40, 2)), axis=0)
    path = integrate_wheels(way, 0.16)
    pose = np.zeros(3)
    for (left, right), expected in zip(np.diff(way, axis=0), path[1:], strict=True):
        # many small straight steps approximate the arc
        small = np.array([(left + right) / 2, 0.0, (right - left) / 0.16]) / 2000
        for _ in range(2000):
            pose = compose(pose, small)
        np.testing.assert_allclose(pose[:2], expected[:2], atol=1e-3)
