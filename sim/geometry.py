"""Poses on the floor."""

from typing import TypeVar

import numpy as np

Angle = TypeVar("Angle", float, np.ndarray)


def planar_pose(qpos: np.ndarray) -> np.ndarray:
    """Planar pose (..., 3) x, y [m], yaw [rad] of full positions (..., nq): the robot's free joint comes first."""
    x, y, _, w, i, j, k = np.moveaxis(np.asarray(qpos, float)[..., :7], -1, 0)
    return np.stack([x, y, np.arctan2(2 * (w * k + i * j), 1 - 2 * (j * j + k * k))], axis=-1)


def spread_headings(points: np.ndarray, headings: int) -> np.ndarray:
    """Poses (C, H, 3) at points (C, 2) [m], with headings spread evenly from +x."""
    yaw = np.broadcast_to(2 * np.pi * np.arange(headings)[:, None] / headings, (len(points), headings, 1))
    return np.concatenate([points[:, None].repeat(headings, axis=1), yaw], axis=-1)


def wrap(angle: Angle) -> Angle:
    """The same angles [rad] between -pi and pi."""
    return (angle + np.pi) % (2.0 * np.pi) - np.pi
