"""An initial map by the compass: segments laid end to end along its headings, then refined by loop closures.

A segment is a straight bar with four unknowns: its beginning (x, y), its heading and the logarithm of its length's
scale. The compass gives the differences of headings, the encoders the lengths, so the map can neither fold nor mirror.
Loop closures are believed only within a gate: a few standard deviations of the distance between their two ends, from
the covariance of the map itself, so that a place that only looks alike is never joined with one far away.

Covariances come from samples: solving the normal equations for residuals drawn from their own distribution gives
samples of the map's errors (Papandreou and Yuille, "Gaussian sampling by local perturbations", NIPS 2010), and one
factorisation serves all of them.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csc_array, eye_array
from scipy.sparse.linalg import splu

from deepgps.data.compass_turns import CompassTurns
from deepgps.data.segments import Segments
from deepgps.initial_map.isomap import LoopClosures

NEIGHBOURS = 3
ROUNDS = 12
SAMPLES = 32
GATE = 4.0
"""Standard deviations within which a loop closure is believed."""
LOOK = 0.25
"""Standard deviation of a loop closure at distance zero, in steps between readings."""
WIDTH = 3.0
"""Standard deviations at which a loop closure has lost three quarters of its weight."""
RIGID = 1e-3
"""Smallest standard deviation of the logarithm of a segment's length."""
FIXED = 1e-4
"""Standard deviation that holds the first bar in place: the map may move and turn freely [m], [rad]."""
LARGEST_TURN = 0.5
SHORTEST_M = 0.001
"""Shortest step between readings, where most encoders stick [m]."""
DAMPING = 1e-9


@dataclass(frozen=True)
class CompassMap:
    """A map and how well it is known.

    Attributes:
        places: Positions of the observations (N, 2) [m]; NaN for those on no segment.
        std: Standard deviation of each, along either axis, against the first segment (N,) [m].
        believed: Which loop closures lie within the gate (n,) bool.
    """

    places: np.ndarray
    std: np.ndarray
    believed: np.ndarray


