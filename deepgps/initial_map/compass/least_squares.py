"""The least squares of a map by compass: residuals of turns, lengths, loop closures and of what all bars share.

Residuals come row by row, for one sparse Gauss-Newton step and samples of the errors that are left: solving the normal
equations for residuals drawn from their own distribution gives samples of the unknowns' errors (Papandreou and Yuille,
"Gaussian sampling by local perturbations", NIPS 2010); one factorisation serves all of them.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.sparse import csc_array, eye_array
from scipy.sparse.linalg import SuperLU, splu

from deepgps.data.turns import CompassTurns
from deepgps.initial_map.compass.bars import (
    AXLE_UNKNOWNS,
    CAMERA_UNKNOWNS,
    CONTINUATION_STD_M,
    CONTINUATION_STD_RAD,
    SHARED_UNKNOWNS,
    Bars,
    expand,
    turn,
)
from deepgps.initial_map.compass.closures import Inliers, Links
from sim.geometry import wrap

SAMPLES = 32
DAMPING = 1e-6


def factorise(normal: csc_array) -> SuperLU:
    """Factors of a symmetric positive definite matrix, whose pattern is kept sparse and which needs no pivots."""
    return splu(normal, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})


class Equations:
    """Weighted residuals and their derivatives."""

    def __init__(self) -> None:
        self._rows, self._columns, self._values = list[np.ndarray](), list[np.ndarray](), list[np.ndarray]()
        self._residual = list[np.ndarray]()
        self._count = 0

    def add(self, columns: np.ndarray, values: np.ndarray, residual: np.ndarray, weight: np.ndarray) -> None:
        """Add residuals (n,) with derivatives (n, k), each times its weight (n,), one over its standard deviation."""
        count, width = columns.shape
        self._rows.append(np.repeat(self._count + np.arange(count), width))
        self._columns.append(columns.ravel())
        self._values.append((np.broadcast_to(values, columns.shape) * weight[:, None]).ravel())
        self._residual.append(residual * weight)
        self._count += count

    def assemble(self, unknowns: int) -> tuple[csc_array, np.ndarray]:
        """Weighted derivatives (n, unknowns) and residuals (n,)."""
        entries = np.concatenate(self._values), (np.concatenate(self._rows), np.concatenate(self._columns))
        return csc_array(entries, shape=(self._count, unknowns)), np.concatenate(self._residual)

    def solve(self, held: np.ndarray, excess: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Gauss-Newton step (n,) and samples of the errors (n, SAMPLES).

        The step makes a sum zero whose derivative is ``held`` (n,), all zero where there is none, and which is
        ``excess`` now.
        """
        unknowns = len(held)
        jacobian, residual = self.assemble(unknowns)
        normal = (jacobian.T @ jacobian).tocsc() + DAMPING * eye_array(unknowns, format="csc")
        solver = factorise(normal.tocsc())
        drawn = rng.standard_normal((self._count, SAMPLES))
        step, samples = -solver.solve(jacobian.T @ residual), solver.solve(jacobian.T @ drawn)
        if not held.any():
            return step, samples
        along = solver.solve(held)
        along /= held @ along
        return step - along * (held @ step + excess), samples - along[:, None] * (held @ samples)


ANCHOR_STD = 1e-4  # Holds a part's first bar in place: the map may move and turn freely [m], [rad]
CURVATURE_STD, MOUNT_STD_M = 0.01, 0.05
"""Standard deviations of the curvature [1 / m] and of the camera's place off the axle [m], before the map."""
PRIOR_RESIDUALS = 20  # The expected errors count as much as so many residuals when these are rescaled
MAX_SQUARED_RESIDUAL = 9.0  # Squared residuals, in variances, count at most this much when errors are rescaled
MAX_RESCALING = 4.0  # Errors are rescaled at most by this factor, up or down


@dataclass(frozen=True)
class Joints:
    """How consecutive bars are joined; J = B - 1."""

    before: np.ndarray  # Last reading of the bar before each (J,)
    after: np.ndarray  # First reading of the bar after each (J,)
    new: np.ndarray  # Whether a segment ends there (J,) bool
    angle: np.ndarray  # Turn to the left (J,) [rad]
    angle_std: np.ndarray  # Its standard deviation (J,) [rad]
    jump: np.ndarray  # From the end of a bar to the beginning of the next, in the frame of the robot before (J, 2) [m]
    jump_std: np.ndarray  # Its standard deviation along each axis (J,) [m]


