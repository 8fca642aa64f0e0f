"""Tag poses from many views of the tags, then the pose of each view: the paper's ground truth (Sec. IV-C).

A tree of steps from tag to tag places all tags roughly (``tag_tree``), and bundle adjustment of tags and views together
refines them, as in MASFM (Feng et al. 2016). Each view is then solved separately from all tags in it
(perspective-n-point). Nothing here uses true poses.

Poses are matrices (..., 4, 4), ``T_a_b`` the pose of b in the frame of a.
"""

from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from scipy.sparse import csc_array, diags_array
from scipy.sparse.linalg import splu
from scipy.spatial.transform import Rotation

from sim.apriltag.detector import CORNERS, SIDE_M, Detections, measure_size
from sim.apriltag.tag_tree import chain_tags, make_pose, place_corners
from sim.errors import WorkError
from sim.files.checksums import write_array, write_arrays

MIN_TAG_PX = 12.0
"""Detections of tags smaller than this, by the root of the area, are not used: their corners blur together."""
MAX_VIEWS = 400  # Views used in bundle adjustment, at most; all views are solved afterwards
MIN_TAGS = 2  # Tags that a view must show, at least: from a single tag its pose has two candidates
OUTLIER_PX = 3.0  # A tag whose RMS error in a solved view is larger than this [px] is treated as an outlier
NOISE_PX, MAX_POSITION_STD_M = 0.2, 0.03
"""Expected standard deviation of corners [px], and largest standard deviation of a view's position from it [m]."""
ROBUST_SCALE_PX = 0.5  # Error at which the robust loss of bundle adjustment changes from quadratic to linear [px]
MAX_STEPS, MIN_RELATIVE_GAIN = 100, 1e-10  # Bundle adjustment ends at this relative gain in cost


class TagMap(NamedTuple):
    """Tags that are connected, in the frame of the first of them."""

    tag: np.ndarray  # Tag numbers (T,), ascending
    pose: np.ndarray  # ``T_map_tag`` (T, 4, 4)


def reconstruct(detections: Detections, camera: np.ndarray) -> TagMap:
    """Place the largest set of tags that are connected through views that see two of them.

    The camera has no distortion. Raises WorkError if no two tags are seen together often enough.
    """
    detections = _large(detections)
    rough = TagMap(*chain_tags(detections, camera))
    known = detections.of(np.isin(detections.tag, rough.tag))
    view, pose = solve_views(known, rough, camera, OUTLIER_PX * 20)  # the rough map has errors of centimetres
    counts = np.array([np.count_nonzero(known.view == number) for number in view])
    chosen = np.sort(np.argsort(-counts, kind="stable")[:MAX_VIEWS])
    return adjust(known, rough, view[chosen], pose[chosen], camera)


def solve_views(
    detections: Detections, tags: TagMap, camera: np.ndarray, wrong_px: float = OUTLIER_PX
) -> tuple[np.ndarray, np.ndarray]:
    """Views (V,) that could be solved, and each one's pose ``T_map_camera`` (V, 4, 4), by all placed tags that fit."""
    detections = _large(detections)
    detections = detections.of(np.isin(detections.tag, tags.tag))
    corners = place_corners(tags.pose)[np.searchsorted(tags.tag, detections.tag)]
    found: dict[int, np.ndarray] = {}
    for view in np.unique(detections.view):
        seen = detections.view == view
        pose = _solve_view(corners[seen], detections.corner[seen], camera, wrong_px)
        if pose is not None:
            found[int(view)] = pose
    return np.array(list(found), np.int64), np.array(list(found.values())).reshape(-1, 4, 4)


def adjust(detections: Detections, tags: TagMap, view: np.ndarray, view_pose: np.ndarray, camera: np.ndarray) -> TagMap:
    """Adjust all tags but the first, and views (V,) with ``T_map_camera`` (V, 4, 4), to fit all corners.

    Minimises ``sum 2 s^2 (sqrt(1 + |e|^2 / s^2) - 1)`` (soft L1) over the reprojection errors e of all corners, by
    Levenberg-Marquardt steps, with the robust weights computed again in each (Triggs et al. 2000).
    """
    used = detections.of(np.isin(detections.view, view) & np.isin(detections.tag, tags.tag))
    t, v = np.searchsorted(tags.tag, used.tag), np.searchsorted(view, used.view)
    tag_pose, camera_map, damping = tags.pose, np.linalg.inv(view_pose), 1e-3
    error = _project(place_corners(tag_pose)[t], camera_map[v], camera) - used.corner
    for _ in range(MAX_STEPS):
        slope = _slope(tag_pose, camera_map, t, v, camera)
        weight = 1.0 / np.sqrt(1.0 + (error**2).sum(axis=2) / ROBUST_SCALE_PX**2)
        weighted = slope.multiply(np.repeat(weight.ravel(), 2)[:, None]).tocsc()
        normal, pull = (slope.T @ weighted).tocsc(), weighted.T @ error.ravel()
        step = -splu(normal + damping * diags_array(normal.diagonal() + 1e-9, format="csc")).solve(pull)
        motion = _moves(step.reshape(-1, 6))
        new_pose = np.concatenate([tag_pose[:1], tag_pose[1:] @ motion[: len(tag_pose) - 1]])
        new_map = motion[len(tag_pose) - 1 :] @ camera_map
        new_error = _project(place_corners(new_pose)[t], new_map[v], camera) - used.corner
        gain = _cost(error) - _cost(new_error)
        damping = damping / 5.0 if gain > 0 else damping * 5.0
        if gain > 0:
            tag_pose, camera_map, error = new_pose, new_map, new_error
        if abs(gain) <= MIN_RELATIVE_GAIN * _cost(error):
            break
    return TagMap(tags.tag, tag_pose)


