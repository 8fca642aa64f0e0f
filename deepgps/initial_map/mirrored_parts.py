"""Weakly connected parts of a map: each has a mirror ambiguity, because the map fits almost as well with it mirrored.

Few segments reach the part of a room behind a passage hardly wider than the robot. Mirroring it about the path through
the passage keeps all distances except those along these few segments, so any map of shortest paths may have the wrong
chirality there. Parts are found as sparse cuts of the graph of segments and loop closures (normalised cuts; Shi and
Malik 2000).
"""

import numpy as np
from scipy.sparse import csr_array, diags_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import eigsh

from deepgps.data.segments import Segments
from deepgps.initial_map.isomap import LoopClosures, join_closures

FEW = 20
"""Most steps and loop closures that may join a part to the rest; if there are more, they fix its chirality."""
CUTS = 3
SMALLEST = 0.02
"""Smallest part of all observations on either side of a cut."""


def find_weak_parts(placed: np.ndarray, segments: Segments, closures: LoopClosures) -> list[np.ndarray]:
    """Masks (N,) bool of the parts that few steps join to the rest, among the observations ``placed`` (N,)."""
    first, second, _ = join_closures(segments, closures)
    graph = csr_array((np.ones(len(first)), (first, second)), shape=(len(placed), len(placed)))
    joined = graph + graph.T
    kept = np.flatnonzero(placed)
    part = connected_components(joined[kept][:, kept], directed=False)[1]
    kept = kept[part == np.bincount(part).argmax()]
    if len(kept) * SMALLEST < CUTS + 2:
        return []
    joined = joined[kept][:, kept]
    joined.data[:] = 1.0
    parts = []
    for order, cut in _cut(joined):
        if cut <= FEW:
            parts.append(np.zeros(len(placed), bool))
            parts[-1][kept[order]] = True
    return parts


def mirror(places: np.ndarray, part: np.ndarray, segments: Segments, closures: LoopClosures) -> np.ndarray:
    """Positions (N, 2) [m] with a part (N,) mirrored about the path that leads into it."""
    first, second, _ = join_closures(segments, closures)
    through = (part[first] != part[second]) & np.isfinite(places[first] + places[second]).all(axis=1)
    step = places[second[through]] - places[first[through]]
    along = np.linalg.eigh(step.T @ step)[1][:, -1]
    middle = np.median((places[first[through]] + places[second[through]]) / 2.0, axis=0)
    turned = places.copy()
    ahead = places[part] - middle
    turned[part] = middle + 2.0 * np.outer(ahead @ along, along) - ahead
    return turned


def _cut(joined: csr_array) -> list[tuple[np.ndarray, float]]:
    """Smaller side (n,) of the best cut along each of the slowest axes of a graph, and the number of edges cut."""
    degree = np.asarray(joined.sum(axis=1)).ravel()
    scale = diags_array(1.0 / np.sqrt(degree))
    size, axes = eigsh(scale @ joined @ scale, k=CUTS + 1, which="LA", v0=np.ones(len(degree)))
    cuts = []
    for axis in np.argsort(-size)[1:]:
        order = np.argsort(axes[:, axis] / np.sqrt(degree), kind="stable")
        rank = np.argsort(order)
        low, high = np.sort(rank[np.stack(joined.nonzero())], axis=0)
        # each edge is listed twice in a symmetric graph; an edge is cut at all positions between its ends
        change = (np.bincount(low, minlength=len(order)) - np.bincount(high, minlength=len(order))) / 2.0
        cut, size_before = np.cumsum(change), np.cumsum(degree[order])
        least = int(SMALLEST * len(order))
        share = (cut / np.minimum(size_before, size_before[-1] - size_before).clip(1.0))[least:-least]
        best = least + int(share.argmin())
        side = order[: best + 1]
        cuts.append((side if len(side) <= len(order) / 2 else order[best + 1 :], float(cut[best])))
    return cuts
