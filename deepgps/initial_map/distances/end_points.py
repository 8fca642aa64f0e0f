"""An initial map where segments have two readings (the paper's end-point strategy): places, bars and loop closures.

Two readings of a segment do not show how fast features change, but all short segments together show how the feature
difference D grows with the distance d: ``D^2 = S^2 (1 - exp(-d / l))``, where S is the difference between distant
places. Shortest paths over bars, which are straight and long, and loop closures, which are short, give a map that is
wrong by decimetres (Isomap). Then all places move until bars have their lengths and loop closures coincide; false loop
closures lose their weight as the scale of the robust weights shrinks (as in the pose graph). That contracts the map in
places, since the two ends of a loop closure are close but not identical. So in the last step each place moves to the
position among similar places that its features have among theirs (locally linear embedding, Roweis and Saul 2000),
while bars keep their lengths. The ground truth is not used.
"""

import numpy as np
import torch
from scipy.sparse import csc_array, csr_array, diags_array, eye_array, kron, vstack
from scipy.sparse.linalg import cg

from deepgps.data.segments import Segments, find_owners
from deepgps.initial_map.distances.isomap import LoopClosures, find_steps, map_by_paths
from sim.errors import InputError

NEIGHBOURS = (5, 8, 12)
"""Neighbours in feature space of each place, for each map that is tried; the map that fits best is kept."""
MAX_CLOSURE_M, MIN_CLOSURE_STD_M, MAX_SHORT_SEGMENT_M = 0.3, 0.02, 0.5
"""Largest estimated distance of a loop closure, its smallest standard deviation, and the longest short segment [m]."""
CHUNK = 1000
ROUNDS = 25
ROBUST_SCALES_M = (1.0, 0.08)  # Scale of the robust weights in the first and the last round [m]
BAR_STDS_M = (0.1, 0.01)  # Standard deviation of the bars' lengths in the first and the last round [m]
ANCHOR_STD_M, MAX_STEP_M = 0.3, 0.5
"""Standard deviation of a place about its position a round before, and its largest step along each axis [m]."""
MIXTURE_SIZE, MIXTURE_DAMPING = 10, 0.05  # Similar places that make up each place, and the damping of their weights
MIXTURE_ROUNDS, MIXTURE_SCALES_M, MIXTURE_STD_M = 15, (0.5, 0.05), 0.03
"""Rounds, scales of the robust weights in the first and the last [m], and standard deviation about the mixture [m]."""
SOLVER_TOLERANCE, MAX_SOLVER_STEPS = 1e-8, 2000
"""Residual at which conjugate gradients stop, relative to the right-hand side, and their largest number of steps."""
ERROR_UNIT_M = 0.05  # Unit of the errors when maps are compared; an error counts at most as twice this [m]


def find_end_point_map(
    features: torch.Tensor, segments: Segments, generator: torch.Generator
) -> tuple[np.ndarray, Segments]:
    """Positions (N, 2) [m] of observations with features (N, K), in an arbitrary frame, and the segments as they are.

    NaN outside the largest connected part. Raises InputError if no segment is short, or if they are not connected.
    """
    tries = []
    for closures in find_look_alikes(features, segments, NEIGHBOURS):
        rough = map_by_paths(len(features), segments, closures, generator)
        tries.append(relax_ends(rough, segments, closures))
    best = min(tries, key=lambda found: found[1])[0]
    return fit_mixture(best, segments, find_mixture(features)), segments


def find_mixture(features: torch.Tensor) -> csr_array:
    """Weights (N, N) with which the features (N, K) of the most similar places make up each place's own features.

    Each row sums to one and minimises ``|f_i - sum_j w_ij f_j|^2``, damped by ``MIXTURE_DAMPING`` times the mean square
    difference.
    """
    count, some = len(features), min(MIXTURE_SIZE, len(features) - 1)
    found = []
    for chunk in torch.arange(count).split(CHUNK):
        unlike = torch.cdist(features[chunk], features)
        unlike[chunk - chunk[0], chunk] = torch.inf
        found.append(unlike.topk(some, largest=False).indices)
    nearest = torch.cat(found)
    apart = (features[nearest] - features[:, None]).double()
    gram = apart @ apart.transpose(1, 2)
    size = gram.diagonal(dim1=1, dim2=2).mean(dim=1).clamp_min(1e-12)
    gram = gram + MIXTURE_DAMPING * size[:, None, None] * torch.eye(some, dtype=gram.dtype)
    weight = torch.linalg.solve(gram, torch.ones((count, some, 1), dtype=gram.dtype))[..., 0]
    weight = weight / weight.sum(dim=1, keepdim=True)
    row = np.repeat(np.arange(count), some)
    return csr_array((weight.flatten().numpy(), (row, nearest.flatten().numpy())), shape=(count, count))


