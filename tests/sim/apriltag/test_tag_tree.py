"""The rough map of tags: right in a drawn scene, and against wrong steps that look better than all others."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sim.apriltag.detector import CORNERS
from sim.apriltag.tag_tree import Steps, chain_tags, place_corners, vote
from tests.helpers.synthetic_tags import CAMERA, make_scene

TAGS = 12


def draw_poses(rng: np.random.Generator) -> np.ndarray:
    pose = np.tile(np.eye(4), (TAGS, 1, 1))
    pose[:, :3, :3], pose[:, :3, 3] = Rotation.random(TAGS, rng=rng).as_matrix(), rng.uniform(-2, 2, (TAGS, 3))
    return pose


def measure_steps(pose: np.ndarray) -> Steps:
    """Exact steps between all pairs of tags, as good as one another."""
    first, second = np.triu_indices(TAGS, 1)
    return Steps(first, second, np.linalg.inv(pose[first]) @ pose[second], np.full(len(first), 0.01))


def spoil(steps: Steps, number: int, rng: np.random.Generator) -> None:
    """Turn a step by a wrong candidate, on which all views agree."""
    steps.step[number, :3, :3] @= Rotation.random(rng=rng).as_matrix()
    steps.cost[number] = 0.0


def test_the_rough_map_takes_the_right_of_two_candidates():
    scene = make_scene()
    tag, pose = chain_tags(scene.detections, CAMERA)
    found, true = (np.concatenate(place_corners(some)) for some in (pose, scene.tag[tag]))
    u, _, vt = np.linalg.svd((true - true.mean(axis=0)).T @ (found - found.mean(axis=0)))
    turn = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    error = np.linalg.norm((found - found.mean(axis=0)) @ turn.T + true.mean(axis=0) - true, axis=1)
    assert len(error) == len(CORNERS) * len(tag)
    assert np.median(error) < 0.3


@pytest.mark.parametrize("seed", range(5))
def test_steps_with_a_majority_against_them_leave_the_tree(seed: int):
    rng = np.random.default_rng(seed)
    steps, tree = measure_steps(draw_poses(rng)), np.arange(TAGS - 1)  # from tag 0 to each other
    right = steps.step.copy()
    wrong = rng.choice(tree, 3, replace=False)
    for number in wrong:
        spoil(steps, number, rng)
    voted = vote(steps, tree)
    assert not set(wrong) & set(voted)
    assert len(voted) == TAGS - 1
    assert np.allclose(steps.step[voted], right[voted])


def test_a_tree_without_opposition_stays():
    steps = measure_steps(draw_poses(np.random.default_rng(0)))
    assert np.array_equal(vote(steps, np.arange(TAGS - 1)), np.arange(TAGS - 1))


def test_a_step_that_alone_joins_two_parts_stays():
    steps = measure_steps(draw_poses(np.random.default_rng(0)))
    inside = (steps.first < 6) == (steps.second < 6)
    kept = np.flatnonzero(inside | ((steps.first == 0) & (steps.second == 6)))
    few = Steps(*(values[kept] for values in steps))
    joins = int(np.flatnonzero((few.first == 0) & (few.second == 6))[0])
    spoil(few, joins, np.random.default_rng(1))
    tree = np.flatnonzero((few.first == 0) | (few.first == 6))
    assert np.array_equal(vote(few, tree), tree)
