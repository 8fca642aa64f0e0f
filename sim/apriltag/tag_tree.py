"""The rough map of the tags: a tree of steps from tag to tag, in which the majority of all other steps is right.

A view of one tag gives its pose up to two candidates (Collins and Bartoli 2014). The step between two tags that are
seen together is one of the four between their candidates; over many views, mostly the right one is most consistent.
Where all views look from nearly the same side, a wrong one may agree as well, and would lay everything beyond it wrong.
So a step of the tree is exchanged for another between its two sides if more of the steps across agree with that one.
"""

from typing import NamedTuple

import cv2
import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree

from sim.apriltag.detector import CORNERS, Detections, measure_size
from sim.errors import WorkError

MAX_PAIR_VIEWS = 24  # Views in which two tags are compared, at most: those where the tags are largest
MAX_PAIR_ERROR_M = 0.3  # Pairs of candidates farther apart than this [m] all count as equally wrong
MIN_SHARED_VIEWS = 3  # Views that must show two tags together, at least
AGREEMENT_M = 0.3  # A step agrees with a map that has either tag this near to where it puts the tag [m]
MIN_CUT_AGREEMENT, MAX_ALTERNATIVES = 0.7, 50
"""Share of the steps across a cut below which the step of the tree is voted on, and how many others are tried."""


class Steps(NamedTuple):
    """Relative poses of pairs of tags."""

    first: np.ndarray  # First tag of each pair (p,), counted from 0
    second: np.ndarray  # Second tag of each (p,)
    step: np.ndarray  # ``T_first_second`` (p, 4, 4)
    cost: np.ndarray  # Mean disagreement of the views (p,) [m]