class Scale(NamedTuple):
    """Factors of the standard deviations of turns and lengths."""

    turn: float = 1.0
    length: float = 1.0


def make_joints(bars: Bars, turns: CompassTurns) -> Joints:
    """Joints of the bars of all segments, from the turns between these."""
    return Joints(
        bars.last[:-1],
        bars.first[1:],
        np.diff(bars.segment) > 0,
        expand(bars, turns.angle, 0.0),
        expand(bars, turns.angle_std, CONTINUATION_STD_RAD),
        expand(bars, turns.jump, 0.0),
        expand(bars, turns.jump_std, CONTINUATION_STD_M),
    )


def add_odometry(
    equations: Equations, bars: Bars, joints: Joints, part: np.ndarray, cut: np.ndarray, curvature: float, scale: Scale
) -> None:
    """Add the residuals of turns, of bars that meet, of lengths and of what all share.

    Bars of different parts of the drive (B,) are not joined, and each part is held by its first bar; at joints that are
    ``cut`` (J,) bool the turn, or the distance, says nothing. ``curvature`` [1 / m] is that before the map.
    """
    used = np.flatnonzero((np.diff(part) == 0) & ~cut)
    before, after = joints.before[used], joints.after[used]
    turn_std = joints.angle_std[used] * np.where(joints.new[used], scale.turn, 1.0)
    _add_turns(equations, bars, before, after, joints.angle[used], 1.0 / turn_std)
    begin, end = bars.locate(after), bars.locate(before)
    apart = begin.axle - end.axle - turn(end.heading, joints.jump[used])
    _add_pairs(equations, bars, after, before, apart, 1.0 / joints.jump_std[used], AXLE_UNKNOWNS)
    lengths = 4 * np.arange(len(bars.unknown))[:, None] + 3
    equations.add(lengths, np.ones(1), bars.unknown[:, 3], 1.0 / (bars.scale_std * scale.length))
    _, held = np.unique(part, return_index=True)
    fixed = (4 * held[:, None] + np.arange(3)).reshape(-1, 1)
    equations.add(fixed, np.ones(1), np.zeros(len(fixed)), np.full(len(fixed), 1.0 / ANCHOR_STD))
    shared = bars.unknown.size + np.arange(SHARED_UNKNOWNS)[:, None]
    prior = 1.0 / np.array([CURVATURE_STD, MOUNT_STD_M, MOUNT_STD_M])
    equations.add(shared, np.ones(1), bars.shared - np.array([curvature, 0.0, 0.0]), prior)


def add_links(equations: Equations, bars: Bars, links: Links, inliers: Inliers) -> None:
    """Add the positions and relative headings of the loop closures that are inliers."""
    used = np.flatnonzero(inliers.mask)
    one, other = links.one[used], links.other[used]
    weight = np.sqrt(inliers.place[used] / links.variance[used])
    apart = bars.locate(one).camera - bars.locate(other).camera
    _add_pairs(equations, bars, one, other, apart, weight, CAMERA_UNKNOWNS)
    used = used[np.isfinite(links.turn[used])]
    weight = np.sqrt(inliers.turn[used]) / links.turn_std[used]
    _add_turns(equations, bars, links.one[used], links.other[used], links.turn[used], weight)


def rescale(bars: Bars, joints: Joints, part: np.ndarray, cut: np.ndarray, samples: np.ndarray, scale: Scale) -> Scale:
    """Rescale the expected errors of turns and lengths by the residuals that the loop closures left.

    A residual's expected square is its variance minus what remains uncertain after the fit (variance components:
    Foerstner, "Ein Verfahren zur Schaetzung von Varianz- und Kovarianzkomponenten", 1979).
    """
    used = np.flatnonzero((np.diff(part) == 0) & ~cut & joints.new)
    before, after = joints.before[used], joints.after[used]
    residual = wrap(bars.locate(after).heading - bars.locate(before).heading - joints.angle[used])
    left = _carry_headings(bars, samples, after) - _carry_headings(bars, samples, before)
    turn_scale = rescale_by(residual, left, joints.angle_std[used], scale.turn)
    moved = samples[:-SHARED_UNKNOWNS].reshape(*bars.unknown.shape, -1)[:, 3]
    return Scale(turn_scale, rescale_by(bars.unknown[:, 3], moved, bars.scale_std, scale.length))


