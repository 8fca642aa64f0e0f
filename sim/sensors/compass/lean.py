"""The camera's lean against the robot, from the relative leans of pairs, and the turns that a level camera would see.

Both images of a pair lean alike in the robot's frame, but not in the room's: Rz(angle) swing(relative lean) =
tilt(l)^T Rz(turn) tilt(l). No image is resampled.

A camera off the turning axis moves in a turn, which shifts what is above it as a lean does. At the camera's own height,
a lean moves things up and down, and parallax only sideways: the lean is measured there.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from sim.sensors.camera.lens import Lens
from sim.sensors.camera.mount import tilt
from sim.sensors.compass.compass import CHUNK, Hypotheses
from sim.sensors.compass.fit import fit_rotation, make_grid, swing, take_spectra

HORIZON = 0.1
"""Cosine of the zenith angle within which rings count as at the camera's height."""
ROUNDS = 12
"""Reweighted solutions: each is exact to second order, and each leaves more of the outliers out."""


def compare_at_horizon(
    first: np.ndarray, second: np.ndarray, angle: np.ndarray, lens: Lens, hidden: float = 0.0
) -> Hypotheses:
    """The likeliest hypothesis of each pair, fitted again to the rings nearest the horizon, for ``find_lean``.

    Args:
        first: Polar images (P, rings, sectors, channels).
        second: Polar images of the same shape.
        angle: Angles turned (P,) [rad]; NaN where they are not known.
        lens: The lens of the images.
        hidden: Width of the outermost part of the images that shows nothing [rad].
    """
    grid = make_grid(*first.shape[1:3], lens)
    cosine, last = grid.rays[:, :1, 2], np.cos(lens.half_angle - hidden)
    away = np.maximum(cosine, last) - max(float(last), 0.0)
    weight = grid.weight * np.exp(-((away / HORIZON) ** 2)) * (cosine >= last)
    grid = replace(grid, weight=weight.astype(np.float32))

    def fit() -> Iterator[np.ndarray]:
        for start in range(0, len(angle), CHUNK):
            some = slice(start, start + CHUNK)
            known = np.isfinite(angle[some])
            one, two = take_spectra(first[some], grid), take_spectra(second[some], grid)
            fitted = fit_rotation(one, two, np.where(known, angle[some], 0.0), grid)
            found = np.column_stack([fitted.angle, fitted.std, known, fitted.lean])
            yield np.where(known[:, None], found, np.nan)

    found = np.concatenate([np.empty((0, 5)), *fit()])[:, None]
    return Hypotheses(found[..., 0], found[..., 1], np.nan_to_num(found[..., 2]), found[..., 3:])


def find_lean(hypotheses: Hypotheses) -> np.ndarray:
    """The lean common to all images (2,) [rad], to the robot's right and forward; NaN without any turn.

    Gauss-Newton on the relative lean that is left after correction: to first order l - Rot(-turn) l, with Rot in the
    plane. Cauchy weights, scaled by the median.
    """
    lean = np.zeros(2)
    for _ in range(ROUNDS):
        angle, left = _correct(hypotheses, lean)
        angle, left = angle[:, 0], left[:, 0]
        known = np.isfinite(angle)
        if not known.any():
            return np.full(2, np.nan)
        cos, sin = np.cos(angle[known]), np.sin(angle[known])
        # the lean as a rotation vector (right, ahead) in the robot's plane, seen from the second heading
        design = np.stack([np.stack([1.0 - cos, -sin], -1), np.stack([sin, 1.0 - cos], -1)], axis=1)
        square = (left[known] ** 2).sum(axis=1)
        weight = 1.0 / (1.0 + square / (np.median(square) + 1e-12))
        normal = np.einsum("p,pij,pik->jk", weight, design, design) + 1e-9 * np.eye(2)
        lean = lean + np.linalg.solve(normal, np.einsum("p,pij,pi->j", weight, design, left[known]))
    return lean


def _correct(hypotheses: Hypotheses, lean: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angle (P, K) and relative lean (P, K, 2) that are left of the rotations once the camera's lean is undone."""
    angle, relative = hypotheses.angle, hypotheses.lean
    c, s, zero = np.cos(angle), np.sin(angle), np.zeros_like(angle)
    turn = np.stack([c, -s, zero, s, c, zero, zero, zero, zero + 1.0], axis=-1).reshape(*angle.shape, 3, 3)
    level = tilt(np.asarray(lean, float))
    rotation = level @ turn @ swing(relative) @ level.T
    # Rz(angle) swing(left): the upper left corner has the angle, the last row the rest
    left_angle = np.arctan2(rotation[..., 1, 0] - rotation[..., 0, 1], rotation[..., 0, 0] + rotation[..., 1, 1])
    across = np.stack([rotation[..., 2, 1], -rotation[..., 2, 0]], axis=-1)
    size = np.linalg.norm(across, axis=-1, keepdims=True)
    tipped = np.arctan2(size, rotation[..., 2, 2, None])
    return left_angle, across * np.where(size > 0.0, tipped / np.maximum(size, 1e-30), 1.0)
