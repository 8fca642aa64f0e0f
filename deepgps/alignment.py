"""Alignment of a method's frame with the world's: the rigid transform that distances leave undetermined."""

from dataclasses import dataclass

import numpy as np

from deepgps.methods.catalog import AlignmentKind


@dataclass(frozen=True)
class Alignment:
    """x_world = rotation @ x_method + translation.

    Attributes:
        rotation: Orthogonal matrix (2, 2), with determinant -1 where the map is mirrored (E2 only).
        translation: Offset (2,) [m].
        scale: The factor that a similarity transform would apply [1]; a diagnostic of the encoder, never applied.
    """

    rotation: np.ndarray
    translation: np.ndarray
    scale: float

    def apply(self, points: np.ndarray) -> np.ndarray:
        """World positions of ``points`` (..., 2) [m]."""
        return np.asarray(points) @ self.rotation.T + self.translation

    def turn(self, yaw: np.ndarray) -> np.ndarray:
        """Yaw in the world (...) [rad], from -pi to pi, of ``yaw`` (...) in the method's frame."""
        x, y = np.moveaxis(np.stack([np.cos(yaw), np.sin(yaw)], axis=-1) @ self.rotation.T, -1, 0)
        return np.arctan2(y, x)


def fit_alignment(source: np.ndarray, target: np.ndarray, kind: AlignmentKind) -> Alignment:
    """Least-squares rigid transform from ``source`` (N, 2) to ``target`` (N, 2) (Kabsch-Umeyama).

    Args:
        source: Positions in the method's frame [m].
        target: The same positions in the world's frame [m].
        kind: SE2 preserves chirality; E2 allows a reflection, since distances leave a mirror ambiguity.
    """
    source_mean, target_mean = source.mean(axis=0), target.mean(axis=0)
    source_0, target_0 = source - source_mean, target - target_mean
    u, singular, vt = np.linalg.svd(target_0.T @ source_0)
    sign = np.array([1.0, 1.0])
    if kind == "SE2" and np.linalg.det(u @ vt) < 0:
        sign[1] = -1.0
    rotation = (u * sign) @ vt
    spread = float((source_0**2).sum())
    scale = float((singular * sign).sum() / spread) if spread > 0 else 0.0
    return Alignment(rotation, target_mean - rotation @ source_mean, scale)