def rescale_by(residual: np.ndarray, left: np.ndarray, std: np.ndarray, scale: float) -> float:
    """Factor of standard deviations (n,), before ``scale``, by residuals (n,) and samples of what is left (n, k)."""
    variance = (scale * std) ** 2
    redundant = (1.0 - (left**2).mean(axis=1) / variance).clip(0.0, 1.0)
    squared = np.minimum(residual**2 / variance, MAX_SQUARED_RESIDUAL)
    # in units of the errors as expected, whose weight is that of PRIOR_RESIDUALS residuals
    factor = (squared.sum() * scale**2 + PRIOR_RESIDUALS) / (redundant.sum() + PRIOR_RESIDUALS)
    return float(np.clip(np.sqrt(factor), 1.0 / MAX_RESCALING, MAX_RESCALING))


def hold_length(bars: Bars, links: Links, inliers: Inliers) -> tuple[np.ndarray, float]:
    """Derivative (count,) of the total length of the bars, and by how much it exceeds the distance driven [m].

    Both ends of a loop closure are a few centimetres apart, and loop closures that pull them together would shrink a
    map whose lengths are free. Only bars that a loop closure pulls count: a loose one would take up what the others
    lack.
    """
    pulled = np.zeros(len(bars.unknown))
    for end in (links.one, links.other):
        pulled[bars.row[end[inliers.mask]]] = 1.0
    length, scale = pulled * bars.along[bars.last], np.exp(bars.unknown[:, 3])
    held = np.zeros(bars.count)
    held[3:-SHARED_UNKNOWNS:4] = length * scale
    return held, float(length @ (scale - 1.0))


def carry(bars: Bars, samples: np.ndarray) -> np.ndarray:
    """Samples of the errors of readings' positions (r, 2, SAMPLES) [m] from those of the unknowns."""
    values = bars.derive(np.arange(len(bars.row)))[1][..., None]
    moved, shared = samples[:-SHARED_UNKNOWNS].reshape(*bars.unknown.shape, -1), samples[-SHARED_UNKNOWNS:]
    error = moved[bars.row, :2] + values[:, :, 3:, 0] @ shared
    for number in (2, 3):
        error += values[:, :, number - 1] * moved[bars.row, None, number]
    return error


def _carry_headings(bars: Bars, samples: np.ndarray, reading: np.ndarray) -> np.ndarray:
    columns, values = bars.derive_heading(reading)
    return np.einsum("nk,nks->ns", values, samples[columns])


def _add_turns(
    equations: Equations, bars: Bars, one: np.ndarray, other: np.ndarray, angle: np.ndarray, weight: np.ndarray
) -> None:
    (columns, values), (columns_other, values_other) = bars.derive_heading(one), bars.derive_heading(other)
    residual = wrap(bars.locate(other).heading - bars.locate(one).heading - angle)
    equations.add(
        np.concatenate([columns_other, columns], axis=1),
        np.concatenate([values_other, -values], axis=1),
        residual,
        weight,
    )


def _add_pairs(
    equations: Equations,
    bars: Bars,
    one: np.ndarray,
    other: np.ndarray,
    apart: np.ndarray,
    weight: np.ndarray,
    depends_on: slice,
) -> None:
    """Add residuals ``apart`` (n, 2) [m], which depend on the difference of the places of two readings."""
    (columns, values), (columns_other, values_other) = bars.derive(one), bars.derive(other)
    for axis in range(2):
        equations.add(
            np.concatenate([columns[:, axis, depends_on], columns_other[:, axis, depends_on]], axis=1),
            np.concatenate([values[:, axis, depends_on], -values_other[:, axis, depends_on]], axis=1),
            apart[:, axis],
            weight,
        )