def fit_mixture(places: np.ndarray, segments: Segments, mixture: csr_array) -> np.ndarray:
    """Move places (N, 2) [m] to where bars have their lengths and each place is the ``mixture`` (N, N) of others.

    Minimises ``sum_b w_b ((|p_i - p_j| - d) / s)^2 + sum_i w_i |p_i - sum_j w_ij p_j|^2`` as ``relax_ends`` does.
    Unknown places (NaN) move to where the mixture puts them, but are returned as NaN.
    """
    known = np.asarray(np.isfinite(places).all(axis=1))
    place = np.where(known[:, None], places, np.nanmean(places, axis=0))
    a, b, distance = find_steps(segments)
    off_mixture = kron(eye_array(len(place)) - mixture, eye_array(2)).tocsr()
    for scale in np.geomspace(*MIXTURE_SCALES_M, MIXTURE_ROUNDS):
        bar = place[a] - place[b]
        length = np.linalg.norm(bar, axis=1).clip(1e-9)
        off, apart = length - distance, (off_mixture @ place.ravel()).reshape(-1, 2)
        trust = MIXTURE_STD_M**-2 * (1.0 + (apart**2).sum(axis=1) / scale**2) ** -2
        weight = np.concatenate([BAR_STDS_M[1] ** -2 * (1.0 + off**2 / scale**2) ** -2, np.repeat(trust, 2)])
        none = np.empty(0, int)
        slope = csc_array(vstack([_slope(a, b, bar / length[:, None], none, none, len(place)), off_mixture]))
        step = _descend(slope, weight, np.concatenate([off, apart.ravel()]), 1.0)
        place = place + step.clip(-MAX_STEP_M, MAX_STEP_M)
    return np.where(known[:, None], place, np.nan)


def find_look_alikes(features: torch.Tensor, segments: Segments, neighbours: tuple[int, ...]) -> list[LoopClosures]:
    """Loop closures: pairs of places, each among the other's nearest by features (N, K), with estimated distances [m].

    There is a list of pairs, each pair once, for each number of ``neighbours`` that count as nearest.
    """
    count = len(features)
    first, second, distance = (torch.from_numpy(part) for part in find_steps(segments))
    alone = find_owners(segments, count)[1] < 0
    ends, near, apart = _compare(features, first, second, alone, min(max(neighbours), count - 1))
    range_m, far = _fit_unlikeness(ends.double(), distance)
    length = -range_m * torch.log((1.0 - (apart.double() / far) ** 2).clamp_min(1e-4))
    found = []
    for some in neighbours:
        i = torch.arange(count)[:, None].expand(-1, near[:, :some].shape[1]).flatten()
        j, estimate = near[:, :some].flatten(), length[:, :some].flatten()
        kept = torch.isin(i * count + j, j * count + i) & (i < j) & (estimate < MAX_CLOSURE_M)
        found.append((i[kept].numpy(), j[kept].numpy(), estimate[kept].clamp_min(1e-3).numpy()))
    return found


def relax_ends(places: np.ndarray, segments: Segments, closures: LoopClosures) -> tuple[np.ndarray, float]:
    """Move all places (N, 2) [m] until bars and loop closures, each pair once, fit; those that are NaN stay NaN.

    Minimises ``sum_b w_b ((|p_i - p_j| - d) / s)^2 + sum_l w_l |p_i - p_j|^2`` by Gauss-Newton, with Geman and
    McClure's robust weights ``w = s_l^-2 (1 + r^2 / b^2)^-2`` of residuals r at the scale b. Returns places (N, 2) [m]
    and their misfit: mean squared residuals in units of ``ERROR_UNIT_M``, each cut off at 4.
    """
    known = np.asarray(np.isfinite(places).all(axis=1))
    number, place = np.cumsum(known) - 1, places[known].copy()
    a, b, distance = _among(known, number, find_steps(segments))
    c, e, near = _among(known, number, closures)
    size = np.hypot(near, MIN_CLOSURE_STD_M)
    for scale, exact in zip(np.geomspace(*ROBUST_SCALES_M, ROUNDS), np.geomspace(*BAR_STDS_M, ROUNDS), strict=True):
        bar, apart = place[a] - place[b], place[c] - place[e]
        length = np.linalg.norm(bar, axis=1).clip(1e-9)
        off = length - distance
        weight = np.concatenate(
            [
                exact**-2 * (1.0 + off**2 / scale**2) ** -2,
                np.repeat(size**-2 * (1.0 + (apart**2).sum(axis=1) / scale**2) ** -2, 2),
            ]
        )
        slope = _slope(a, b, bar / length[:, None], c, e, len(place))
        step = _descend(slope, weight, np.concatenate([off, apart.ravel()]), ANCHOR_STD_M**-2)
        place += step * np.minimum(1.0, MAX_STEP_M / np.linalg.norm(step, axis=1).clip(1e-9))[:, None]
    off, apart = np.linalg.norm(place[a] - place[b], axis=1) - distance, np.linalg.norm(place[c] - place[e], axis=1)
    off, apart = off / ERROR_UNIT_M, apart / np.hypot(near, ERROR_UNIT_M)
    cost = np.minimum(off**2, 4.0).mean() + np.minimum(apart**2, 4.0).mean()
    found = np.full_like(places, np.nan)
    found[known] = place
    return found, float(cost)