def chain_tags(detections: Detections, camera: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Place the largest set of tags that are connected through views that see two of them, by a camera without
    distortion.

    Returns tag numbers (T,), ascending, and their poses ``T_first_tag`` (T, 4, 4). Raises WorkError if no two tags are
    seen together often enough.
    """
    numbers, tag = np.unique(detections.tag, return_inverse=True)
    steps = _measure_steps(detections, tag, camera)
    part = connected_components(_join(steps, np.arange(len(steps.cost)), len(numbers)), directed=False)[1]
    inside = part == np.bincount(part).argmax()
    steps = Steps(*(values[inside[steps.first]] for values in steps))
    renumber = np.cumsum(inside) - 1
    steps = steps._replace(first=renumber[steps.first], second=renumber[steps.second])
    return numbers[inside], _place(steps, vote(steps, _find_tree(steps)))


def vote(steps: Steps, tree: np.ndarray) -> np.ndarray:
    """Exchange the steps of a tree (t - 1,) that have a majority against them, until there is none.

    Each exchange lets more steps agree with the map, so this ends.
    """
    pose, settled = _place(steps, tree), False
    while not settled:
        settled = True
        for own in tree:
            rest = tree[tree != own]
            number, across = _cut(steps, rest, len(pose))
            agreeing = _agree_with(pose[across.first], pose[across.second], across.step).sum()
            if agreeing >= MIN_CUT_AGREEMENT * len(number):
                continue
            tried = np.argsort(across.cost, kind="stable")[:MAX_ALTERNATIVES]
            first, second, step, _ = (values[tried] for values in across)
            motion = pose[first] @ step @ np.linalg.inv(pose[second])
            moved = motion[:, None] @ pose[across.second]
            votes = _agree_with(pose[across.first], moved, across.step).sum(axis=1)
            if votes.max() > agreeing:
                tree, settled = np.append(rest, number[tried[votes.argmax()]]), False
                pose = _place(steps, tree)
    return tree


def _measure_steps(detections: Detections, tag: np.ndarray, camera: np.ndarray) -> Steps:
    candidate = np.array([_candidates(corner, camera) for corner in detections.corner]).reshape(-1, 2, 4, 4)
    size, count = measure_size(detections), int(tag.max(initial=0)) + 1
    first, second = _together(detections.view)
    swap = tag[first] > tag[second]
    first, second = np.where(swap, second, first), np.where(swap, first, second)
    key = tag[first] * count + tag[second]
    order = np.lexsort((-np.minimum(size[first], size[second]), key))
    found = []
    for group in np.split(order, np.flatnonzero(np.diff(key[order])) + 1):
        if len(group) >= MIN_SHARED_VIEWS:
            a, b = first[group[:MAX_PAIR_VIEWS]], second[group[:MAX_PAIR_VIEWS]]
            found.append((tag[a[0]], tag[b[0]], *_agree(candidate[a], candidate[b])))
    if not found:
        raise WorkError(f"labels: no two tags are seen together in {MIN_SHARED_VIEWS} views, so none can be placed")
    return Steps(*(np.array(part) for part in zip(*found, strict=True)))


def _join(steps: Steps, some: np.ndarray, tags: int) -> csr_array:
    entries = steps.cost[some] + 1e-6, (steps.first[some], steps.second[some])
    return csr_array(entries, shape=(tags, tags))


def _find_tree(steps: Steps) -> np.ndarray:
    """The steps (t - 1,) of the tree of least cost."""
    tags = int(steps.second.max()) + 1
    found = minimum_spanning_tree(_join(steps, np.arange(len(steps.cost)), tags)).tocoo()
    number = {pair: at for at, pair in enumerate(zip(steps.first.tolist(), steps.second.tolist(), strict=True))}
    return np.array([number[pair] for pair in zip(found.row.tolist(), found.col.tolist(), strict=True)])


def _cut(steps: Steps, tree: np.ndarray, tags: int) -> tuple[np.ndarray, Steps]:
    """The steps between the two sides of a cut tree: their numbers (n,), and these from the side of tag 0."""
    part = connected_components(_join(steps, tree, tags), directed=False)[1]
    near = part == part[0]
    number = np.flatnonzero(near[steps.first] != near[steps.second])
    first, second, step, cost = (values[number] for values in steps)
    ahead = near[first]
    away = np.where(ahead, first, second), np.where(ahead, second, first)
    return number, Steps(*away, np.where(ahead[:, None, None], step, np.linalg.inv(step)), cost)


def _place(steps: Steps, tree: np.ndarray) -> np.ndarray:
    """Poses ``T_0_tag`` (t, 4, 4) of the tags along a tree."""
    tags = int(steps.second.max()) + 1
    reached, before = breadth_first_order(_join(steps, tree, tags), 0, directed=False)
    own = {(steps.first[at], steps.second[at]): steps.step[at] for at in tree}
    pose = np.tile(np.eye(4), (tags, 1, 1))
    for tag in reached[1:]:
        last = before[tag]
        pose[tag] = pose[last] @ (own[last, tag] if (last, tag) in own else np.linalg.inv(own[tag, last]))
    return pose


def _agree_with(first: np.ndarray, second: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Whether steps (n, 4, 4) agree with the poses of their tags on maps (..., n, 4, 4), seen from either tag."""
    mapped = np.linalg.inv(first) @ second
    pairs = ((mapped, step), (np.linalg.inv(mapped), np.linalg.inv(step)))
    apart = [np.linalg.norm(place_corners(one) - place_corners(other), axis=-1).mean(axis=-1) for one, other in pairs]
    return np.maximum(*apart) < AGREEMENT_M


def _together(view: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return all pairs of detections in the same view: first (p,) and second (p,)."""
    order = np.argsort(view, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(view[order])) + 1)
    pairs = [np.array(np.triu_indices(len(group), 1)) for group in groups]
    joined = [group[pair] for group, pair in zip(groups, pairs, strict=True)]
    return tuple(np.concatenate(joined, axis=1)) if joined else (np.empty(0, int), np.empty(0, int))


def _agree(first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the relative pose of two tags on which candidates (n, 2, 4, 4) agree best, and its mean disagreement."""
    steps = (np.linalg.inv(first)[:, :, None] @ second[:, None]).reshape(len(first), 4, 4, 4)
    corners = np.nan_to_num(place_corners(steps), nan=1e3).reshape(len(first), 4, 12)  # NaN: a tag seen upright
    apart = np.linalg.norm(corners.reshape(-1, 1, 1, 12) - corners, axis=-1).min(axis=2)
    cost = np.minimum(apart, MAX_PAIR_ERROR_M).mean(axis=1)
    best = int(cost.argmin())
    return steps.reshape(-1, 4, 4)[best], float(cost[best])


def _candidates(corner: np.ndarray, camera: np.ndarray) -> np.ndarray:
    """Return the two poses ``T_camera_tag`` (2, 4, 4) that one tag's corners (4, 2) allow, the likelier first."""
    count, turn, place, _ = cv2.solvePnPGeneric(CORNERS, corner, camera, None, flags=cv2.SOLVEPNP_IPPE_SQUARE)
    poses = [make_pose(turn[k], place[k]) for k in range(count)]
    return np.array((poses * 2)[:2])


def make_pose(turn: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Pose (4, 4) of a rotation vector and a place, as OpenCV returns them."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(turn)[0], np.ravel(place)
    return pose


def place_corners(pose: np.ndarray) -> np.ndarray:
    """Return corners (..., 4, 3) of tags at poses (..., 4, 4)."""
    return np.einsum("...ij,kj->...ki", pose[..., :3, :3], CORNERS) + pose[..., None, :3, 3]
