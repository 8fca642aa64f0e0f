"""Alignment of a method's frame with the world's: the rigid transform that distances leave undetermined."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

AlignmentKind = Literal["E2", "SE2"]

ROBUST_SCALE = 4.0
"""Distance at which a sample counts half in a robust alignment, in medians: of a normal distribution 5 deviations."""
ROUNDS = 20  # Rounds of the robust alignment; the weights change by less than a thousandth after half of them


@dataclass(frozen=True)
class Alignment:
    """x_world = rotation @ x_method + translation."""

    rotation: np.ndarray  # Orthogonal matrix (2, 2), with determinant -1 where the map is mirrored (E2 only)
    translation: np.ndarray  # Offset (2,) [m]
    scale: float  # The factor that a similarity transform would apply [1]; a diagnostic of the encoder, never applied

    def apply(self, points: np.ndarray) -> np.ndarray:
        """World positions of ``points`` (..., 2) [m]."""
        return np.asarray(points) @ self.rotation.T + self.translation

    def turn(self, yaw: np.ndarray) -> np.ndarray:
        """Yaw in the world (...) [rad], from -pi to pi, of ``yaw`` (...) in the method's frame."""
        x, y = np.moveaxis(np.stack([np.cos(yaw), np.sin(yaw)], axis=-1) @ self.rotation.T, -1, 0)
        return np.arctan2(y, x)

    def invert(self) -> "Alignment":
        """The transform back, from the world's frame to the method's."""
        return Alignment(self.rotation.T, -self.rotation.T @ self.translation, self.scale)


def fit_alignment(
    source: np.ndarray, target: np.ndarray, kind: AlignmentKind, weight: np.ndarray | None = None
) -> Alignment:
    """Least-squares rigid transform from positions (N, 2) in the method's frame to the same in the world's [m]
    (Kabsch-Umeyama), which count by a weight (N,) or all the same.

    SE2 preserves chirality; E2 allows a reflection, since distances leave a mirror ambiguity.
    """
    weight = np.ones(len(source)) if weight is None else weight
    source_mean, target_mean = (np.average(points, axis=0, weights=weight) for points in (source, target))
    source_0, target_0 = source - source_mean, target - target_mean
    weighted = weight[:, None] * source_0
    u, singular, vt = np.linalg.svd(target_0.T @ weighted)
    sign = np.array([1.0, 1.0])
    if kind == "SE2" and np.linalg.det(u @ vt) < 0:
        sign[1] = -1.0
    rotation = (u * sign) @ vt
    spread = float((weighted * source_0).sum())
    scale = float((singular * sign).sum() / spread) if spread > 0 else 0.0
    return Alignment(rotation, target_mean - rotation @ source_mean, scale)


def fit_robust_alignment(source: np.ndarray, target: np.ndarray, kind: AlignmentKind) -> Alignment:
    """Rigid transform as ``fit_alignment``, to which positions far off contribute little (Cauchy weights, IRLS).

    In a world that repeats, some images are placed metres off. Least squares would move all others by centimetres.
    """
    alignment = fit_alignment(source, target, kind)
    for _ in range(ROUNDS):
        distance = np.linalg.norm(alignment.apply(source) - target, axis=1)
        if (median := float(np.median(distance))) == 0:
            break
        alignment = fit_alignment(source, target, kind, 1 / (1 + (distance / (ROBUST_SCALE * median)) ** 2))
    return alignment
