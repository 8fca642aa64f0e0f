"""What the viewer shows: open room, round picture, distances."""

from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
import trimesh

from deepgps.evaluation.segment_errors import measure_distances
from deepgps.viewer.pictures import make_warp, warp_round
from deepgps.viewer.scene import WALL_SHARE, draw_ellipses, draw_floor_plan, open_room
from sim.errors import InputError
from sim.recording.format import open_recording, open_truth
from sim.sensors.camera.lens import make_lens, project_polar, project_round
from sim.settings import CameraSettings
from tests.helpers.synthetic_run import TICKS_PER_REV, WHEEL_RADIUS_M, make_free_space, write_synthetic_run

CAMERA = CameraSettings(rings=32, sectors=128, distortion=(0.02, 0.0, 0.0, 0.0))
SIZE = 129


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_synthetic_run(tmp_path_factory.mktemp("run"), samples=60, spacing_m=0.4)


def test_the_open_room_lacks_ceiling_and_south_wall_only(run: Path) -> None:
    glb = open_room(run / "recording" / "scene.glb", make_free_space())
    before = set(trimesh.load_scene(run / "recording" / "scene.glb").geometry)
    after = set(trimesh.load_scene(BytesIO(glb), file_type="glb").geometry)
    assert before - after == {"ceiling", "wall_south"}


def test_a_wall_between_rooms_is_drawn_low(run: Path, tmp_path: Path) -> None:
    scene, height_m = trimesh.load_scene(run / "recording" / "scene.glb"), 2.6
    box = trimesh.creation.box((0.1, 2.0, height_m))
    box.apply_translation((0.3, 0.5, height_m / 2))
    scene.add_geometry(box, geom_name="between", node_name="between")
    scene.export(tmp_path / "scene.glb")
    opened = trimesh.load_scene(BytesIO(open_room(tmp_path / "scene.glb", make_free_space())), file_type="glb")
    transform, name = opened.graph["between"]
    bounds = trimesh.transform_points(opened.geometry[name].bounds, transform)
    np.testing.assert_allclose(bounds[:, 2], [0.0, WALL_SHARE * height_m], atol=1e-6)
    np.testing.assert_allclose(bounds[:, :2].mean(axis=0), [0.3, 0.5], atol=1e-6)


def test_a_broken_scene_is_one_clear_line(tmp_path: Path) -> None:
    (tmp_path / "scene.glb").write_bytes(b"glTF, but not really")
    with pytest.raises(InputError, match="cannot be read"):
        open_room(tmp_path / "scene.glb", make_free_space())


def test_the_round_picture_shows_each_direction_where_the_lens_puts_it() -> None:
    """A mark in the polar image must appear where ``project_round`` says, found here without the warp."""
    lens = make_lens(CAMERA)
    for azimuth_deg, theta_deg in [(0, 40), (90, 60), (200, 20), (359, 80)]:
        azimuth, theta = np.radians(azimuth_deg), np.radians(theta_deg)
        direction = np.array([np.sin(theta) * np.cos(azimuth), np.sin(theta) * np.sin(azimuth), np.cos(theta)])
        row, column = np.rint(project_polar(lens, direction, 32, 128)).astype(int)
        polar = np.zeros((32, 128, 3), np.uint8)
        polar[row, column % 128] = 255
        picture = warp_round(polar, make_warp(CAMERA, 32, 128, SIZE))[..., 0].astype(float)
        middle = np.array([(picture.sum(axis=1) @ np.arange(SIZE)), (picture.sum(axis=0) @ np.arange(SIZE))])
        np.testing.assert_allclose(middle / picture.sum(), project_round(lens, direction, SIZE), atol=2.0)


def test_turning_the_robot_turns_the_round_picture() -> None:
    polar = np.random.default_rng(0).integers(0, 256, (32, 128, 3)).astype(np.uint8)
    warp = make_warp(CAMERA, 32, 128, SIZE)
    turned = warp_round(np.roll(polar, -32, axis=1), warp)  # a quarter turn to the left
    expected = np.rot90(warp_round(polar, warp))
    difference = np.abs(turned.astype(int) - expected)
    difference[SIZE // 2, SIZE // 2] = 0  # the zenith has no azimuth
    assert difference.max() <= 2  # the same weights, rounded


def test_outside_the_rim_is_black_and_inside_is_whole() -> None:
    picture = warp_round(np.full((32, 128, 3), 200, np.uint8), make_warp(CAMERA, 32, 128, SIZE))
    offset = np.hypot(*(np.indices((SIZE, SIZE)) - (SIZE - 1) / 2)) / (SIZE / 2)
    assert (picture[offset > 1.001] == 0).all()
    assert (picture[offset < 0.999] == 200).all()


def test_the_floor_plan_lies_on_the_cells() -> None:
    space = make_free_space()
    picture, corner = draw_floor_plan(space)
    offset = np.rint((corner - space.origin) / space.cell_m + 0.5).astype(int)
    rows, columns, _ = picture.shape
    cut = space.reachable[offset[1] : offset[1] + rows, offset[0] : offset[0] + columns]
    assert cut.sum() == space.reachable.sum()
    floor = picture[cut]
    assert (floor == floor[0]).all()
    assert (picture[~cut] != floor[0]).any(axis=1).all()


def test_distances_are_those_counted_segment_by_segment(run: Path) -> None:
    recording, truth = open_recording(run / "recording"), open_truth(run / "recording")
    encoder, true = measure_distances(recording, truth.pose)
    reading = recording.reading
    for segment in np.unique(reading[:, 0]):
        rows = np.flatnonzero(reading[:, 0] == segment)
        distance = 2 * np.pi * WHEEL_RADIUS_M / TICKS_PER_REV * (reading[rows, 2:] - reading[rows[0], 2:]).mean(axis=1)
        place = truth.pose[reading[rows, 1], :2]
        straight = np.linalg.norm(place - place[0], axis=1)
        np.testing.assert_allclose(encoder[rows], distance, atol=1e-12)
        np.testing.assert_allclose(true[rows], straight, atol=1e-12)


def test_an_ellipse_is_a_standard_deviation_away_from_its_middle() -> None:
    root = np.array([[[0.03, 0.0], [0.02, 0.01]], [[0.5, 0.0], [0.0, 0.1]]])
    covariance, middle = root @ root.transpose(0, 2, 1), np.array([[1.0, 2.0], [-3.0, 0.5]])
    away = draw_ellipses(middle, covariance, 0.1)[..., :2] - middle[:, None]
    np.testing.assert_allclose(np.einsum("nka,nab,nkb->nk", away, np.linalg.inv(covariance), away), 1.0)
