"""The camera's mounting: its lean, and its motion while the robot drives with the shutter open."""

import numpy as np

from sim.geometry import planar_pose
from sim.settings import CameraMountSettings

CIRCLE_PX = 480
"""Diameter of the round image in whose pixels an error of the optical centre is given [px]."""
FRAMES = 5
"""Number of pictures that are averaged to an image if the robot drives while the shutter is open."""


def draw_leans(settings: CameraMountSettings, count: int, rng: np.random.Generator) -> np.ndarray | None:
    """Draw the lean to the right and forward (count, 2) [rad] of the next images; None if the camera is upright."""
    fixed = np.array([settings.roll_deg, settings.pitch_deg])
    if not fixed.any() and not settings.wobble_deg:
        return None
    return np.radians(fixed + settings.wobble_deg * rng.standard_normal((count, 2)))


def tilt(lean: np.ndarray) -> np.ndarray:
    """Axes of the leaning camera as columns (3, 3), in the frame of the upright one: R_y(ahead) R_x(right).

    Args:
        lean: Lean to the right and forward (2,) [rad].
    """
    (s, t), (c, d) = np.sin(lean), np.cos(lean)
    right = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    ahead = np.array([[d, 0.0, t], [0.0, 1.0, 0.0], [-t, 0.0, d]])
    return ahead @ right


def drive_on(state: np.ndarray, driven_m: float) -> np.ndarray:
    """States (FRAMES, nq) along a straight path around ``state`` (nq,): in the middle of each of FRAMES equal parts."""
    yaw = planar_pose(state)[2]
    along = driven_m * ((np.arange(FRAMES) + 0.5) / FRAMES - 0.5)
    states = np.tile(state, (FRAMES, 1))
    states[:, :2] += along[:, None] * [np.cos(yaw), np.sin(yaw)]
    return states
