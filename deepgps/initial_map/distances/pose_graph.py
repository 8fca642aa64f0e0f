"""Refinement of an initial map: segments as bars, connected by loop closures (Lu and Milios 1997).

A straight segment is a bar with its observations at the distances travelled; its unknowns are its middle (x, y) and
heading. Where a segment begins at the end of the last one, the two bars meet; at a loop closure, the two observations
nearly coincide. A few loop closures are false, such as the undersides of two desks: they lose their weight as the scale
of the robust weights shrinks (graduated non-convexity with Geman and McClure's cost; Yang et al. 2020).

In the last refinement readings may lie unevenly on their bars, as far as the encoders are noisy. Errors of the gaps
between readings add up along a segment to a random walk, which is a sum of cosines with independent coefficients
(Karhunen and Loeve). The first few of each bar become unknowns. The noise of the gaps is estimated with them, without
the truth: exact encoders leave bars rigid. Its distribution has heavy tails (Student's t; Lange et al. 1989), so bars
on which a wheel stuck may change their length by much and do not loosen the others.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from scipy.sparse import csc_array, csr_array, diags_array, eye_array, vstack
from scipy.sparse.linalg import SuperLU

from deepgps.data.segments import Segments, measure_spacing
from deepgps.initial_map.compass.factors import Factors
from deepgps.initial_map.compass.least_squares import factorise
from deepgps.initial_map.distances.isomap import LoopClosures

ROUNDS = 12
FIRST_ROBUST_SCALE, LAST_ROBUST_SCALE = 32.0, 1.0
"""Scale of the robust weights in the first and the last round, in steps between readings."""
LOOK_STD, MEETING_STD = 0.25, 0.06
"""Standard deviations of a loop closure at distance zero and of two bars that meet, in steps between readings."""
FACTOR_SCALE = 3.0  # Scale of the robust weights of registrations in the last round, in standard deviations
MAX_TURN = 0.5
DAMPING = 1e-9


class PoseGraph(NamedTuple):
    """Readings on bars, the pairs of them that should coincide, and differences of places that should vanish.

    These are the differences of all pairs, and the residuals of registrations, if any, after them.
    """

    observation: np.ndarray  # Observation of each reading (r,)
    along: np.ndarray  # Distance of each from the mean of its segment's readings (r,) [m]
    bar: np.ndarray  # Bar of each, counted from 0 (r,)
    a: np.ndarray  # First reading of each pair (p,)
    b: np.ndarray  # Second reading of each pair (p,)
    mix: csr_array  # Weights of the readings' points in each difference (d, r)
    offset: np.ndarray  # What each difference should be (d, 2) [m]
    firm: np.ndarray  # Whether it is of one observation, at which two bars meet (d,) bool
    weight: np.ndarray  # Its inverse expected square (d,) [1 / m^2]
    reach: np.ndarray  # Scale of its robust weights, over that of loop closures (d,)
    step: float  # Median distance between consecutive readings [m]


def relax(places: np.ndarray, segments: Segments, closures: LoopClosures) -> tuple[np.ndarray, float]:
    """Move all segments, as rigid bars, from places (N, 2) [m] to where they fit one another; NaN stay NaN.

    Minimises ``sum_l w_l |p_i - p_j|^2`` over each bar's middle and heading by Gauss-Newton, with ``w_l = s_l^-2 (1 +
    |p_i - p_j|^2 / b^2)^-2``, ``s_l`` the expected difference and ``b`` the scale. Two bars always meet in an
    observation that they share: there ``w_l = s_l^-2``. Each loop closure is a pair in both orders.

    Returns positions (N, 2) float64 [m], as they were where on no segment, and the cost: the sum of ``s_l^-2 |p_i -
    p_j|^2 / (1 + |p_i - p_j|^2 / b^2)`` with the last b, without the divisor where two bars meet.
    """
    graph = build_pose_graph(segments, closures, np.asarray(np.isfinite(places).all(axis=1)))
    middle, heading = lay_bars(places[graph.observation], graph)
    for scale in graph.step * np.geomspace(FIRST_ROBUST_SCALE, LAST_ROBUST_SCALE, ROUNDS):
        ahead = point_along(heading, graph, graph.along)
        apart = graph.mix @ (middle[graph.bar] + ahead) - graph.offset
        jacobian, trust = derive_apart(graph, move_rigidly(ahead)), np.tile(weigh(graph, apart, scale), 2)
        pull = jacobian.T @ (trust * apart.T.ravel())
        move = -factorise(make_normal(jacobian, trust)).solve(pull).reshape(-1, 3)
        middle += move[:, :2]
        heading += move[:, 2].clip(-MAX_TURN, MAX_TURN)
    point = middle[graph.bar] + point_along(heading, graph, graph.along)
    squared = ((graph.mix @ point - graph.offset) ** 2).sum(axis=1)
    robust = np.where(graph.firm, squared, squared / (1.0 + squared / (LAST_ROBUST_SCALE * graph.step) ** 2))
    found = np.array(places, float)
    found[graph.observation] = point
    return found, float((graph.weight * robust).sum())


def build_pose_graph(
    segments: Segments, closures: LoopClosures, placed: np.ndarray, factors: Factors | None = None
) -> PoseGraph:
    """Bars, pairs of readings and registrations of the observations ``placed`` (N,) bool. Arguments as in ``relax``."""
    index = segments.index.numpy()
    row, column = np.nonzero(segments.valid.numpy() & placed[index])
    observation, along = index[row, column], _from_middle(segments)[row, column]
    bar = np.unique(row, return_inverse=True)[1]
    step = measure_spacing(np.diff(along)[np.diff(bar) == 0])
    reading = np.full(len(placed), -1)
    reading[observation[::-1]] = np.arange(len(bar))[::-1]
    meet = np.flatnonzero(reading[observation] != np.arange(len(bar)))
    first, second, length = closures
    known = (reading[first] >= 0) & (reading[second] >= 0) & (first < second)
    a = np.concatenate([reading[first[known]], reading[observation[meet]]])
    b = np.concatenate([reading[second[known]], meet])
    firm = np.arange(len(a)) >= known.sum()
    weight = 1.0 / np.where(
        firm, (MEETING_STD * step) ** 2, (LOOK_STD * step) ** 2 + np.pad(length[known], (0, len(meet))) ** 2
    )
    pairs, size = np.arange(len(a)), (len(a), len(bar))
    mix = csr_array((np.ones(len(a)), (pairs, a)), size) - csr_array((np.ones(len(a)), (pairs, b)), size)
    graph = PoseGraph(observation, along, bar, a, b, mix, np.zeros((len(a), 2)), firm, weight, np.ones(len(a)), step)
    return graph if factors is None else add_factors(graph, factors.number(reading))


def add_factors(graph: PoseGraph, factors: Factors) -> PoseGraph:
    """The graph with registrations, which are numbered by reading, after the pairs."""
    count, many = factors.others.shape
    rows, size = np.arange(count), (count, len(graph.bar))
    others = csr_array((factors.weight.ravel(), (rows.repeat(many), factors.others.ravel())), size)
    mix = csr_array((np.ones(count), (rows, factors.one)), size) - others
    return graph._replace(
        mix=vstack([graph.mix, mix]).tocsr(),
        offset=np.concatenate([graph.offset, factors.offset]),
        firm=np.concatenate([graph.firm, np.zeros(count, bool)]),
        weight=np.concatenate([graph.weight, 1.0 / factors.variance]),
        reach=np.concatenate([graph.reach, FACTOR_SCALE * np.sqrt(factors.variance) / graph.step]),
    )


def _from_middle(segments: Segments) -> np.ndarray:
    valid = segments.valid
    distance = segments.distance.double() * valid
    return (distance - (distance.sum(dim=1) / segments.count)[:, None]).numpy()


def lay_bars(point: np.ndarray, graph: PoseGraph) -> tuple[np.ndarray, np.ndarray]:
    """Middle (L, 2) [m] and heading (L,) [rad] of the bars that fit the readings' points (r, 2) best."""
    bar, count = graph.bar, np.bincount(graph.bar)
    middle = np.stack([np.bincount(bar, point[:, axis]) / count for axis in range(2)], axis=1)
    pull = [np.bincount(bar, graph.along * point[:, axis]) for axis in range(2)]
    return middle, np.arctan2(pull[1], pull[0])


