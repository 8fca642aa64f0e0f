"""Poses on the floor."""

import numpy as np


def planar_pose(qpos: np.ndarray) -> np.ndarray:
    """Planar pose (..., 3) x, y [m], yaw [rad] of full positions (..., nq): the robot's free joint comes first."""
    x, y, _, w, i, j, k = np.moveaxis(np.asarray(qpos, float)[..., :7], -1, 0)
    return np.stack([x, y, np.arctan2(2 * (w * k + i * j), 1 - 2 * (j * j + k * k))], axis=-1)
