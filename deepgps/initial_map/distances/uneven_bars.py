"""Last refinement of an initial map: bars whose readings may lie unevenly, as far as the encoders are noisy.

Errors of the gaps between readings add up along a segment to a random walk, which is a sum of cosines with independent
coefficients (Karhunen and Loeve). The first few of each bar become unknowns. The noise of the gaps is estimated with
them, without the truth: exact encoders leave bars rigid. Its distribution has heavy tails (Student's t; Lange et al.
1989), so bars on which a wheel stuck may change their length by much and do not loosen the others.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from scipy.sparse import csc_array, diags_array
from scipy.sparse.linalg import SuperLU

from deepgps.data.segments import Segments
from deepgps.initial_map.distances.isomap import LoopClosures
from deepgps.initial_map.distances.pose_graph import (
    LARGEST_TURN,
    PoseGraph,
    build_pose_graph,
    derive_apart,
    lay_bars,
    make_normal,
    move_rigidly,
    point_along,
    weigh,
)
from deepgps.initial_map.least_squares import factorise

COSINES = 3
"""Cosines of each bar; with more, the map is hardly better."""
NOISE_FIRST, NOISE_LEAST = 0.1, 1e-4
"""Noise of a gap, relative to it, in the first round, and the least that is assumed."""
BELIEVED_FIRST, BELIEVED_LAST, ROUNDS = 4.0, 1.0, 8
"""Scale of the robust weights in the first and the last round, in steps between readings."""
HELD, SETTLED = 0.6, 2
"""In the last rounds, which estimate no noise, it counts this much: loop closures pull bars together."""
SAMPLES = 8
"""Samples of the errors of the coefficients, for their mean square."""
TAILS = 4.0
"""Degrees of freedom of the coefficients' distribution: a bar whose wheel stuck errs more than noise explains."""


class Relaxed(NamedTuple):
    """A map, and what it says of the encoders.

    Attributes:
        places: Positions (N, 2) float64 [m]; observations on no segment keep theirs.
        segments: The segments, with the distances that their readings have on the map.
        noise: Standard deviation of a gap, relative to it.
    """

    places: np.ndarray
    segments: Segments
    noise: float


class Normal(NamedTuple):
    """Normal equations of one round.

    Attributes:
        jacobian: Derivatives of the pairs' differences (2 p, u).
        trust: Weights of these (2 p,) [1 / m^2].
        prior: Inverse variances of the unknowns (u,).
        factors: Of the normal equations.
    """

    jacobian: csc_array
    trust: np.ndarray
    prior: np.ndarray
    factors: SuperLU


