"""Parts of a map that could be mirrored: distances alone cannot tell, however exact they are.

Bars that cross fix one another. But where a part of the map meets the rest only along one line, such as at a single
long segment, the part can be mirrored about this line, and every segment is as straight and every loop closure as short
as before: the flip ambiguity of rigid frameworks (Hendrickson, SIAM J. Comput. 21, 1992). Short drives have such parts,
as few bars cross there.
"""

import numpy as np
import torch
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from deepgps.data.segments import Segments, subsample
from deepgps.initial_map.distances.dense import NEIGHBOURS
from deepgps.initial_map.distances.isomap import LONGEST_LINK, find_loop_closures
from deepgps.initial_map.distances.pose_graph import PoseGraph, build_pose_graph, lay_bars

NEAR, MOVED = 2.0, 3.0
"""Distance from a line within which a crossing allows mirroring about it, and beyond which mirroring moves a reading,
in steps between readings."""
LEAST = 0.02
"""Least share of the readings in a part; fewer are those of a bar that hangs loose."""


def find_ambiguous(places: np.ndarray, features: torch.Tensor, segments: Segments) -> np.ndarray:
    """Find the observations that could be mirrored about a bar together with all that holds them.

    Args:
        places: Positions of the observations on the map (N, 2) [m].
        features: Heading-invariant features of the same (N, K).
        segments: Weak constraints.

    Returns:
        (N,) bool. Of a long recording, a sample is examined, and all others are taken to be like the one before them.
    """
    sample, chosen = subsample(segments, len(features))
    places, numbers = places[chosen.numpy()], chosen.numpy()
    closures = find_loop_closures(features[chosen], sample, NEIGHBOURS[:1])[0]
    graph = build_pose_graph(sample, closures, np.asarray(np.isfinite(places).all(axis=1)))
    found = np.zeros(len(places), bool)
    found[graph.observation] = find_ambiguous_readings(graph, places[graph.observation])
    return found[(np.searchsorted(numbers, np.arange(len(features)), side="right") - 1).clip(0)]


def find_ambiguous_readings(graph: PoseGraph, point: np.ndarray) -> np.ndarray:
    """Find the readings (r,) bool that could be mirrored about a bar.

    For each bar, the bars that cross elsewhere than along its line hold one another. All such parts but the largest can
    be mirrored.

    Args:
        graph: Bars, and pairs of readings that should coincide.
        point: Positions of the readings (r, 2) [m].
    """
    middle, heading = lay_bars(point, graph)
    bars = len(middle)
    pair, place = _find_crossings(graph, point)
    ambiguous = np.zeros(len(point), bool)
    for bar in range(bars):
        normal = np.array([-np.sin(heading[bar]), np.cos(heading[bar])])
        holds = np.abs((place - middle[bar]) @ normal) > NEAR * graph.step
        joined = csr_array((np.ones(holds.sum()), (pair[holds, 0], pair[holds, 1])), shape=(bars, bars))
        part = connected_components(joined, directed=False)[1][graph.bar]
        moved = np.abs((point - middle[bar]) @ normal) > MOVED * graph.step
        size = np.bincount(part, moved)
        ambiguous |= moved & (part != size.argmax()) & (size > LEAST * len(point))[part]
    return ambiguous


def _find_crossings(graph: PoseGraph, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    # Pairs of bars that cross on the map (c, 2), each once, and the mean place of their loop closures (c, 2) [m].
    apart = np.linalg.norm(point[graph.a] - point[graph.b], axis=1)
    both = np.sort(np.stack([graph.bar[graph.a], graph.bar[graph.b]], axis=1), axis=1)
    cross = (apart < LONGEST_LINK * graph.step) & (both[:, 0] != both[:, 1])
    pair, number, count = np.unique(both[cross], axis=0, return_inverse=True, return_counts=True)
    middle = ((point[graph.a] + point[graph.b]) / 2.0)[cross]
    return pair, np.stack([np.bincount(number, middle[:, axis], len(pair)) / count for axis in range(2)], axis=1)
