"""Tags on the walls of a room and views of them, made by hand: what a camera would see, and where everything is."""

from typing import NamedTuple

import numpy as np

from sim.apriltag.detector import CORNERS, Detections

HALF = np.array((3.0, 2.5))
CAMERA = np.array([[400.0, 0.0, 399.5], [0.0, 400.0, 224.5], [0.0, 0.0, 1.0]])
SIZE = np.array((800, 450))


class Scene(NamedTuple):
    """Detections with the true poses of tags (T, 4, 4) and views (V, 4, 4) in the room's frame."""

    detections: Detections
    tag: np.ndarray
    view: np.ndarray


def make_scene(tags: int = 36, views: int = 160, noise_px: float = 0.2, seed: int = 0) -> Scene:
    """Tags all around at different heights, level views from everywhere."""
    rng = np.random.default_rng(seed)
    tag = np.array([_on_wall(number % 4, rng) for number in range(tags)])
    view = np.array([_level_view(rng) for _ in range(views)])
    found = []
    for number, camera in enumerate(view):
        for which, pose in enumerate(tag):
            corner = project(pose, camera)
            if corner is not None:
                found.append((number, which, corner + rng.normal(0, noise_px, (4, 2))))
    numbers, which, corner = zip(*found, strict=True)
    return Scene(Detections(np.array(numbers), np.array(which), np.array(corner)), tag, view)


def project(tag: np.ndarray, view: np.ndarray) -> np.ndarray | None:
    """A tag's corners (4, 2) [px] in a view, apart from the code under test; None where it is not seen whole."""
    points = (tag[:3, :3] @ CORNERS.T).T + tag[:3, 3]
    seen = (points - view[:3, 3]) @ view[:3, :3]
    if seen[:, 2].min() < 0.2 or (view[:3, 3] - tag[:3, 3]) @ tag[:3, 2] < 0.1:
        return None
    pixels = seen[:, :2] / seen[:, 2:] * CAMERA[0, 0] + CAMERA[:2, 2]
    return pixels if (pixels >= 0).all() and (pixels < SIZE).all() else None


def _on_wall(wall: int, rng: np.random.Generator) -> np.ndarray:
    inward = np.array([(0, 1, 0), (0, -1, 0), (1, 0, 0), (-1, 0, 0)][wall], float)
    along, up = np.cross((0.0, 0.0, 1.0), inward), np.array((0.0, 0.0, 1.0))
    place = -inward * [*HALF, 0] + along * rng.uniform(-2.2, 2.2) + up * rng.uniform(0.2, 1.2)
    return _pose(np.stack([along, up, inward], axis=1), place)


def _level_view(rng: np.random.Generator) -> np.ndarray:
    yaw = rng.uniform(-np.pi, np.pi)
    ahead, down = np.array((np.cos(yaw), np.sin(yaw), 0.0)), np.array((0.0, 0.0, -1.0))
    return _pose(
        np.stack([np.cross(down, ahead), down, ahead], axis=1), np.array((*rng.uniform(-1, 1, 2) * (2.2, 1.7), 0.28))
    )


def _pose(turn: np.ndarray, place: np.ndarray) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, place
    return pose
