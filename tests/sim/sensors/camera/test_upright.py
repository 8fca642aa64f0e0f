"""Images set upright are those of an upright camera."""

from pathlib import Path

import numpy as np
import pytest

from sim.sensors.camera.fisheye import Fisheye
from sim.sensors.camera.lens import make_lens, polar_rays
from sim.sensors.camera.mount import Upright, tilt
from sim.settings import CameraSettings
from tests.sim.sensors.camera.test_fisheye import build_room, place

CAMERA = CameraSettings(rings=64, sectors=256, face_px=128)
LENS = make_lens(CAMERA)


def paint(lean: tuple[float, float]) -> np.ndarray:
    """What a camera that leans sees of a smooth sky."""
    ray = polar_rays(LENS, CAMERA.rings, CAMERA.sectors) @ tilt(np.array(lean)).T
    waves = [ray @ (4.0 * np.array(axis)) for axis in ((1.0, 0.3, 0.2), (-0.4, 1.0, 0.1), (0.3, -0.2, 1.0))]
    return np.rint(127.0 + 100.0 * np.sin(np.stack(waves, axis=-1)))[None].astype(np.uint8)


@pytest.mark.parametrize("lean_deg", [(2.0, 0.0), (0.0, 8.0), (-5.0, 3.0), (0.0, -8.0)])
def test_a_leaning_image_of_a_smooth_sky_becomes_the_upright_one(lean_deg: tuple[float, float]):
    roll, pitch = np.radians(lean_deg)
    upright = Upright(LENS, (float(roll), float(pitch)))(paint((roll, pitch)))
    inside = CAMERA.rings - int(np.ceil(CAMERA.rings * np.hypot(*lean_deg) / 95.0)) - 2
    difference = np.abs(upright.astype(int) - paint((0.0, 0.0)))[:, :inside]
    assert difference.max() <= 2, "across the zenith and where the circle closes too"
    assert np.abs(paint((roll, pitch)).astype(int) - paint((0.0, 0.0)))[:, :inside].max() > 10


def test_a_rendered_image_of_a_leaning_camera_becomes_the_upright_one():
    model, lean = build_room(40), np.radians([5.0, -3.0])
    data = place(model, 0.7, -0.4, 0.8)
    with Fisheye(model, CAMERA) as fisheye:
        leaning, level = fisheye.polar(data, lean)[None], fisheye.polar(data)[None]
    upright = Upright(LENS, (float(lean[0]), float(lean[1])))(leaning)
    before, after = (np.abs(one.astype(float) - level)[:, :56].mean() for one in (leaning, upright))
    assert after < 0.25 * before


def test_the_order_of_the_images_in_memory_changes_nothing():
    images, upright = np.concatenate([paint((0.0, 0.0)), paint((0.1, 0.0))]), Upright(LENS, (0.1, 0.0))
    np.testing.assert_array_equal(upright(np.asfortranarray(images)), upright(images))
    turned = np.ascontiguousarray(images.transpose(0, 3, 1, 2)).transpose(0, 2, 3, 1)
    np.testing.assert_array_equal(upright(turned), upright(images))


def test_without_a_lean_images_stay_as_they_are_and_a_copy_on_disk_is_the_same(tmp_path: Path):
    images = np.concatenate([paint((0.0, 0.0)), paint((0.1, 0.0))])
    assert Upright(LENS, (0.0, 0.0))(images) is images
    upright = Upright(LENS, (0.1, 0.0))
    np.testing.assert_array_equal(upright.copy(images, tmp_path / "made"), upright(images))
    assert list((tmp_path / "made").iterdir()) == [], "the file has no name"
    assert upright.copy(images[:0], tmp_path).shape == (0, *images.shape[1:])
