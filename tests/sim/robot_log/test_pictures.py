"""The raw pictures of a log: what the camera's polar images are made from."""

import cv2
import mujoco
import numpy as np
import pytest

from sim.robot.world import RoomWorld
from sim.robot_log.observe import COLUMNS, ROWS, open_camera
from sim.sensors.camera.fisheye import Fisheye
from sim.sensors.camera.lens import make_lens
from sim.sensors.camera.unwrap import unwrap_fisheye
from sim.settings import CameraMountSettings, CameraSettings, RoomSettings, SimSettings

ROOM = RoomSettings(kind="bedroom", width_m=3.2, depth_m=2.8)
HEADINGS = (0.0, 2.0, -1.0)
LEAN = np.array([0.05, -0.03])


@pytest.mark.parametrize(
    ("camera", "mount", "lean"),
    [
        (CameraSettings(), CameraMountSettings(), None),
        (CameraSettings(field_of_view_deg=160, distortion=(-0.05, 0.01, 0.0, 0.0)), CameraMountSettings(), None),
        (CameraSettings(), CameraMountSettings(centre_px=12, ahead_m=0.05), LEAN),
    ],
    ids=["plain", "another lens", "a faulty mount"],
)
def test_unwrapping_a_picture_gives_the_polar_image_of_the_same_state(camera, mount, lean):
    settings = SimSettings(room=ROOM, camera=camera, camera_mount=mount)
    world = RoomWorld(settings)
    states = world.rest_states(np.array([(*world.free_space.start, yaw) for yaw in HEADINGS]))
    sense = open_camera(settings)
    pictures = [cv2.imdecode(sense(state, lean), cv2.IMREAD_COLOR_RGB) for state in states]
    centre, radius_px = ((COLUMNS - 1) / 2, (ROWS - 1) / 2), ROWS / 2
    assert np.array(pictures).shape == (len(HEADINGS), ROWS, COLUMNS, 3)  # TurtleBot3's
    unwrapped = unwrap_fisheye(np.array(pictures), centre, radius_px, camera.rings, camera.sectors)
    with Fisheye(world.model, camera, mount) as drawn:
        for state, image in zip(states, unwrapped, strict=True):
            world.data.qpos[:] = state
            mujoco.mj_kinematics(world.model, world.data)
            polar = drawn.polar(world.data, lean).astype(int)
            apart, turned = (np.abs(polar - other)[:-1] for other in (image, np.roll(image, 1, axis=1)))
            assert np.median(apart) <= 2
            assert apart.mean() < 4  # beside the rim, which is half black
            assert turned.mean() > 2 * apart.mean(), "a turn by a sector would be seen"


def test_the_calibration_gives_the_radius_of_each_angle():
    lens = make_lens(CameraSettings(distortion=(0.05, -0.01, 0.002, -0.0001)))
    theta = np.linspace(0, lens.half_angle, 50)
    k1, k2, k3, k4 = lens.k
    by_opencv = lens.focal_length(ROWS / 2) * (theta + k1 * theta**3 + k2 * theta**5 + k3 * theta**7 + k4 * theta**9)
    np.testing.assert_allclose(by_opencv, lens.radius(theta) * ROWS / 2)


def test_opencv_projects_as_the_camera_info_says():
    """A point to the front is above the middle of the picture, one to the robot's left is at its right."""
    lens = make_lens(CameraSettings(distortion=(0.05, 0.0, 0.0, 0.0)))
    focal_px = lens.focal_length(ROWS / 2)
    matrix = np.array([[focal_px, 0, (COLUMNS - 1) / 2], [0, focal_px, (ROWS - 1) / 2], [0, 0, 1]])
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # by 90 degrees about z
    robot = np.array([[1.0, 0.0, 2.0], [0.0, 1.0, 2.0]])  # in front, and to the left
    seen, _ = cv2.fisheye.projectPoints((robot @ turn)[:, None], np.zeros(3), np.zeros(3), matrix, np.array(lens.k))
    ahead, left = seen[:, 0] - matrix[:2, 2]
    np.testing.assert_allclose(ahead, [0, -np.hypot(*ahead)], atol=1e-9)
    np.testing.assert_allclose(left, [np.hypot(*left), 0], atol=1e-9)
