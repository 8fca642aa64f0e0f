"""Planar geometry: angles, poses, rigid transforms between frames."""

import numpy as np


def wrap_angle(angle: np.ndarray | float) -> np.ndarray:
    """Bring angles (...,) [rad] into [-pi, pi)."""
    return (np.asarray(angle) + np.pi) % (2 * np.pi) - np.pi


def rotation(angle: float) -> np.ndarray:
    """Rotation matrix (2, 2) that turns counter-clockwise by ``angle`` [rad]."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, -sin], [sin, cos]])


def compose(pose: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """Pose (..., 3) reached from ``pose`` (..., 3) by ``motion`` (..., 3) given in its own frame: T_world_a @ T_a_b."""
    x, y, yaw = np.moveaxis(np.asarray(pose, float), -1, 0)
    dx, dy, turn = np.moveaxis(np.asarray(motion, float), -1, 0)
    cos, sin = np.cos(yaw), np.sin(yaw)
    return np.stack([x + cos * dx - sin * dy, y + sin * dx + cos * dy, wrap_angle(yaw + turn)], axis=-1)


def integrate_wheels(distance: np.ndarray, track_m: float) -> np.ndarray:
    """Dead-reckoned poses (R, 3) from the way of each wheel.

    Each step is taken as an arc of constant curvature: its chord is s sinc(turn / 2 pi), along the mean heading.

    Args:
        distance: Cumulative way of left and right wheel (R, 2) [m].
        track_m: Distance between the wheels [m].
    """
    step = np.diff(np.asarray(distance, float), axis=0)
    turn = (step[:, 1] - step[:, 0]) / track_m
    yaw = np.concatenate([[0.0], np.cumsum(turn)])
    chord = step.mean(axis=1) * np.sinc(turn / (2 * np.pi))
    middle = yaw[:-1] + turn / 2
    x = np.concatenate([[0.0], np.cumsum(chord * np.cos(middle))])
    y = np.concatenate([[0.0], np.cumsum(chord * np.sin(middle))])
    return np.stack([x, y, wrap_angle(yaw)], axis=-1)
