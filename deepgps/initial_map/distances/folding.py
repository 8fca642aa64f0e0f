"""Folds of a map: how far one is folded, and which of its parts distances leave free to be mirrored.

Segments are straight, so the predicted ends of a segment must be as far apart as the distance travelled: a fold bends
the segments that cross it. And places predicted next to each other must look alike: a fold overlays different places.

Distances alone do not tell whether a part is mirrored, however exact they are. Bars that cross fix one another. But
where a part of the map meets the rest only along one line, such as at a single long segment, the part can be mirrored
about this line, and every segment is as straight and every loop closure as short as before: the flip ambiguity of rigid
frameworks (Hendrickson, SIAM J. Comput. 21, 1992). Short drives have such parts, as few bars cross there.
"""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from deepgps.data.segments import Segments, find_owners, subsample
from deepgps.initial_map.distances.isomap import MAX_LINK, NEIGHBOURS, find_loop_closures
from deepgps.initial_map.distances.pose_graph import PoseGraph, build_pose_graph, lay_bars

SAMPLES = 2000
FOLD_NEIGHBOURS = 32
NEIGHBOUR_M = 0.1
LOOK_M = 0.3
LENGTH_ERROR_LIMIT, OVERLAP_LIMIT = 0.04, 0.02  # A map counts as folded if it exceeds either of these


@dataclass(frozen=True)
class FoldScore:
    """How far a map is folded: two fractions, each between 0 (not at all) and 1."""

    # Of the distance travelled, the part on segments whose predicted ends are too close or too far apart
    length_error_fraction: float
    # Of the observations with neighbours on the map from other segments, the part that look unlike those neighbours
    overlap_fraction: float

    @property
    def worst(self) -> float:
        """The larger fraction in units of its limit."""
        return max(self.length_error_fraction / LENGTH_ERROR_LIMIT, self.overlap_fraction / OVERLAP_LIMIT)

    @property
    def folded(self) -> bool:
        """Whether the map counts as folded."""
        return self.worst > 1.0

    def record(self) -> dict[str, Any]:
        """What ``training.json`` holds of it."""
        return {"found": self.folded, **asdict(self)}


def score_folding(
    positions: np.ndarray, features: torch.Tensor, segments: Segments, generator: torch.Generator
) -> FoldScore:
    """Measure how far a map (N, 2) [m] of observations with features (N, K) is folded, on some that are drawn."""
    return FoldScore(
        measure_length_error(positions, segments), measure_overlap(positions, features, segments, generator)
    )


def measure_length_error(positions: np.ndarray, segments: Segments) -> float:
    """Part of the distance travelled on segments whose mapped length is wrong by more than 0.1 m plus a tenth."""
    rows = torch.arange(len(segments.count))
    last = segments.count - 1
    driven = segments.distance[rows, last].numpy()
    ends = positions[segments.index[rows, last].numpy()] - positions[segments.index[:, 0].numpy()]
    wrong = np.abs(np.linalg.norm(ends, axis=1) - driven)
    return float(driven[wrong > 0.1 + 0.1 * driven].sum() / max(driven.sum(), 1e-9))


def measure_overlap(
    positions: np.ndarray, features: torch.Tensor, segments: Segments, generator: torch.Generator
) -> float:
    """Part of the observations that look unlike a quarter or more of their neighbours on the map, within
    ``NEIGHBOUR_M``.

    Only neighbours on other segments count; unknown positions (NaN) are left out. Two observations look unlike each
    other if their features differ by more than 1.5 times the 0.9 quantile of the differences between readings
    ``LOOK_M`` apart on one segment.
    """
    owner = find_owners(segments, len(positions))[1].numpy()
    known = np.flatnonzero((owner >= 0) & np.isfinite(positions).all(axis=1))
    chosen = known[torch.randperm(len(known), generator=generator)[:SAMPLES].numpy()]
    apart, found = KDTree(positions[known]).query(positions[chosen], k=min(FOLD_NEIGHBOURS, len(known)))
    other = known[found]
    near = (apart < NEIGHBOUR_M) & (owner[other] != owner[chosen][:, None])
    unlike = (features[chosen][:, None] - features[other]).norm(dim=2).numpy() > 1.5 * _usual_difference(
        features, segments
    )
    some = near.any(axis=1)
    share = (unlike & near).sum(axis=1)[some] / near.sum(axis=1)[some]
    return float((share >= 0.25).mean()) if len(share) else 0.0


