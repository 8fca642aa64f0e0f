"""The map from which training starts, found without a network: rough maps by shortest paths, refined, the best kept.

A rough map may mirror a region, such as the room behind a sofa, or bend it so far that its loop closures lose their
weight. Graphs of few and of many neighbours fail in different regions, so several are tried and judged by their cost,
which is how well segments and loop closures fit one another. The best map then adopts better-fitting regions from the
others, and mirrors weakly connected parts where that lowers the cost. The ground truth is not used.
"""

import numpy as np
import torch
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from deepgps.alignment import fit_alignment
from deepgps.data.segments import Segments
from deepgps.initial_map.isomap import LoopClosures, find_loop_closures, find_steps, join_closures, map_by_paths
from deepgps.initial_map.mirrored_parts import find_weak_parts, mirror
from deepgps.initial_map.pose_graph import relax

NEIGHBOURS = (3, 4, 6, 8)
APART = 1.5
"""Two maps differ at an observation if they place it farther apart than this, in steps between readings."""
REGIONS, SMALLEST = 6, 4
"""Largest number of regions of another map that are tried, and the fewest observations that a region may have."""
BELIEVED = 4.0
"""First-round scale of the robust weights after a region was adopted or mirrored: the rest is already right."""


def find_initial_map(features: torch.Tensor, segments: Segments, generator: torch.Generator) -> np.ndarray:
    """Positions of observations with features (N, K), in an arbitrary frame.

    Returns:
        (N, 2) [m]; NaN for observations outside the largest connected part.

    Raises:
        InputError: The segments are not connected.
    """
    graphs = find_loop_closures(features, segments, NEIGHBOURS)
    rough = [map_by_paths(len(features), segments, closures, generator) for closures in graphs]
    tries = sorted((relax(places, segments, graphs[0]) for places in rough), key=lambda found: found[1])
    places, cost = tries[0]
    for other, _ in tries[1:]:
        places, cost = adopt_regions(places, cost, other, segments, graphs[0])
    return mirror_parts(places, cost, segments, graphs[0])


def mirror_parts(places: np.ndarray, cost: float, segments: Segments, closures: LoopClosures) -> np.ndarray:
    """Mirror weakly connected parts of a map (N, 2) [m], each only if that lowers the map's cost."""
    for part in find_weak_parts(np.asarray(np.isfinite(places).all(axis=1)), segments, closures):
        found, less = relax(mirror(places, part, segments, closures), segments, closures, BELIEVED)
        if less < cost:
            places, cost = found, less
    return places


def adopt_regions(
    places: np.ndarray, cost: float, other: np.ndarray, segments: Segments, closures: LoopClosures
) -> tuple[np.ndarray, float]:
    """Adopt regions of another map, each only if that lowers the cost.

    Args:
        places: A map (N, 2) [m].
        cost: Its cost.
        other: Another map (N, 2) [m], in any frame.
        segments: Weak constraints.
        closures: Loop closures.

    Returns:
        The better map and its cost.
    """
    laid = lay_over(other, places)
    for region in find_regions(places, laid, segments, closures):
        mixed = places.copy()
        mixed[region] = laid[region]
        found, less = relax(mixed, segments, closures, BELIEVED)
        if less < cost:
            places, cost = found, less
    return places, cost


def lay_over(other: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Another map moved, turned and mirrored so that the half that fits best coincides with this one."""
    laid, kept = other, np.isfinite(places).all(axis=1) & np.isfinite(other).all(axis=1)
    known = kept
    for _ in range(8):
        laid = fit_alignment(other[kept], places[kept], "E2").apply(other)
        apart = np.linalg.norm(laid - places, axis=1)
        kept = known & (apart <= np.median(apart[known]))
    return laid


def find_regions(places: np.ndarray, laid: np.ndarray, segments: Segments, closures: LoopClosures) -> list[np.ndarray]:
    """Connected groups of observations (n,) that two maps place differently, the largest first."""
    step = float(np.median(find_steps(segments)[2]))
    apart = np.linalg.norm(laid - places, axis=1) > APART * step
    first, second, _ = join_closures(segments, closures)
    joined = apart[first] & apart[second]
    graph = csr_array((np.ones(joined.sum()), (first[joined], second[joined])), shape=(len(places), len(places)))
    _, part = connected_components(graph, directed=False)
    size = np.bincount(part[apart], minlength=1)
    largest = [
        number for number in np.argsort(-size, kind="stable")[:REGIONS] if SMALLEST <= size[number] < len(places) / 2
    ]
    return [np.flatnonzero(part == number) for number in largest]
