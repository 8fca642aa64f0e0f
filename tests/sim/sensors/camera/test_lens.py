"""Laws of the fisheye lens."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.errors import InputError
from sim.sensors.camera.lens import (
    Lens,
    make_lens,
    polar_rays,
    project_polar,
    project_round,
    round_rays,
    unproject_polar,
    unproject_round,
)
from sim.settings import CameraSettings

# Coefficients with which the radius grows all the way to 95 degrees: slope at least 1 - 3 (.05) 2.75 - 5 (.005) 7.6 > 0
lenses = st.builds(
    Lens,
    half_angle=st.floats(np.radians(30), np.radians(95)),
    k=st.tuples(st.floats(-0.05, 0.2), st.floats(-0.005, 0.05), st.floats(0, 0.01), st.floats(0, 0.001)),
)
fractions = st.floats(0.001, 0.999)
turns = st.floats(0.0, 2 * np.pi, exclude_max=True)


def direction(lens: Lens, fraction: float, azimuth: float) -> np.ndarray:
    theta = fraction * lens.half_angle
    return np.array([np.sin(theta) * np.cos(azimuth), np.sin(theta) * np.sin(azimuth), np.cos(theta)])


@given(lenses, fractions, turns)
def test_unprojecting_undoes_projecting(lens: Lens, fraction: float, azimuth: float) -> None:
    ray = direction(lens, fraction, azimuth)
    np.testing.assert_allclose(unproject_polar(lens, project_polar(lens, ray, 32, 128), 32, 128), ray, atol=1e-10)
    np.testing.assert_allclose(unproject_round(lens, project_round(lens, ray, 200), 200), ray, atol=1e-10)


@given(lenses, st.floats(0.0, 31.49), st.floats(-0.49, 127.49))
def test_projecting_undoes_unprojecting(lens: Lens, row: float, column: float) -> None:
    pixel = np.array([row, column])
    np.testing.assert_allclose(project_polar(lens, unproject_polar(lens, pixel, 32, 128), 32, 128), pixel, atol=1e-8)


@given(lenses, fractions, fractions)
def test_the_radius_grows_with_the_angle_and_ends_at_the_rim(lens: Lens, one: float, other: float) -> None:
    near, far = sorted([one, other])
    radius = lens.radius(np.array([0.0, near * lens.half_angle, far * lens.half_angle, lens.half_angle]))
    assert np.all(np.diff(radius) >= 0)
    assert radius[0] == 0.0
    assert radius[-1] == pytest.approx(1.0)


@given(lenses, fractions, turns, turns)
def test_turning_about_the_axis_moves_columns_only(lens: Lens, fraction: float, azimuth: float, turn: float) -> None:
    before = project_polar(lens, direction(lens, fraction, azimuth), 32, 128)
    after = project_polar(lens, direction(lens, fraction, azimuth + turn), 32, 128)
    assert after[0] == pytest.approx(before[0], abs=1e-9)
    apart = (after[1] - before[1] - turn * 128 / (2 * np.pi)) % 128
    assert min(apart, 128 - apart) < 1e-6


@given(lenses, fractions, turns)
def test_the_polynomial_is_opencvs_fisheye_model(lens: Lens, fraction: float, azimuth: float) -> None:
    ray = direction(Lens(min(lens.half_angle, np.radians(80)), lens.k), fraction, azimuth)
    focal = 100.0 * lens.radius(np.array(1.0)) / (1.0 + sum(lens.k))  # makes OpenCV's rim radius 100 pixels
    camera = np.array([[focal, 0, 0], [0, focal, 0], [0, 0, 1.0]])
    place, _ = cv2.fisheye.projectPoints(ray.reshape(1, 1, 3), np.zeros(3), np.zeros(3), camera, np.array(lens.k))
    row, column = project_round(lens, ray, 200) - 99.5
    np.testing.assert_allclose(place.ravel(), [-row, column], atol=1e-4)


def test_ring_zero_is_nearest_the_zenith_and_column_zero_half_a_sector_left_of_forward() -> None:
    rays = polar_rays(make_lens(CameraSettings()), 32, 128)
    theta = np.arccos(rays[..., 2])
    np.testing.assert_allclose(theta[:, 0], np.radians(95) * (np.arange(32) + 0.5) / 32)
    np.testing.assert_allclose(
        np.arctan2(rays[20, :3, 1], rays[20, :3, 0]), 2 * np.pi / 128 * np.array([0.5, 1.5, 2.5])
    )
    assert rays[-1, 0, 2] < 0 < rays[-2, 0, 0]  # at 190 degrees the last ring looks below the horizon


def test_the_round_picture_has_forward_at_the_top_and_left_at_the_right() -> None:
    lens = make_lens(CameraSettings(field_of_view_deg=180))
    rays = round_rays(lens, 101)
    np.testing.assert_allclose(rays[50, 50], [0, 0, 1], atol=1e-12)
    assert rays[5, 50, 0] > 0.9
    assert rays[50, 95, 1] > 0.9
    assert np.isnan(rays[0, 0]).all()


FOLDING = (-1 / 3, 0.0, 0.0, 0.0)


def test_a_lens_whose_radius_stops_growing_is_refused() -> None:
    with pytest.raises(InputError, match=r"camera\.distortion .*up to 95 deg.*stops growing at 57\.3 deg"):
        make_lens(CameraSettings(distortion=FOLDING))
    assert make_lens(CameraSettings(distortion=FOLDING, field_of_view_deg=110)).half_angle == pytest.approx(
        np.radians(55)
    )
