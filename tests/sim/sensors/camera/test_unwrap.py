"""Raw fisheye images become the polar images that the renderer draws, and point where OpenCV's fisheye model says."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from sim.errors import InputError
from sim.robot.world import RoomWorld
from sim.sensors.camera.fisheye import Fisheye
from sim.sensors.camera.lens import Lens, make_lens, unproject_polar
from sim.sensors.camera.unwrap import unwrap_fisheye
from sim.settings import CameraSettings, RoomSettings, SimSettings

ROUND_PX = 480
MIDDLE = ((ROUND_PX - 1) / 2, (ROUND_PX - 1) / 2)


@pytest.fixture(scope="module", params=[0.0, -0.05], ids=["equidistant", "kannala-brandt"])
def views(request: pytest.FixtureRequest) -> list[tuple[np.ndarray, np.ndarray]]:
    """Round and polar renderings of the same camera at a few places of a furnished room."""
    camera = CameraSettings(rings=32, sectors=128, face_px=256, distortion=(request.param, 0.0, 0.0, 0.0))
    world = RoomWorld(SimSettings(room=RoomSettings(kind="bedroom", width_m=3.2, depth_m=2.8), camera=camera))
    rng = np.random.default_rng(0)
    cells = np.argwhere(world.free_space.reachable)
    seen = []
    with Fisheye(world.model, camera) as fisheye:
        for row, column in cells[rng.integers(len(cells), size=4)]:
            place = world.free_space.origin + np.array([column, row]) * world.free_space.cell_m
            world.place(np.array([*place, rng.uniform(-np.pi, np.pi)]))
            seen.append((fisheye.round(world.data, ROUND_PX), fisheye.polar(world.data)))
    return seen


def test_a_raw_image_unwraps_to_the_polar_image_of_the_renderer(views: list[tuple[np.ndarray, np.ndarray]]):
    """Measured: a mean difference of 0.21 to 0.24 of 255 and at most 7; turned by one sector, 6.4 and more."""
    for raw, polar in views:
        found = unwrap_fisheye(raw, MIDDLE, ROUND_PX / 2)
        assert measure(found, polar) < 0.4
        assert np.abs(found.astype(int) - polar).max() <= 14
        assert measure(np.roll(found, 1, axis=1), polar) > 4.0
        assert measure(found[:, ::-1], polar) > 15.0


def test_several_images_are_unwrapped_as_each_alone(views: list[tuple[np.ndarray, np.ndarray]]):
    raw = np.stack([raw for raw, _ in views])
    together = unwrap_fisheye(raw, MIDDLE, ROUND_PX / 2)
    assert np.array_equal(together, [unwrap_fisheye(one, MIDDLE, ROUND_PX / 2) for one in raw])


def test_a_camera_that_is_mounted_turned_sees_the_same(views: list[tuple[np.ndarray, np.ndarray]]):
    raw, _ = views[0]
    straight = unwrap_fisheye(raw, MIDDLE, ROUND_PX / 2)
    turned = np.rot90(raw, -1)  # clockwise: what was at the top is at the right
    assert np.array_equal(unwrap_fisheye(turned, MIDDLE, ROUND_PX / 2, forward_deg=90.0), straight)


def test_two_lenses_give_the_polar_image_of_the_second(views: list[tuple[np.ndarray, np.ndarray]]):
    raw, _ = views[0]
    lens = make_lens(CameraSettings(field_of_view_deg=190))
    narrow = replace(lens, half_angle=lens.half_angle / 2)
    half = unwrap_fisheye(raw, MIDDLE, ROUND_PX / 2, lens=lens, polar_lens=narrow)
    inner = unwrap_fisheye(raw, MIDDLE, ROUND_PX / 4)
    assert measure(half, inner) < 0.5  # of equidistant lenses, half the angle is half the radius
    wide = unwrap_fisheye(raw, MIDDLE, ROUND_PX / 2, lens=narrow, polar_lens=lens)
    assert not wide[16:].any()
    assert wide[:15].any()


def test_directions_are_those_of_opencv_s_fisheye_camera():
    """A dot where cv2.fisheye projects a direction appears in the ring and sector of that direction."""
    k = (-0.02, 0.01, -0.003, 0.0005)
    lens, focal_px, centre = Lens(np.radians(92.0), k), 130.0, (231.4, 207.9)
    t = lens.half_angle
    radius_px = focal_px * t * (1 + k[0] * t**2 + k[1] * t**4 + k[2] * t**6 + k[3] * t**8)
    for ring, sector in ((3, 0), (10, 40), (20, 77), (30, 127)):
        x, y, z = unproject_polar(lens, np.array([ring, sector]), 32, 128)
        # OpenCV's camera looks along z with y down; this one looks up, with the robot's forward axis at the top
        points = np.array([[[y, -x, z]]]) / z
        camera = np.array([[focal_px, 0.0, centre[0]], [0.0, focal_px, centre[1]], [0.0, 0.0, 1.0]])
        pixel, _ = cv2.fisheye.projectPoints(points, np.zeros(3), np.zeros(3), camera, np.array(k))
        image = np.zeros((420, 460, 3), np.uint8)
        cv2.circle(image, np.rint(pixel[0, 0]).astype(int).tolist(), 2, (255, 255, 255), -1)
        polar = unwrap_fisheye(image, centre, radius_px)
        assert np.unravel_index(polar[..., 0].argmax(), (32, 128)) == (ring, sector)


def test_wrong_input_is_refused():
    black = np.zeros((10, 10, 3), np.uint8)
    for images, centre, radius_px, forward_deg, message in (
        (black[..., 0], (5, 5), 4, 0.0, r"images \(10, 10\) uint8: must be"),
        (np.zeros((10, 10, 3)), (5, 5), 4, 0.0, r"images \(10, 10, 3\) float64: must be"),
        (np.zeros((10, 20, 3), np.uint8), (20, 5), 4, 0.0, r"centre \(20, 5\): must be column and row"),
        (black, (np.nan, 5), 4, 0.0, r"centre \(nan, 5\)"),
        (black, (5, 5), 0.0, 0.0, "radius_px 0.0: must be from 1"),
        *((black, (5, 5), 4, deg, f"forward_deg {deg}: must be from -360 to 360") for deg in (np.nan, np.inf, 360.1)),
    ):
        with pytest.raises(InputError, match=message):
            unwrap_fisheye(images, centre, radius_px, forward_deg=forward_deg)


def measure(one: np.ndarray, other: np.ndarray) -> float:
    """Mean absolute difference of two images, of 255."""
    return float(np.abs(one.astype(int) - other).mean())