class UnevenBars:
    """Bars and their unknowns: x, y [m], heading [rad] and the coefficients of the cosines [m].

    Attributes:
        noise: Standard deviation of a gap, relative to it.
        usual: Inverse of the factor by which the variance of each bar exceeds that of such noise (L,).
        unknown: Unknowns of each bar (L, 3 + COSINES).
    """

    def __init__(self, graph: PoseGraph, places: np.ndarray) -> None:
        self.noise, self._graph, bar = NOISE_FIRST, graph, graph.bar
        middle, heading = lay_bars(places[graph.observation], graph)
        self.unknown = np.concatenate([middle, heading[:, None], np.zeros((len(heading), COSINES))], axis=1)
        self.usual = np.ones(len(heading))
        first = np.flatnonzero(np.diff(bar, prepend=-1))
        begin = np.minimum.reduceat(graph.along, first)
        length = (np.maximum.reduceat(graph.along, first) - begin).clip(graph.step)
        order, gaps = np.pi * np.arange(1, COSINES + 1), (np.bincount(bar) - 1).clip(1)
        self._std = (np.sqrt(2.0 / gaps) * length)[:, None] / order  # for a noise of 1
        cosine = np.cos(((graph.along - begin[bar]) / length[bar])[:, None] * order)
        self._cosine = cosine - (np.add.reduceat(cosine, first) / np.bincount(bar)[:, None])[bar]
        self._longer = np.append(np.zeros(3), np.cos(order) - 1.0)

    def place(self) -> tuple[np.ndarray, np.ndarray]:
        """Points of the readings and their offsets from the middles of their bars (r, 2) [m]."""
        ahead = point_along(self.unknown[:, 2], self._graph, self._graph.along + self.measure_errors())
        return self.unknown[self._graph.bar, :2] + ahead, ahead

    def measure_errors(self) -> np.ndarray:
        """What the readings' distances lack (r,) [m]."""
        return (self._cosine * self.unknown[self._graph.bar, 3:]).sum(axis=1)

    def derive(self, ahead: np.ndarray) -> np.ndarray:
        """How readings at offsets (r, 2) from their bars' middles move with the unknowns (r, 2, 3 + COSINES)."""
        along = point_along(self.unknown[:, 2], self._graph, np.ones(len(ahead)))
        return np.concatenate([move_rigidly(ahead), along[:, :, None] * self._cosine[:, None]], axis=2)

    def move(self, believed: float, noise: float) -> Normal:
        """Move the bars by one Gauss-Newton step; the sum of usual lengths stays, as the map has no other scale.

        Args:
            believed: Scale of the robust weights [m].
            noise: Standard deviation of a gap, relative to it.
        """
        graph, (point, ahead) = self._graph, self.place()
        jacobian, apart = derive_apart(graph, self.derive(ahead)), point[graph.a] - point[graph.b]
        trust = np.tile(weigh(graph, apart, believed), 2)
        prior = np.zeros_like(self.unknown)
        prior[:, 3:] = self.usual[:, None] / (noise * self._std) ** 2
        factors = factorise((make_normal(jacobian, trust) + diags_array(prior.ravel())).tocsc())
        pull = jacobian.T @ (trust * apart.T.ravel()) + (prior * self.unknown).ravel()
        longer = self.usual[:, None] * self._longer
        step, scaled = (factors.solve(right).reshape(prior.shape) for right in (-pull, longer.ravel()))
        step -= scaled * (longer * (self.unknown + step)).sum() / (longer * scaled).sum()
        step[:, 2] = step[:, 2].clip(-LARGEST_TURN, LARGEST_TURN)
        self.unknown += step
        return Normal(jacobian, trust, prior.ravel(), factors)

    def estimate_noise(self, normal: Normal, rng: np.random.Generator) -> None:
        """Expectation maximisation for Student's t distribution, with samples of the coefficients' errors.

        The step is twice as long, in the logarithm, since it is slow where there is little noise.
        """
        jacobian, trust, prior, factors = normal
        drawn = jacobian.T @ (np.sqrt(trust)[:, None] * rng.standard_normal((len(trust), SAMPLES)))
        drawn += np.sqrt(prior)[:, None] * rng.standard_normal((len(prior), SAMPLES))
        error = factors.solve(drawn).reshape(*self.unknown.shape, SAMPLES)[:, 3:]
        squared = (self.unknown[:, 3:] ** 2 + (error**2).mean(axis=2)) / self._std**2
        self.usual = (TAILS + COSINES) / (TAILS + squared.sum(axis=1) / self.noise**2)
        self.noise = max(float((self.usual[:, None] * squared).mean()) / self.noise, NOISE_LEAST)


def relax_unevenly(places: np.ndarray, segments: Segments, closures: LoopClosures, rng: np.random.Generator) -> Relaxed:
    """Move all segments, and their readings along them, to where they fit one another.

    Minimises the cost of ``pose_graph.relax`` plus ``sum (c_k / (w s_k))^2`` over the bars' middles, headings and
    coefficients ``c_k``, with ``s_k = sqrt(2 n) g / (k pi)`` for n gaps of length g of noise w.

    Args:
        places: Initial positions of the observations (N, 2) [m]; those that are NaN stay NaN.
        segments: Weak constraints.
        closures: Loop closures, each pair in both orders.
        rng: Draws the samples.
    """
    placed = np.asarray(np.isfinite(places).all(axis=1))
    graph = build_pose_graph(segments, closures, placed)
    bars = UnevenBars(graph, places)
    for believed in graph.step * np.geomspace(BELIEVED_FIRST, BELIEVED_LAST, ROUNDS):
        bars.estimate_noise(bars.move(believed, bars.noise), rng)
    for _ in range(SETTLED):
        bars.move(graph.step * BELIEVED_LAST, HELD * bars.noise)
    found, distance = np.array(places, float), segments.distance.clone()
    found[graph.observation] = bars.place()[0]
    on_graph = segments.valid & torch.from_numpy(placed)[segments.index]
    distance[on_graph] += torch.from_numpy(bars.measure_errors()).to(distance.dtype)
    return Relaxed(found, replace(segments, distance=distance), bars.noise)