def _compare(
    features: torch.Tensor, first: torch.Tensor, second: torch.Tensor, alone: torch.Tensor, most: int
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Feature distances of the bars' ends (n,), and each place's most similar others and their distances (N, most).

    The other end of a place's own bar is excluded, and so are places that are on no segment, ``alone`` (N,). Works in
    chunks, since all pairs at once take a gigabyte.
    """
    bars, near, apart = torch.empty(len(first), dtype=features.dtype), [], []
    for chunk in torch.arange(len(features)).split(CHUNK):
        unlike, start = torch.cdist(features[chunk], features), chunk[0]
        from_here, to_here = torch.isin(first, chunk), torch.isin(second, chunk)
        bars[from_here] = unlike[first[from_here] - start, second[from_here]]
        unlike[first[from_here] - start, second[from_here]] = torch.inf
        unlike[second[to_here] - start, first[to_here]] = torch.inf
        unlike[chunk - start, chunk] = torch.inf
        unlike[:, alone] = torch.inf
        nearest = unlike.topk(most, largest=False)
        near.append(nearest.indices)
        apart.append(nearest.values)
    return bars, torch.cat(near), torch.cat(apart)


def _fit_unlikeness(unlike: torch.Tensor, distance: torch.Tensor) -> tuple[float, float]:
    far = float(unlike[distance >= distance.median()].median())
    short = (distance < MAX_SHORT_SEGMENT_M) & (distance > 0) & (unlike < 0.97 * far)
    if not short.any():
        raise InputError(
            f"learn.start 'ends': no segment is shorter than {MAX_SHORT_SEGMENT_M} m, so none tells what is near"
        )
    return float((-distance / torch.log(1.0 - (unlike / far) ** 2))[short].median()), far


def _descend(slope: csc_array, weight: np.ndarray, residual: np.ndarray, hold: float) -> np.ndarray:
    """Gauss-Newton step (n, 2) [m], damped by ``hold``, by conjugate gradients: long bars would fill up factors.

    A truncated solution is still a descent direction, and the next round continues from there.
    """
    weighted = slope.multiply(weight[:, None]).tocsc()
    right = weighted.T @ residual
    normal = (slope.T @ weighted + diags_array(np.full(len(right), hold))).tocsc()
    scale = diags_array(np.reciprocal(normal.diagonal()))
    found, _ = cg(normal, right, rtol=SOLVER_TOLERANCE, maxiter=MAX_SOLVER_STEPS, M=scale)
    return -found.reshape(-1, 2)


def _among(known: np.ndarray, number: np.ndarray, pairs: LoopClosures) -> LoopClosures:
    kept = known[pairs[0]] & known[pairs[1]]
    return number[pairs[0][kept]], number[pairs[1][kept]], pairs[2][kept]


def _slope(a: np.ndarray, b: np.ndarray, along: np.ndarray, c: np.ndarray, e: np.ndarray, count: int) -> csc_array:
    """Jacobian of bars' lengths and loop closures' differences (x, y) with respect to all places (rows, 2 count)."""
    bars, one = np.arange(len(a)), np.ones(len(c))
    rows, columns, values = [], [], []
    for axis in range(2):
        link = len(a) + 2 * np.arange(len(c)) + axis
        rows += [bars, bars, link, link]
        columns += [2 * a + axis, 2 * b + axis, 2 * c + axis, 2 * e + axis]
        values += [along[:, axis], -along[:, axis], one, -one]
    shape = (len(a) + 2 * len(c), 2 * count)
    return csc_array((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=shape)