def point_along(heading: np.ndarray, graph: PoseGraph, distance: np.ndarray) -> np.ndarray:
    """Offsets (r, 2) [m] of readings that are ``distance`` (r,) [m] ahead of the middle of their bars."""
    return np.stack([np.cos(heading), np.sin(heading)], axis=1)[graph.bar] * distance[:, None]


def move_rigidly(ahead: np.ndarray) -> np.ndarray:
    """How readings at offsets (r, 2) from their bars' middles move with x, y [m] and heading [rad] (r, 2, 3)."""
    one, none = np.ones(len(ahead)), np.zeros(len(ahead))
    return np.stack([one, none, -ahead[:, 1], none, one, ahead[:, 0]], axis=1).reshape(-1, 2, 3)


def derive_apart(graph: PoseGraph, moves: np.ndarray) -> csc_array:
    """Derivatives (2 d, k L) of all differences, in x, then y; readings move by (r, 2, k) with k unknowns."""
    (readings, _, unknowns), bars = moves.shape, int(graph.bar[-1]) + 1
    columns = (unknowns * graph.bar[:, None] + np.arange(unknowns)).ravel()
    where, size = (np.repeat(np.arange(readings), unknowns), columns), (readings, unknowns * bars)
    return csc_array(vstack([graph.mix @ csr_array((moves[:, axis].ravel(), where), size) for axis in range(2)]))


