"""An initial map without folds: Isomap on the graph of segments and loop closures (Tenenbaum et al. 2000).

Consecutive readings of a segment are joined by the distance travelled; loop closures, observations of different
segments that are mutually most similar, are joined by a distance estimated from how fast features change along the
segments there. Shortest paths through this graph and classical scaling of them (from landmarks: de Silva and Tenenbaum
2004) give positions. Paths around furniture are longer than straight lines: that bends the map but does not fold it,
and the pose graph straightens it.
"""

import numpy as np
import torch
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, dijkstra

from deepgps.data.segments import Segments, find_owners, measure_spacing
from sim.errors import InputError

NEIGHBOURS = (3, 6)
"""Neighbours of each observation in the graphs whose shortest paths give a map; the first gives the loop closures."""
LANDMARKS = 300
MAX_LINK = 2.0
PAIR_BATCH = 2**23  # Pairs of observations that are compared at a time

LoopClosures = tuple[np.ndarray, np.ndarray, np.ndarray]
"""First (n,) and second (n,) observations of the loop closures, and their estimated distances (n,) [m]."""


def has_lines(segments: Segments) -> bool:
    """Whether most readings are on segments of at least three readings, enough to show how fast features change."""
    return bool(segments.count[segments.count >= 3].sum() > segments.count.sum() / 2)


def map_by_paths(
    observations: int, segments: Segments, closures: LoopClosures, generator: torch.Generator
) -> np.ndarray:
    """Positions (N, 2) [m] of the observations by shortest paths, in an arbitrary frame; the landmarks are drawn.

    NaN outside the largest connected part. Raises InputError if the segments are not connected.
    """
    first, second, length = (np.concatenate(pair) for pair in zip(find_steps(segments), closures, strict=True))
    graph = _join(first, second, length, observations)
    main = _largest_part(graph)
    landmarks = main[torch.randperm(len(main), generator=generator)[:LANDMARKS].numpy()]
    path = dijkstra(graph, directed=False, indices=landmarks)[:, main]
    places = np.full((observations, 2), np.nan)
    places[main] = scale_classically(path, np.searchsorted(main, landmarks))
    return places


def find_loop_closures(features: torch.Tensor, segments: Segments, neighbours: tuple[int, ...]) -> list[LoopClosures]:
    """Loop closures: pairs of observations of different segments, each among the other's nearest by features (N, K).

    There is a list of pairs for each number of ``neighbours`` that count as nearest.
    """
    rate, spacing = _rate_of_change(features, segments)
    before, after = find_owners(segments, len(features))
    j, difference = _find_nearest(features, segments, (before, after), min(max(neighbours), len(features)))
    i = torch.arange(len(features))[:, None].expand_as(j)
    length = difference / ((rate[i] + rate[j]) / 2.0)
    near = (length < MAX_LINK * spacing) & (after[i] >= 0)
    found = []
    for count in neighbours:
        a, b, distance = i[:, :count].flatten(), j[:, :count].flatten(), length[:, :count].flatten()
        kept = torch.isin(a * len(features) + b, b * len(features) + a) & near[:, :count].flatten()
        found.append((a[kept].numpy(), b[kept].numpy(), distance[kept].double().numpy()))
    return found


def scale_classically(path: np.ndarray, landmark: np.ndarray) -> np.ndarray:
    """Positions (N, 2) [m] from distances (L, N) [m] to the landmarks, which are its columns ``landmark`` (L,)."""
    size, axes = find_axes(path[:, landmark])
    mean = (path[:, landmark] ** 2).mean(axis=1)
    return -0.5 * (path**2 - mean[:, None]).T @ (axes[:, -2:] / np.sqrt(size[-2:].clip(1e-12)))


def find_axes(distance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues (L,), ascending [m^2], and axes (L, L) of points with these distances (L, L) [m] (Torgerson 1952).

    The squared distances, centred by rows and columns and multiplied by -1/2, are the scalar products of the points
    about their centroid: the points' coordinates are the axes, each times the root of its eigenvalue.
    """
    squared = distance**2
    mean = squared.mean(axis=1)
    inner = -0.5 * (squared - mean[:, None] - mean[None] + mean.mean())
    size, axes = np.linalg.eigh((inner + inner.T) / 2.0)
    return size, axes


def find_steps(segments: Segments) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """First (r,) and second (r,) observations of consecutive readings, and the distance between them (r,) [m]."""
    valid = segments.valid[:, 1:]
    distance = segments.distance[:, 1:] - segments.distance[:, :-1]
    chosen = (segments.index[:, :-1][valid], segments.index[:, 1:][valid], distance[valid].double())
    return chosen[0].numpy(), chosen[1].numpy(), chosen[2].numpy()


def _find_nearest(
    features: torch.Tensor, segments: Segments, owners: tuple[torch.Tensor, torch.Tensor], most: int
) -> tuple[torch.Tensor, torch.Tensor]:
    """The ``most`` nearest observations of other segments and their differences (N, most), the nearest first.

    Pairs are compared ``PAIR_BATCH`` at a time: memory stays bounded, and a product of matrices is fast.
    """
    squared = features.square().sum(dim=1).masked_fill(owners[1] < 0, torch.inf)
    valid, nearest, difference = segments.valid, [], []
    size = max(1, PAIR_BATCH // len(features))
    table = torch.empty(size, len(features))  # used again, since memory that is returned in pieces is not used again
    for chunk in torch.arange(len(features)).split(size):
        apart = torch.addmm(squared, features[chunk], features.T, alpha=-2.0, out=table[: len(chunk)])
        for own in owners:
            same = torch.where(valid[own[chunk]], segments.index[own[chunk]], chunk[:, None])
            apart.scatter_(1, same, torch.inf)
        least, found = apart.topk(most, largest=False)
        nearest.append(found)
        exact = (features[chunk, None] - features[found]).norm(dim=2)
        difference.append(exact.masked_fill(least.isinf(), torch.inf))
    return torch.cat(nearest), torch.cat(difference)


def _rate_of_change(features: torch.Tensor, segments: Segments) -> tuple[torch.Tensor, float]:
    # How much features change per metre at each observation (N,), and the median distance between readings.
    first, second, distance = (torch.from_numpy(part) for part in find_steps(segments))
    change = (features[first] - features[second]).norm(dim=1)
    total, length = torch.zeros(len(features)), torch.zeros(len(features))
    for end in (first, second):
        total.index_add_(0, end, change)
        length.index_add_(0, end, distance.float())
    return (total / length.clamp_min(1e-6)).clamp_min(1e-6), measure_spacing(distance.numpy())


def _join(first: np.ndarray, second: np.ndarray, length: np.ndarray, count: int) -> csr_array:
    low, high = np.minimum(first, second), np.maximum(first, second)
    order = np.lexsort((length, high, low))
    low, high, length = low[order], high[order], length[order].clip(1e-6)
    fresh = np.append(np.ones(len(low[:1]), bool), (np.diff(low) != 0) | (np.diff(high) != 0))
    return csr_array((length[fresh], (low[fresh], high[fresh])), shape=(count, count))


def _largest_part(graph: csr_array) -> np.ndarray:
    _, part = connected_components(graph, directed=False)
    main = np.flatnonzero(part == np.bincount(part).argmax())
    if len(main) < 3:
        raise InputError("the recording's segments do not hang together: no two of them look alike anywhere")
    return main
