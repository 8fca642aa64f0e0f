"""The map from which training starts, found without a network: rough maps, each relaxed, the best kept and refined.

Maps by shortest paths are bent by furniture, which may mirror a region; maps by straightness need bars that cross
often. So both are tried, and judged by how well segments and loop closures fit one another, and by whether places that
look unlike lie on top of one another.

Straightness: along a segment, each coordinate of the position is a linear function of the distance driven, with two
unknowns: its value at the middle of the bar and its slope. At a loop closure, the functions of two bars are equal. If
bars cross often enough, only constants and linear functions of the true position satisfy all these equations, whatever
the shape of the room. So the two slowest modes of a linear problem are the coordinates up to an affine map, which
follows from slopes of unit length. A part that few bars reach has slow modes of its own, so maps of more modes are made
too; and false loop closures, which bend all modes, lose their weight round by round (iteratively reweighted least
squares).

Distances along segments leave open which of two mirrored maps is right; turns tell it, even by wheels that slip so far
that their path is useless. The ground truth is not used.
"""

from collections.abc import Iterator

import numpy as np
import torch
from scipy.sparse import csc_array, csr_array, diags_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import ArpackError, LinearOperator, eigsh

from deepgps.data.segments import Segments, subsample
from deepgps.initial_map.compass.factors import Factors
from deepgps.initial_map.compass.least_squares import factorise
from deepgps.initial_map.distances.folding import measure_overlap
from deepgps.initial_map.distances.isomap import NEIGHBOURS, LoopClosures, find_loop_closures, map_by_paths
from deepgps.initial_map.distances.pose_graph import PoseGraph, build_pose_graph, relax, relax_unevenly

MODES, USED_MODES = 16, (2, 3, 4, 5)
"""Modes that are computed, and how many of those that spread over the map are used for each map that is tried."""
MIN_MODE_SHARE = 0.04
"""Least share of the bars on which a mode must live; modes of fewer bars are those of bars that hang loose."""
ROBUST_SCALES = (32.0, 16.0, 8.0, 4.0, 2.0)  # Scales of the robust weights, round by round, in steps between readings
LENGTH_ROUNDS, LENGTH_ERROR = 5, 0.3
"""Rounds in which the slopes' lengths are fitted robustly, and the scale of their errors, relative to the length."""
RIDGE = 1e-9