def make_normal(jacobian: csc_array, trust: np.ndarray) -> csc_array:
    """Normal equations of residuals with weights (n,), damped, because the map may move and turn freely.

    So a bar that no link reaches stays, even if there is no link.
    """
    normal = (jacobian.T @ jacobian.multiply(trust[:, None]).tocsc()).tocsc()
    return normal + DAMPING * (normal.diagonal().max() or 1.0) * eye_array(normal.shape[0], format="csc")


def weigh(graph: PoseGraph, apart: np.ndarray, scale: float) -> np.ndarray:
    """Robust weights (d,) [1 / m^2] of differences that are ``apart`` (d, 2) [m], by ``scale`` [m]."""
    robust = (1.0 + (apart**2).sum(axis=1) / (scale * graph.reach) ** 2) ** -2
    return graph.weight * np.where(graph.firm, 1.0, robust)


COSINES = 3  # Cosines of each bar; with more, the map is hardly better
FIRST_NOISE, MIN_NOISE = 0.1, 1e-4
"""Noise of a gap, relative to it, in the first round, and the least that is assumed."""
FIRST_UNEVEN_SCALE, LAST_UNEVEN_SCALE, UNEVEN_ROUNDS = 4.0, 1.0, 8
"""Scale of the robust weights in the first and the last round, in steps between readings."""
FINAL_NOISE_WEIGHT, FINAL_ROUNDS = 0.6, 2
"""In the last rounds, which estimate no noise, it counts this much: loop closures pull bars together."""
SAMPLES = 8  # Samples of the errors of the coefficients, for their mean square
COEFFICIENT_FREEDOM = 4.0
"""Degrees of freedom of the coefficients' distribution: a bar whose wheel stuck errs more than noise explains."""


class Relaxed(NamedTuple):
    """A map, and what it says of the encoders."""

    places: np.ndarray  # Positions (N, 2) float64 [m]; observations on no segment keep theirs
    segments: Segments  # The segments, with the distances that their readings have on the map
    noise: float  # Standard deviation of a gap, relative to it


