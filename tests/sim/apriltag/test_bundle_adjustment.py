import numpy as np
import pytest

from sim.apriltag.bundle_adjustment import TagMap, reconstruct, solve_views
from sim.apriltag.detector import CORNERS, Detections
from sim.errors import WorkError
from tests.helpers.synthetic_tags import CAMERA, Scene, make_scene


@pytest.fixture(scope="module")
def scene() -> Scene:
    return make_scene()


@pytest.fixture(scope="module")
def tags(scene: Scene) -> TagMap:
    return reconstruct(scene.detections, CAMERA)


def points(pose: np.ndarray) -> np.ndarray:
    return np.concatenate([CORNERS @ one[:3, :3].T + one[:3, 3] for one in pose])


def move(source: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The rigid motion from source (N, 3) to target (N, 3)."""
    u, _, vt = np.linalg.svd((target - target.mean(axis=0)).T @ (source - source.mean(axis=0)))
    turn = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    return turn, target.mean(axis=0) - turn @ source.mean(axis=0)


def test_tags_are_placed_to_millimetres(scene, tags):
    assert list(tags.tag) == list(range(36))
    turn, shift = move(points(tags.pose), points(scene.tag))
    error = np.linalg.norm(points(tags.pose) @ turn.T + shift - points(scene.tag), axis=1)
    assert np.sqrt(np.mean(error**2)) < 0.004
    assert error.max() < 0.015


def test_views_are_solved_to_a_centimetre(scene, tags):
    turn, shift = move(points(tags.pose), points(scene.tag))
    view, pose = solve_views(scene.detections, tags, CAMERA)
    assert len(view) > 80
    error = np.linalg.norm(pose[:, :3, 3] @ turn.T + shift - scene.view[view, :3, 3], axis=1)
    assert np.median(error) < 0.004
    assert error.max() < 0.06


def test_with_hardly_any_noise_everything_is_exact():
    scene = make_scene(noise_px=1e-3, views=80, seed=3)
    tags = reconstruct(scene.detections, CAMERA)
    turn, shift = move(points(tags.pose), points(scene.tag[tags.tag]))
    np.testing.assert_allclose(points(tags.pose) @ turn.T + shift, points(scene.tag[tags.tag]), atol=1e-4)


def test_which_tag_fixes_the_frame_does_not_matter(scene, tags):
    """Numbers turned around: another tag is the first, and places differ by a rigid motion only."""
    seen = scene.detections
    other = reconstruct(Detections(seen.view, 35 - seen.tag, seen.corner), CAMERA)
    turn, shift = move(points(other.pose[::-1]), points(tags.pose))
    apart = np.linalg.norm(points(other.pose[::-1]) @ turn.T + shift - points(tags.pose), axis=1)
    assert apart.max() < 5e-4


def test_a_tag_that_is_somewhere_else_is_left_out_of_a_view(scene, tags):
    view = int(np.bincount(scene.detections.view).argmax())
    mine = scene.detections.of(scene.detections.view == view)
    wrong = mine.corner.copy()
    wrong[0] += 40.0
    before = solve_views(mine, tags, CAMERA)[1][0]
    after = solve_views(Detections(mine.view, mine.tag, wrong), tags, CAMERA)[1][0]
    assert np.linalg.norm(before[:3, 3] - after[:3, 3]) < 0.03


def test_a_view_of_one_tag_is_not_solved(scene, tags):
    one = scene.detections.of(np.arange(1))
    assert len(solve_views(one, tags, CAMERA)[0]) == 0


def test_tags_never_seen_together_are_refused(scene):
    seen = scene.detections
    alone = seen.of(np.unique(seen.view, return_index=True)[1])
    with pytest.raises(WorkError, match="no two tags are seen together in 3 views, so none can be placed"):
        reconstruct(alone, CAMERA)


def test_no_tags_at_all_are_refused():
    with pytest.raises(WorkError, match="no two tags are seen together"):
        reconstruct(Detections(np.empty(0, int), np.empty(0, int), np.empty((0, 4, 2))), CAMERA)