@dataclass
class _Bars:
    """Bars with their readings, and the unknowns of each: x, y [m], heading [rad], logarithm of the scale."""

    row: np.ndarray
    observation: np.ndarray
    along: np.ndarray
    first: np.ndarray
    last: np.ndarray
    unknown: np.ndarray

    @property
    def axis(self) -> np.ndarray:
        """Unit vector along each bar (L, 2)."""
        return np.stack([np.cos(self.unknown[:, 2]), np.sin(self.unknown[:, 2])], axis=1)

    @property
    def ahead(self) -> np.ndarray:
        """Each reading's offset from the beginning of its bar (r, 2) [m]."""
        return self.axis[self.row] * (self.along * np.exp(self.unknown[self.row, 3]))[:, None]

    @property
    def point(self) -> np.ndarray:
        """Position of each reading (r, 2) [m]."""
        return self.unknown[self.row, :2] + self.ahead

    def derive(self, reading: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Columns (n, 2, 3) and values (n, 2, 3) of the derivatives of readings' positions, x and y."""
        bar, ahead = self.row[reading], self.ahead[reading]
        one = np.ones(len(reading))
        values = np.stack(
            [
                np.stack([one, -ahead[:, 1], ahead[:, 0]], axis=1),
                np.stack([one, ahead[:, 0], ahead[:, 1]], axis=1),
            ],
            axis=1,
        )
        columns = 4 * bar[:, None, None] + np.array([[0, 2, 3], [1, 2, 3]])
        return columns, values


class _Equations:
    """Weighted residuals and their derivatives, collected row by row."""

    def __init__(self) -> None:
        self.rows, self.columns, self.values = list[np.ndarray](), list[np.ndarray](), list[np.ndarray]()
        self.residual = list[np.ndarray]()
        self.count = 0

    def add(self, columns: np.ndarray, values: np.ndarray, residual: np.ndarray, weight: np.ndarray) -> None:
        """Add residuals (n,) with derivatives (n, k), each times its weight (n,), one over its standard deviation."""
        count, width = columns.shape
        self.rows.append(np.repeat(self.count + np.arange(count), width))
        self.columns.append(columns.ravel())
        self.values.append((np.broadcast_to(values, columns.shape) * weight[:, None]).ravel())
        self.residual.append(residual * weight)
        self.count += count

    def solve(self, held: np.ndarray, excess: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Gauss-Newton step (n,) and samples of the errors (n, SAMPLES).

        Args:
            held: Derivative of a sum that the step must make zero (n,).
            excess: What this sum is now.
            rng: Draws the samples.
        """
        unknowns = len(held)
        entries = np.concatenate(self.values), (np.concatenate(self.rows), np.concatenate(self.columns))
        jacobian = csc_array(entries, shape=(self.count, unknowns))
        normal = (jacobian.T @ jacobian).tocsc() + DAMPING * eye_array(unknowns, format="csc")
        solver = splu(normal.tocsc())
        drawn = rng.standard_normal((self.count, SAMPLES))
        step, samples = -solver.solve(jacobian.T @ np.concatenate(self.residual)), solver.solve(jacobian.T @ drawn)
        along = solver.solve(held)
        along /= held @ along
        return step - along * (held @ step + excess), samples - along[:, None] * (held @ samples)


def find_compass_map(
    segments: Segments,
    turns: CompassTurns,
    closures: LoopClosures,
    observations: int,
    length_std: np.ndarray,
    rng: np.random.Generator,
) -> CompassMap:
    """Lay the segments out and refine them by Gauss-Newton, with robust weights of the loop closures.

    Args:
        segments: Weak constraints, all of them, in the order driven.
        turns: Turns between them.
        closures: Loop closures.
        observations: Number of observations, N.
        length_std: Standard deviation of the logarithm of each segment's length (L,).
        rng: Draws the samples of the map's errors.
    """
    bars = _lay_out(segments, turns)
    reading = np.full(observations, -1)
    reading[bars.observation[::-1]] = np.arange(len(bars.row))[::-1]
    first, second, length = closures
    one, other = reading[first], reading[second]
    step = max(float(np.median(np.diff(bars.along)[np.diff(bars.row) == 0])), SHORTEST_M)
    variance = (LOOK * step) ** 2 + length**2 / 2.0
    there = (one >= 0) & (other >= 0) & (first < second)
    weight, believed = np.zeros(len(first)), np.zeros(len(first), bool)
    error = np.zeros((len(bars.row), 2, SAMPLES))
    for _ in range(ROUNDS):
        equations = _collect(bars, turns, length_std)
        if len(used := np.flatnonzero(believed)):
            _add_pairs(equations, bars, one[used], other[used], np.zeros(2), np.sqrt(weight[used] / variance[used]))
        step_taken, samples = equations.solve(*_hold_length(bars), rng)
        move = step_taken.reshape(-1, 4)
        move[:, 2:] = move[:, 2:].clip(-LARGEST_TURN, LARGEST_TURN)
        bars.unknown += move
        error = _carry(bars, samples)
        point = bars.point
        apart = ((point[one] - point[other]) ** 2).sum(axis=1)
        known = ((error[one] - error[other]) ** 2).mean(axis=2).sum(axis=1) / 2.0
        believed = there & (apart < 2.0 * GATE**2 * (known + variance))
        weight = (1.0 + apart / (2.0 * WIDTH**2 * variance)) ** -2.0
    places, std = np.full((observations, 2), np.nan), np.full(observations, np.nan)
    places[bars.observation] = bars.point
    std[bars.observation] = np.sqrt((error**2).mean(axis=2).sum(axis=1) / 2.0)
    return CompassMap(places, std, believed)


def _lay_out(segments: Segments, turns: CompassTurns) -> _Bars:
    """Lay the bars end to end, along the compass headings."""
    row, column = np.nonzero(segments.valid.numpy())
    along = segments.distance.double().numpy()[row, column]
    count = segments.count.numpy()
    last = np.cumsum(count) - 1
    heading = np.append(0.0, np.cumsum(turns.angle))
    axis = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    step = axis[:-1] * along[last[:-1], None] + _turn(axis[:-1], turns.jump)
    begin = np.concatenate([np.zeros((1, 2)), np.cumsum(step, axis=0)])
    unknown = np.column_stack([begin, heading, np.zeros(len(count))])
    return _Bars(row, segments.index.numpy()[row, column], along, last - count + 1, last, unknown)


def _collect(bars: _Bars, turns: CompassTurns, length_std: np.ndarray) -> _Equations:
    """Residuals of the compass, of bars that meet, and of lengths; and the first bar is held in place."""
    equations, number = _Equations(), np.arange(len(bars.unknown) - 1)
    turned = np.diff(bars.unknown[:, 2]) - turns.angle
    columns = np.stack([4 * number + 6, 4 * number + 2], axis=1)
    equations.add(columns, np.array([1.0, -1.0]), turned, 1.0 / turns.angle_std)
    jump = _turn(bars.axis[:-1], turns.jump)
    _add_pairs(equations, bars, bars.first[1:], bars.last[:-1], jump, 1.0 / turns.jump_std)
    scale = 4 * np.arange(len(bars.unknown))[:, None] + 3
    equations.add(scale, np.ones(1), bars.unknown[:, 3], 1.0 / np.maximum(length_std, RIGID))
    equations.add(np.arange(3)[:, None], np.ones(1), np.zeros(3), np.full(3, 1.0 / FIXED))
    return equations


def _hold_length(bars: _Bars) -> tuple[np.ndarray, float]:
    """Derivative (4 L,) of the total length of the bars, and by how much it exceeds the distance driven [m].

    Both ends of a loop closure are a few centimetres apart, and loop closures that pull them together would shrink a
    map whose lengths are free.
    """
    length, scale = bars.along[bars.last], np.exp(bars.unknown[:, 3])
    held = np.zeros(bars.unknown.shape)
    held[:, 3] = length * scale
    return held.ravel(), float(length @ (scale - 1.0))


def _add_pairs(
    equations: _Equations, bars: _Bars, one: np.ndarray, other: np.ndarray, jump: np.ndarray, weight: np.ndarray
) -> None:
    """Add, for x and y, the differences of the readings ``one`` and ``other`` (n,) from ``jump`` (n, 2) [m]."""
    point = bars.point
    apart = point[one] - point[other] - jump
    (columns, values), (columns_other, values_other) = bars.derive(one), bars.derive(other)
    for axis in range(2):
        equations.add(
            np.concatenate([columns[:, axis], columns_other[:, axis]], axis=1),
            np.concatenate([values[:, axis], -values_other[:, axis]], axis=1),
            apart[:, axis],
            weight,
        )


def _carry(bars: _Bars, samples: np.ndarray) -> np.ndarray:
    """Samples of the errors of readings' positions (r, 2, SAMPLES) [m] from those of the unknowns."""
    columns, values = bars.derive(np.arange(len(bars.row)))
    return np.einsum("rak,raks->ras", values, samples[columns])


def _turn(axis: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Vectors (n, 2) given in frames whose first axis is ``axis`` (n, 2)."""
    (c, s), (x, y) = axis.T, vector.T
    return np.stack([c * x - s * y, s * x + c * y], axis=1)