class Normal(NamedTuple):
    """Normal equations of one round."""

    jacobian: csc_array  # Derivatives of the differences (2 d, u)
    trust: np.ndarray  # Weights of these (2 d,) [1 / m^2]
    prior: np.ndarray  # Inverse variances of the unknowns (u,)
    factors: SuperLU  # Of the normal equations


class UnevenBars:
    """Bars and their unknowns (L, 3 + COSINES): x, y [m], heading [rad] and the coefficients of the cosines [m].

    ``noise`` is the standard deviation of a gap, relative to it; ``usual`` (L,) the inverse of the factor by which the
    variance of each bar exceeds that of such noise.
    """

    def __init__(self, graph: PoseGraph, places: np.ndarray) -> None:
        self.noise, self._graph, bar = FIRST_NOISE, graph, graph.bar
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

    def move(self, scale: float, noise: float) -> Normal:
        """Move the bars by a Gauss-Newton step with robust weights of ``scale`` [m] and a gap's noise.

        The sum of usual lengths stays, as the map has no other scale.
        """
        graph, (point, ahead) = self._graph, self.place()
        jacobian, apart = derive_apart(graph, self.derive(ahead)), graph.mix @ point - graph.offset
        trust = np.tile(weigh(graph, apart, scale), 2)
        prior = np.zeros_like(self.unknown)
        prior[:, 3:] = self.usual[:, None] / (noise * self._std) ** 2
        factors = factorise((make_normal(jacobian, trust) + diags_array(prior.ravel())).tocsc())
        pull = jacobian.T @ (trust * apart.T.ravel()) + (prior * self.unknown).ravel()
        longer = self.usual[:, None] * self._longer
        step, scaled = (factors.solve(right).reshape(prior.shape) for right in (-pull, longer.ravel()))
        step -= scaled * (longer * (self.unknown + step)).sum() / (longer * scaled).sum()
        step[:, 2] = step[:, 2].clip(-MAX_TURN, MAX_TURN)
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
        self.usual = (COEFFICIENT_FREEDOM + COSINES) / (COEFFICIENT_FREEDOM + squared.sum(axis=1) / self.noise**2)
        self.noise = max(float((self.usual[:, None] * squared).mean()) / self.noise, MIN_NOISE)


def relax_unevenly(
    places: np.ndarray,
    segments: Segments,
    closures: LoopClosures,
    rng: np.random.Generator,
    factors: Factors | None = None,
) -> Relaxed:
    """Move all segments, and their readings along them, to where they fit one another; arguments as for ``relax``.

    Minimises the cost of ``relax``, also of registrations, if any, plus ``sum (c_k / (w s_k))^2`` over the bars'
    middles, headings and coefficients ``c_k``, with ``s_k = sqrt(2 n) g / (k pi)`` for n gaps of length g of noise w,
    of which ``rng`` draws samples.
    """
    placed = np.asarray(np.isfinite(places).all(axis=1))
    graph = build_pose_graph(segments, closures, placed, factors)
    bars = UnevenBars(graph, places)
    for scale in graph.step * np.geomspace(FIRST_UNEVEN_SCALE, LAST_UNEVEN_SCALE, UNEVEN_ROUNDS):
        bars.estimate_noise(bars.move(scale, bars.noise), rng)
    for _ in range(FINAL_ROUNDS):
        bars.move(graph.step * LAST_UNEVEN_SCALE, FINAL_NOISE_WEIGHT * bars.noise)
    found, distance = np.array(places, float), segments.distance.clone()
    found[graph.observation] = bars.place()[0]
    on_graph = segments.valid & torch.from_numpy(placed)[segments.index]
    distance[on_graph] += torch.from_numpy(bars.measure_errors()).to(distance.dtype)
    return Relaxed(found, replace(segments, distance=distance), bars.noise)