def _cost(error: np.ndarray) -> float:
    """Return the cost that bundle adjustment minimises, for errors (S, 4, 2) [px]."""
    return float(2 * ROBUST_SCALE_PX**2 * (np.sqrt(1.0 + (error**2).sum(axis=2) / ROBUST_SCALE_PX**2) - 1.0).sum())


def _slope(tag_pose: np.ndarray, camera_map: np.ndarray, t: np.ndarray, v: np.ndarray, camera: np.ndarray) -> csc_array:
    """Return the derivative (8 S, 6 (T - 1 + V)) of the pixels of detections of tags t (S,) in views v (S,).

    It is with respect to small motions (rotation vector, shift) of all tags but the first, and of the views, each in
    its own frame.
    """
    point = np.einsum("nij,nkj->nki", camera_map[v, :3, :3], place_corners(tag_pose)[t]) + camera_map[v, None, :3, 3]
    depth = np.maximum(point[..., 2], 0.1 * SIDE_M)
    pixel = np.zeros((*point.shape[:2], 2, 3))
    pixel[..., 0, 0], pixel[..., 1, 1] = camera[0, 0] / depth, camera[1, 1] / depth
    pixel[..., :, 2] = -point[..., :2] * np.diag(camera)[:2] / depth[..., None] ** 2
    of_view = np.concatenate([-_cross(point), np.broadcast_to(np.eye(3), (*point.shape, 3))], axis=-1)
    turn = camera_map[v, :3, :3] @ tag_pose[t, :3, :3]
    own = np.broadcast_to(_cross(CORNERS), (*point.shape, 3))
    of_tag = turn[:, None] @ np.concatenate([-own, np.broadcast_to(np.eye(3), own.shape)], axis=-1)
    row = np.arange(8 * len(t)).reshape(-1, 4, 2, 1) + np.zeros(6, int)
    rows, columns, values = [], [], []
    for block, number, kept in ((of_tag, t - 1, t > 0), (of_view, v + len(tag_pose) - 1, v >= 0)):
        rows.append(row[kept].ravel())
        columns.append((6 * number[kept][:, None, None, None] + np.arange(6) + np.zeros((1, 4, 2, 1), int)).ravel())
        values.append((pixel @ block)[kept].ravel())
    shape = (8 * len(t), 6 * (len(tag_pose) - 1 + len(camera_map)))
    return csc_array((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=shape)


def _cross(point: np.ndarray) -> np.ndarray:
    """Return matrices (..., 3, 3) of the cross product with vectors (..., 3) from the left."""
    x, y, z = np.moveaxis(point, -1, 0)
    zero = np.zeros_like(x)
    return np.stack([np.stack(row, axis=-1) for row in ((zero, -z, y), (z, zero, -x), (-y, x, zero))], axis=-2)


def _large(detections: Detections) -> Detections:
    return detections.of(measure_size(detections) >= MIN_TAG_PX)


def _solve_view(corners: np.ndarray, seen: np.ndarray, camera: np.ndarray, wrong_px: float) -> np.ndarray | None:
    """Return ``T_map_camera`` from corners (n, 4, 3) seen at (n, 4, 2), dropping the worst tags, or None."""
    while len(corners) >= MIN_TAGS:
        places, pixels = corners.reshape(-1, 3), seen.reshape(-1, 2)
        good, turn, place = cv2.solvePnP(places, pixels, camera, None, flags=cv2.SOLVEPNP_SQPNP)
        if not good:
            return None
        turn, place = cv2.solvePnPRefineLM(places, pixels, camera, None, turn, place)
        pose = make_pose(turn, place)
        error = _project(corners, np.broadcast_to(pose, (len(corners), 4, 4)), camera) - seen
        off = np.sqrt((error**2).sum(axis=2).mean(axis=1))
        if off.max() <= wrong_px:
            return np.linalg.inv(pose) if _unsure(corners, pose, camera) <= MAX_POSITION_STD_M else None
        kept = np.arange(len(off)) != off.argmax()
        corners, seen = corners[kept], seen[kept]
    return None


def _unsure(corners: np.ndarray, pose: np.ndarray, camera: np.ndarray) -> float:
    """Return the standard deviation of a view's position [m] for corner noise ``NOISE_PX``, to first order."""
    step = 1e-5
    moved = _moves(step * np.concatenate([np.zeros((1, 6)), np.eye(6)])) @ pose
    pixels = [_project(corners, np.broadcast_to(one, (len(corners), 4, 4)), camera).ravel() for one in moved]
    slope = (np.array(pixels[1:]) - pixels[0]) / step
    covariance = NOISE_PX**2 * np.linalg.pinv(slope @ slope.T)
    return float(np.sqrt(np.trace(covariance[3:, 3:])))


def _project(corners: np.ndarray, camera_map: np.ndarray, camera: np.ndarray) -> np.ndarray:
    """Return pixels (n, 4, 2) of corners (n, 4, 3) in cameras ``T_camera_map`` (n, 4, 4)."""
    points = np.einsum("nij,nkj->nki", camera_map[:, :3, :3], corners) + camera_map[:, None, :3, 3]
    pixels = points @ camera.T
    return pixels[..., :2] / np.maximum(pixels[..., 2:], 0.1 * SIDE_M)


def _moves(small: np.ndarray) -> np.ndarray:
    """Return motions (n, 4, 4) from rotation vectors and shifts (n, 6)."""
    moves = np.tile(np.eye(4), (len(small), 1, 1))
    moves[:, :3, :3], moves[:, :3, 3] = Rotation.from_rotvec(small[:, :3]).as_matrix(), small[:, 3:]
    return moves


def write_labels(
    folder: Path,
    detections: Detections,
    test: Detections,
    shape: tuple[int, ...],
    camera: np.ndarray,
    mount: np.ndarray,
) -> dict[str, int]:
    """Reconstruct the tags from the training views, solve all views, and write the folder ``labels``.

    Tags found in test images are numbered in order; the shape is the number of training images, then that of the test
    images: (N, C, H). Returns entries for the manifest: tags placed, images without a label. Raises WorkError if the
    tags cannot be reconstructed, or no image can be solved.
    """
    tags = reconstruct(detections, camera)
    (view, pose), (test_view, test_pose) = (solve_views(seen, tags, camera) for seen in (detections, test))
    count, *test_shape = shape
    tests = int(np.prod(test_shape))
    for name, solved, images in (("training", view, count), ("test", test_view, tests)):
        if images and not len(solved):
            raise WorkError(f"labels: no {name} image shows tags enough to tell where it was taken")
    robot = pose @ np.linalg.inv(mount)
    level = find_level(tags, robot)
    label = _spread(view, flatten(level @ robot), count)
    test_label = _spread(test_view, flatten(level @ test_pose @ np.linalg.inv(mount)), tests)
    for name, found in (("detection", detections), ("test_detection", test)):
        write_arrays(folder / "labels" / f"{name}.npz", vars(found))
    write_arrays(folder / "labels" / "tag.npz", {"tag": tags.tag, "pose": level @ tags.pose})
    write_array(folder / "labels" / "pose.npy", label)
    write_array(folder / "labels" / "test_pose.npy", test_label.reshape(*test_shape, 3))
    return {
        "tags_placed": len(tags.tag),
        "unlabelled": int(np.isnan(label[:, 0]).sum()),
        "test_unlabelled": int(np.isnan(test_label[:, 0]).sum()),
    }


def find_level(tags: TagMap, robot: np.ndarray) -> np.ndarray:
    """Return the transform (4, 4) from the tags' frame to one whose z is the mean up axis of robot poses (V, 4, 4)."""
    up = robot[:, :3, 2].mean(axis=0)
    up /= np.linalg.norm(up)
    right = tags.pose[0, :3, 0] - (tags.pose[0, :3, 0] @ up) * up
    right /= np.linalg.norm(right)
    floor = float((robot[:, :3, 3] @ up).mean())
    origin = tags.pose[0, :3, 3] + (floor - tags.pose[0, :3, 3] @ up) * up
    level = np.eye(4)
    level[:3, :3] = np.stack([right, np.cross(up, right), up])
    level[:3, 3] = -level[:3, :3] @ origin
    return level


def flatten(pose: np.ndarray) -> np.ndarray:
    """Return planar poses (V, 3) x, y [m], yaw [rad] of poses (V, 4, 4) in a level frame."""
    return np.column_stack([pose[:, :2, 3], np.arctan2(pose[:, 1, 0], pose[:, 0, 0])])


def _spread(view: np.ndarray, pose: np.ndarray, count: int) -> np.ndarray:
    label = np.full((count, 3), np.nan)
    label[view] = pose
    return label