def _usual_difference(features: torch.Tensor, segments: Segments) -> float:
    found = [torch.zeros(0)]
    for row, count in enumerate(segments.count.tolist()):
        distance = segments.distance[row, :count].numpy()
        partner = np.searchsorted(distance, distance + LOOK_M)
        there = partner < count
        index = segments.index[row]
        found.append((features[index[:count][there]] - features[index[partner[there]]]).norm(dim=1))
    joined = torch.cat(found).numpy()
    return float(np.quantile(joined, 0.9)) if len(joined) else float("inf")


MIRROR_WIDTH, MIN_MIRROR_SHIFT = 2.0, 3.0
"""Distance from a line within which a crossing allows mirroring about it, and beyond which mirroring moves a reading,
in steps between readings."""
MIN_PART_SHARE = 0.02  # Least share of the readings in a part; fewer are those of a bar that hangs loose


def find_ambiguous(
    places: np.ndarray, features: torch.Tensor, segments: Segments, least: float = MIN_PART_SHARE
) -> np.ndarray:
    """Mask (N,) bool of the observations that could be mirrored about a bar together with all that holds them.

    Their places on the map are (N, 2) [m], their features (N, K), and a part has at least the share ``least`` of the
    readings. Of a long recording, a sample is examined, and all others are taken to be like the one before them.
    """
    sample, chosen = subsample(segments, len(features))
    places, numbers = places[chosen.numpy()], chosen.numpy()
    closures = find_loop_closures(features[chosen], sample, NEIGHBOURS[:1])[0]
    graph = build_pose_graph(sample, closures, np.asarray(np.isfinite(places).all(axis=1)))
    found = np.zeros(len(places), bool)
    found[graph.observation] = find_ambiguous_readings(graph, places[graph.observation], least)
    return found[(np.searchsorted(numbers, np.arange(len(features)), side="right") - 1).clip(0)]


def find_ambiguous_readings(graph: PoseGraph, point: np.ndarray, least: float = MIN_PART_SHARE) -> np.ndarray:
    """Find the readings (r,) bool, at points (r, 2) [m], that could be mirrored about a bar.

    For each bar, the bars that cross elsewhere than along its line hold one another. All such parts but the largest can
    be mirrored.
    """
    middle, heading = lay_bars(point, graph)
    bars = len(middle)
    pair, place = _find_crossings(graph, point)
    ambiguous = np.zeros(len(point), bool)
    for bar in range(bars):
        normal = np.array([-np.sin(heading[bar]), np.cos(heading[bar])])
        holds = np.abs((place - middle[bar]) @ normal) > MIRROR_WIDTH * graph.step
        joined = csr_array((np.ones(holds.sum()), (pair[holds, 0], pair[holds, 1])), shape=(bars, bars))
        part = connected_components(joined, directed=False)[1][graph.bar]
        moved = np.abs((point - middle[bar]) @ normal) > MIN_MIRROR_SHIFT * graph.step
        size = np.bincount(part, moved)
        ambiguous |= moved & (part != size.argmax()) & (size > least * len(point))[part]
    return ambiguous


def _find_crossings(graph: PoseGraph, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    # Pairs of bars that cross on the map (c, 2), each once, and the mean place of their loop closures (c, 2) [m].
    apart = np.linalg.norm(point[graph.a] - point[graph.b], axis=1)
    both = np.sort(np.stack([graph.bar[graph.a], graph.bar[graph.b]], axis=1), axis=1)
    cross = (apart < MAX_LINK * graph.step) & (both[:, 0] != both[:, 1])
    pair, number, count = np.unique(both[cross], axis=0, return_inverse=True, return_counts=True)
    middle = ((point[graph.a] + point[graph.b]) / 2.0)[cross]
    return pair, np.stack([np.bincount(number, middle[:, axis], len(pair)) / count for axis in range(2)], axis=1)
