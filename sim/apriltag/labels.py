"""Labels of a recording: poses computed only from tags that the tag camera saw, never from the ground truth.

The folder ``labels/`` of a recording holds ``detection.npz`` and ``test_detection.npz`` (what was found in the images),
``tag.npz`` (the tags' poses) and ``pose.npy`` (N, 3), ``test_pose.npy`` (C, H, 3): x, y [m], yaw [rad], NaN where a
view shows too few tags. The labels have a frame of their own: z up, the origin below the first tag, x along the tag.
"""

from pathlib import Path

import numpy as np

from sim.apriltag.bundle_adjustment import TagMap, reconstruct, solve_views
from sim.apriltag.detector import Detections
from sim.errors import WorkError
from sim.files.checksums import write_array, write_arrays


def write_labels(
    folder: Path,
    detections: Detections,
    test: Detections,
    shape: tuple[int, ...],
    camera: np.ndarray,
    mount: np.ndarray,
) -> dict[str, int]:
    """Reconstruct the tags from the training views, solve all views, and write the folder ``labels``.

    Args:
        folder: The recording's folder.
        detections: Tags found in the training images.
        test: Tags found in the test images, numbered in order.
        shape: Number of training images, then the leading shape of the test images: (N, C, H).
        camera: Intrinsic matrix (3, 3) [px].
        mount: Pose of the camera on the robot (4, 4).

    Returns:
        Entries for the manifest: tags placed, images without a label.

    Raises:
        WorkError: The tags cannot be reconstructed, or no image can be solved.
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