Modes = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Values at the middles of the bars and slopes (L, k), and the firmness of the bars (L,); see ``find_modes``."""


def find_affine_maps(count: int, segments: Segments, closures: LoopClosures) -> Iterator[np.ndarray]:
    """Yield rough positions (N, 2) [m] of ``count`` observations, each in a frame of its own.

    They are NaN outside the largest connected part. Where bars hardly cross there may be no map. The loop closures hold
    each pair in both orders.
    """
    graph = _keep_largest_part(count, segments, closures)
    plain = _find_modes_if_any(graph, np.ones(len(graph.a)))
    for used in USED_MODES:
        places = _lay_out(graph, plain, used, count)
        if places is None:
            return
        yield places
        for scale in ROBUST_SCALES:
            point = places[graph.observation]
            squared = ((point[graph.a] - point[graph.b]) ** 2).sum(axis=1)  # of readings that should coincide
            trust = (1.0 + squared / (scale * graph.step) ** 2) ** -2
            robust = _lay_out(graph, _find_modes_if_any(graph, trust), used, count)
            if robust is None:
                break
            places = robust
        yield places


def find_modes(graph: PoseGraph, trust: np.ndarray) -> Modes:
    """Slowest modes: functions that are linear along each bar and nearly equal where two readings coincide.

    Minimises ``sum_p t_p w_p (z_a - z_b)^2`` over ``z = m + c u`` of each reading at the distance c from its bar's
    middle, with ``sum_l d_l u_l^2 = 1`` and the pairs' trust t (p,). The firmness ``d_l`` is how well other bars hold
    the slope of a bar, were they fixed. Only modes that spread over the map are returned, the slowest first.
    """
    bars, weight = int(graph.bar[-1]) + 1, graph.weight * trust
    normal, firm = _join_bars(graph, weight), _measure_firmness(graph, weight)
    held = diags_array(np.concatenate([np.zeros(bars), firm])).tocsc()
    solve = factorise(normal).solve
    inverse = LinearOperator(normal.shape, solve, dtype=float)  # pyright: ignore[reportCallIssue] (its stub errs)
    # The slowest modes have the largest eigenvalues of the inverse problem, in which those of constants are zero.
    speed, modes = eigsh(held, min(MODES, bars - 1), normal, Minv=inverse, which="LM", v0=np.ones(2 * bars))
    modes = modes[:, np.argsort(-speed)]
    share = firm[:, None] * modes[bars:] ** 2
    spread = share.sum(axis=0) ** 2 / (share**2).sum(axis=0).clip(1e-300) > MIN_MODE_SHARE * bars
    return modes[:bars, spread], modes[bars:, spread], firm


def find_plane(slope: np.ndarray, firm: np.ndarray) -> np.ndarray:
    """Axes (k, 2) that turn slopes (L, k) of modes into unit vectors (L, 2), as nearly as possible.

    Fits the metric M with ``u^T M u = 1`` for all slopes u, by robust least squares weighted by the bars' firmness
    (L,), and takes its two main axes.
    """
    one, other = np.triu_indices(slope.shape[1])
    product = slope[:, one] * slope[:, other] * np.where(one == other, 1.0, 2.0)
    trust = np.ones(len(slope))
    metric = np.zeros((slope.shape[1],) * 2)
    for _ in range(LENGTH_ROUNDS):
        weight = np.sqrt(firm) * trust
        found = np.linalg.lstsq(product * weight[:, None], weight, rcond=None)[0]
        trust = 1.0 / (1.0 + ((product @ found - 1.0) / LENGTH_ERROR) ** 2)
    metric[one, other] = metric[other, one] = found
    size, axes = np.linalg.eigh(metric)
    return axes[:, -2:] * np.sqrt(size[-2:].clip(1e-9))


def _find_modes_if_any(graph: PoseGraph, trust: np.ndarray) -> Modes | None:
    if graph.bar[-1] < min(USED_MODES):
        return None
    try:
        return find_modes(graph, trust)
    except ArpackError:  # no bar is held firmly
        return None


def _lay_out(graph: PoseGraph, modes: Modes | None, used: int, count: int) -> np.ndarray | None:
    # Rough positions (N, 2) [m] by a number of modes; None if there are fewer.
    if modes is None or modes[1].shape[1] < used:
        return None
    middle, slope, firm = modes
    plane = find_plane(slope[:, :used], firm)
    ahead = slope[:, :used] @ plane
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True).clip(1e-300)
    places = np.full((count, 2), np.nan)
    places[graph.observation] = (middle[:, :used] @ plane)[graph.bar] + graph.along[:, None] * ahead[graph.bar]
    return places


def _join_bars(graph: PoseGraph, weight: np.ndarray) -> csc_array:
    # Normal equations (2 L, 2 L) of the pairs, for the bars' middles and then their slopes; damped, as all may move.
    bars, pairs, one = int(graph.bar[-1]) + 1, np.arange(len(graph.a)), np.ones(len(graph.a))
    middle = np.concatenate([graph.bar[graph.a], graph.bar[graph.b]])
    values = np.concatenate([one, -one, graph.along[graph.a], -graph.along[graph.b]])
    entries = values, (np.tile(pairs, 4), np.concatenate([middle, bars + middle]))
    apart = csc_array(entries, shape=(len(pairs), 2 * bars))
    normal = apart.T @ apart.multiply(weight[:, None]).tocsc()
    size = normal.diagonal()
    return (normal + RIDGE * diags_array(size.clip(1e-3 * np.median(size)))).tocsc()


def _measure_firmness(graph: PoseGraph, weight: np.ndarray) -> np.ndarray:
    # sum w c^2 - (sum w c)^2 / sum w of each bar (L,): zero where other bars touch it at one place only.
    end, both = np.concatenate([graph.a, graph.b]), np.concatenate([weight, weight])
    bars = int(graph.bar[-1]) + 1
    total, first, second = (np.bincount(graph.bar[end], both * graph.along[end] ** power, bars) for power in range(3))
    return (second - first**2 / total.clip(1e-300)).clip(0.0)


def _keep_largest_part(count: int, segments: Segments, closures: LoopClosures) -> PoseGraph:
    graph = build_pose_graph(segments, closures, np.ones(count, bool))
    bars = int(graph.bar[-1]) + 1
    joined = csr_array((np.ones(len(graph.a)), (graph.bar[graph.a], graph.bar[graph.b])), shape=(bars, bars))
    part = connected_components(joined, directed=False)[1][graph.bar]
    placed = np.zeros(count, bool)
    placed[graph.observation[part == np.bincount(part).argmax()]] = True
    return build_pose_graph(segments, closures, placed)


def find_chirality(positions: np.ndarray, segments: Segments, angle: np.ndarray) -> int:
    """Return 1 if a map's turns have the direction of those measured (L - 1,) [rad], -1 if the map is mirrored.

    ``positions`` (N, 2) [m] are predictions of all training observations; turns lead from each segment to the next.
    """
    rows = torch.arange(len(segments.count))
    last = segments.index[rows, segments.count - 1].numpy()
    x, y = (positions[last] - positions[segments.index[:, 0].numpy()]).T
    mapped = np.diff(np.arctan2(y, x))
    # Half turns carry no information about left and right; quarter turns carry the most.
    return 1 if (np.sin(mapped) * np.sin(angle)).sum() >= 0.0 else -1


OVERLAP_SCALE = 0.1
"""Part of the observations that look unlike their neighbours on the map which counts as much as the whole cost."""


def find_initial_map(
    features: torch.Tensor, segments: Segments, generator: torch.Generator
) -> tuple[np.ndarray, Segments]:
    """Positions (N, 2) [m] of observations with features (N, K), in an arbitrary frame; NaN outside the largest part.

    The segments are returned too, with the distances that their readings have on this map: those of the encoders, as
    far as these are exact. Raises InputError if the segments are not connected.
    """
    graphs = find_loop_closures(features, segments, NEIGHBOURS)
    rough = [map_by_paths(len(features), segments, closures, generator) for closures in graphs]
    rough += find_affine_maps(len(features), segments, graphs[0])
    same = generator.get_state()

    def judge(found: tuple[np.ndarray, float]) -> float:
        places, cost = found
        return cost * (1.0 + measure_overlap(places, features, segments, generator.set_state(same)) / OVERLAP_SCALE)

    best = min((relax(places, segments, graphs[0]) for places in rough), key=judge)[0]
    relaxed = relax_unevenly(best, segments, graphs[0], np.random.default_rng(generator.initial_seed()))
    return relaxed.places, relaxed.segments


def refine(
    places: np.ndarray, features: torch.Tensor, segments: Segments, factors: Factors, rng: np.random.Generator
) -> np.ndarray:
    """Positions (N, 2) [m] moved so that images are also where they are registered on one another; NaN stay NaN."""
    sample, chosen = subsample(segments, len(features))
    number, moved = np.full(len(features), -1), places.copy()
    number[chosen] = np.arange(len(chosen))
    closures = find_loop_closures(features[chosen], sample, NEIGHBOURS[:1])[0]
    moved[chosen] = relax_unevenly(places[chosen], sample, closures, rng, factors.number(number)).places
    return moved
