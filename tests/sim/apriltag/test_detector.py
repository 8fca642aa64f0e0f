import cv2
import mujoco
import numpy as np
import pytest

from sim.apriltag.detector import CORNERS, SIDE_M, TAGS, draw_tag, find_tags
from sim.robot.world import RoomWorld
from sim.sensors.camera.tag_camera import TagCamera, camera_matrix, mounting
from sim.settings import RoomSettings, SimSettings, TagCameraSettings

SETTINGS = SimSettings(room=RoomSettings(kind="lab", seed=10), tag_camera=TagCameraSettings(mounted=True))


def test_every_tag_is_found_in_its_own_picture():
    pictures = np.stack([draw_tag(number)[..., 0] for number in range(TAGS)])
    found = find_tags(pictures)
    assert found.tag.tolist() == found.view.tolist() == list(range(TAGS))
    # the black square, a module of ten inside the plate on each side; pixel middles at whole numbers
    edge = np.array([[16, 16], [144, 16], [144, 144], [16, 144]]) - 0.5
    np.testing.assert_allclose(found.corner, np.broadcast_to(edge, found.corner.shape), atol=0.1)


def test_corners_of_a_warped_tag_lie_where_the_warp_puts_them():
    edge = np.array([[16, 16], [144, 16], [144, 144], [16, 144]]) - 0.5
    goal = np.array([[60.3, 50.8], [98.6, 55.2], [95.1, 99.7], [57.4, 90.9]])
    warp = cv2.getPerspectiveTransform(edge.astype(np.float32), goal.astype(np.float32))
    picture = cv2.GaussianBlur(draw_tag(7)[..., 0], (0, 0), 1.5)
    image = cv2.warpPerspective(picture, warp, (160, 140), borderValue=128)
    found = find_tags(image[None])
    assert found.tag.tolist() == [7]
    assert np.abs(found.corner[0] - goal).max() < 0.3


def test_nothing_is_found_in_an_empty_picture():
    found = find_tags(np.full((2, 90, 160), 128, np.uint8))
    assert found.view.shape == (0,) and found.corner.shape == (0, 4, 2)


@pytest.fixture(scope="module")
def world() -> RoomWorld:
    return RoomWorld(SETTINGS)


def test_a_laboratory_has_82_tags_of_16_cm_on_plates(world: RoomWorld):
    sites = [world.model.site(i).name for i in range(world.model.nsite)]
    assert sorted(name for name in sites if name.startswith("tag_")) == sorted(f"tag_{n}" for n in range(TAGS))
    world.place(np.zeros(3))
    inked = np.flatnonzero((draw_tag(0) == 0).any(axis=(1, 2)))
    for number in range(TAGS):
        site = world.data.site(f"tag_{number}")
        plate = np.linalg.norm(world.data.geom_xpos - site.xpos, axis=1).argmin()
        width, _, height = 2 * world.model.geom_size[plate]
        assert width == height == pytest.approx(SIDE_M * len(draw_tag(0)) / (np.ptp(inked) + 1))
        front = world.data.geom_xpos[plate] + site.xmat.reshape(3, 3)[:, 2] * world.model.geom_size[plate, 1]
        np.testing.assert_allclose(front, site.xpos, atol=1e-9)


def test_tags_are_seen_where_they_hang(world: RoomWorld):
    """The corners found in drawn images lie within half a pixel of the projection of the true ones."""
    rng, space = np.random.default_rng(0), world.free_space
    row, column = np.nonzero(space.reachable)
    camera, mount = camera_matrix(SETTINGS.tag_camera), mounting()
    base, errors = world.model.body("robot/base").id, []
    with TagCamera(world.model, SETTINGS.tag_camera) as tag_camera:
        for _ in range(12):
            cell = rng.integers(len(row))
            place = space.origin + np.array([column[cell], row[cell]]) * space.cell_m
            world.place(np.array([*place, rng.uniform(-np.pi, np.pi)]))
            image = tag_camera.look(world.data)
            assert image.shape == (540, 960) and image.dtype == np.uint8
            robot = np.eye(4)
            robot[:3, :3], robot[:3, 3] = world.data.xmat[base].reshape(3, 3), world.data.xpos[base]
            errors += compare(world, find_tags(image[None]), np.linalg.inv(robot @ mount), camera)
    assert len(errors) > 30
    error = np.array(errors)
    assert np.median(error) < 0.2
    assert np.percentile(error, 98) < 0.5


def compare(world: RoomWorld, found, camera_world: np.ndarray, camera: np.ndarray) -> list[float]:
    """Largest error of each tag that is 20 px wide and more."""
    errors = []
    for number, corner in zip(found.tag, found.corner, strict=True):
        site = world.data.site(f"tag_{number}")
        points = CORNERS @ site.xmat.reshape(3, 3).T + site.xpos
        pixels = (points @ camera_world[:3, :3].T + camera_world[:3, 3]) @ camera.T
        pixels = pixels[:, :2] / pixels[:, 2:]
        if cv2.contourArea(pixels.astype(np.float32)) > 20.0**2:
            errors.append(float(np.linalg.norm(corner - pixels, axis=1).max()))
    return errors


def test_the_camera_adds_nothing_that_collides_or_weighs(world: RoomWorld):
    bare = RoomWorld(SETTINGS.model_copy(update={"tag_camera": TagCameraSettings()}), drawn=True)
    assert mujoco.mj_getTotalmass(world.model) == pytest.approx(mujoco.mj_getTotalmass(bare.model), abs=1e-12)
    assert (world.model.geom_contype != 0).sum() == (bare.model.geom_contype != 0).sum()
