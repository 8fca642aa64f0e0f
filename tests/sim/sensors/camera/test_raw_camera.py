"""Raw images to polar images by a calibration: the same as by circles where the lens is one, right for every model."""

import cv2
import numpy as np
import pytest

from sim.errors import InputError
from sim.sensors.camera.lens import Lens
from sim.sensors.camera.unwrap import RawCamera, Unwrapping, check_camera, unwrap_fisheye

HALF = np.radians(85.0)
SIZE, CENTRE = (160, 120), (83.0, 57.0)
BENT_LENSES = {
    "equidistant": (0.02, -0.01, 0.003, -0.001),
    "plumb_bob": (-0.2, 0.03, 0.001, -0.002, 0.0),
    "omni": (1.7, -0.05, 0.19, -0.0017, 0.0014),
    "rational_polynomial": (0.1, 0.02, 0.0, 0.001, 0.0, 0.2, 0.05, 0.01),
}


@pytest.fixture(scope="module")
def image() -> np.ndarray:
    rng = np.random.default_rng(1)
    return cv2.GaussianBlur(rng.integers(0, 255, (SIZE[1], SIZE[0], 3)).astype(np.uint8), (0, 0), 2.0)


def equidistant(focal: float = 57.0 / HALF) -> RawCamera:
    return RawCamera("equidistant", SIZE, (focal, focal), CENTRE, (0.0, 0.0, 0.0, 0.0))


@pytest.mark.parametrize("forward_deg", [0.0, 33.0, -120.0])
def test_an_equidistant_lens_is_unwrapped_by_its_circle(forward_deg: float, image: np.ndarray) -> None:
    wanted = unwrap_fisheye(image, CENTRE, 57.0, 16, 64, forward_deg)
    found = Unwrapping(equidistant(), Lens(HALF), 16, 64, forward_deg)(image)
    assert np.abs(found.astype(int) - wanted).max() <= 1


def test_a_mirror_image_gives_the_same(image: np.ndarray) -> None:
    camera = equidistant()
    wanted = Unwrapping(camera, Lens(HALF), 16, 64, 20.0)(image)
    mirror = RawCamera("equidistant", SIZE, camera.focal, (SIZE[0] - 1 - CENTRE[0], CENTRE[1]), camera.coefficients)
    found = Unwrapping(mirror, Lens(HALF), 16, 64, -20.0, mirrored=True)(np.ascontiguousarray(image[:, ::-1]))
    assert np.abs(found.astype(int) - wanted).max() <= 1


@pytest.mark.parametrize("model", BENT_LENSES)
def test_projection_is_that_of_opencv(model: str) -> None:
    camera = RawCamera(model, SIZE, (70.0, 75.0), CENTRE, BENT_LENSES[model])
    theta, azimuth = np.meshgrid(np.linspace(0.01, 0.9, 20), np.linspace(-3, 3, 15))
    rays = np.stack([np.sin(theta) * np.cos(azimuth), np.sin(theta) * np.sin(azimuth), np.cos(theta)], axis=-1)
    matrix = np.array([[70.0, 0, CENTRE[0]], [0, 75.0, CENTRE[1]], [0, 0, 1]])
    project = cv2.fisheye.projectPoints if model == "equidistant" else cv2.projectPoints
    none, distortion = np.zeros((3, 1)), np.array(BENT_LENSES[model])
    if model == "omni":  # seen from a point behind the centre of a sphere, by a pinhole
        rays, distortion = rays + [0.0, 0.0, distortion[0]], distortion[1:]
    wanted, _ = project(rays.reshape(-1, 1, 3), none, none, matrix, distortion)
    found = np.stack(camera.project(theta, azimuth), axis=-1)
    np.testing.assert_allclose(found.reshape(-1, 2), wanted.reshape(-1, 2), atol=1e-6)


@pytest.mark.parametrize("model", ["plumb_bob", "equidistant"])
def test_a_distorted_image_shows_the_same_as_one_without_distortion(model: str) -> None:
    """A world of colours by direction, seen through two lenses, gives one polar image."""
    half = np.radians(40.0)
    straight = RawCamera("equidistant", (400, 400), (250.0, 250.0), (199.5, 199.5), (0.0,) * 4)
    bent = RawCamera(model, (400, 400), (240.0, 250.0), (190.0, 205.0), BENT_LENSES[model])
    polar = [Unwrapping(camera, Lens(half), 16, 64)(paint(camera)) for camera in (straight, bent)]
    assert np.abs(polar[0].astype(int) - polar[1]).max() <= 3


def paint(camera: RawCamera) -> np.ndarray:
    """The image of a world whose colour is a smooth function of direction, found by inverting the projection."""
    theta, azimuth = np.meshgrid(np.linspace(0, 1.2, 600), np.linspace(0, 2 * np.pi, 1200, endpoint=False))
    column, row = camera.project(theta, azimuth)
    x, y = theta * np.cos(azimuth), theta * np.sin(azimuth)
    colour = np.stack([120 + 100 * np.sin(2 * x), 120 + 100 * np.cos(3 * y), 120 + 90 * np.sin(2 * x + y)], axis=-1)
    image, count = np.zeros((400, 400, 3)), np.zeros((400, 400, 1))
    inside = (column > 0) & (column < 399) & (row > 0) & (row < 399)
    at = np.rint(row[inside]).astype(int), np.rint(column[inside]).astype(int)
    np.add.at(image, at, colour[inside])
    np.add.at(count, at, 1.0)
    return (image / np.maximum(count, 1)).astype(np.uint8)


def test_the_largest_circle_in_the_image_is_found() -> None:
    assert equidistant().find_half_angle() == pytest.approx(57.5 / 57.0 * HALF, abs=0.003)
    assert equidistant().find_half_angle(circle_px=40.0) == pytest.approx(40.0 / 57.0 * HALF, abs=0.003)
    folding = RawCamera("equidistant", (4000, 4000), (50.0, 50.0), (2000.0, 2000.0), (-0.2, 0.0, 0.0, 0.0))
    assert folding.find_half_angle() == pytest.approx((1 / 0.6) ** 0.5, abs=0.003)  # 1 - 3 k t^2 = 0


def test_impossible_calibrations_and_images_are_refused(image: np.ndarray) -> None:
    for camera, message in (
        (RawCamera("eucm", SIZE, (50.0, 50.0), CENTRE, ()), "distortion model 'eucm': must be equidistant"),
        (RawCamera("equidistant", SIZE, (0.0, 50.0), CENTRE, (0.0,) * 4), "must be finite, and positive"),
        (RawCamera("equidistant", SIZE, (50.0, 50.0), CENTRE, (np.nan,) * 4), "coefficients .*nan.*: must be finite"),
        (RawCamera("equidistant", SIZE, (50.0, 50.0), (200.0, 3.0), (0.0,) * 4), "centre 200, 3: must be in the image"),
    ):
        with pytest.raises(InputError, match=message):
            check_camera(camera)
    with pytest.raises(InputError, match="image of 120 x 160 px: the calibration is for 160 x 120 px"):
        Unwrapping(equidistant(), Lens(HALF), 16, 64)(image.transpose(1, 0, 2))
