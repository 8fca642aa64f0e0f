"""Explicit positioning, the paper's baseline without a network (Sec. III-B1): landmarks and positions as unknowns.

The paper's Eq. 6 is a system of distances: between a landmark and a position, as observed, and between two positions of
one segment, as driven. Both are ``|q_a - q_b| = c`` with points q, which here are positions first, then landmarks. The
trust-region least-squares solver finds the nearest minimum, so the result depends on the start: a random one, as in the
paper, or a map of the landmarks by multidimensional scaling (MDS), which the paper does not try.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import torch
from scipy.optimize import OptimizeResult, least_squares
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import shortest_path

from deepgps.config.learning import LearnSettings
from deepgps.data.segments import Segments, read_segments, renumber
from deepgps.initial_map.distances.isomap import scale_classically
from deepgps.positioner.positioner import Fitted
from deepgps.positioner.without_features import LandmarkPositioner, find_seen, trilaterate
from deepgps.terminal.progress import Report
from sim.errors import InputError
from sim.recording.format import Recording
from sim.rng import stream

TOLERANCE = 1e-10


@dataclass(frozen=True)
class Equations:
    """Eq. 6: the distance between points ``first`` (R,) and ``second`` (R,) is ``length`` (R,) [m]."""

    first: np.ndarray
    second: np.ndarray
    length: np.ndarray

    def residual(self, unknown: np.ndarray) -> np.ndarray:
        """Excess of each distance (R,) [m] between the points in ``unknown`` (2 P,) over its required length."""
        return np.linalg.norm(self._apart(unknown), axis=1) - self.length

    def jacobian(self, unknown: np.ndarray) -> csr_matrix:
        """Derivative (R, 2 P) of the residuals, four numbers in each row.

        Moving ``q_a`` changes ``|q_a - q_b|`` by the motion's component along the unit vector u from ``q_b`` to
        ``q_a``; moving ``q_b`` has the opposite effect. So the row holds u at point a and -u at point b, and zeros if
        the points coincide.
        """
        apart = self._apart(unknown)
        direction = apart / np.linalg.norm(apart, axis=1).clip(1e-12)[:, None]
        a, b = 2 * self.first, 2 * self.second
        column = np.stack([a, a + 1, b, b + 1], axis=1)
        value = np.concatenate([direction, -direction], axis=1)
        row = np.arange(0, 4 * len(a) + 1, 4)
        return csr_matrix((value.ravel(), column.ravel(), row), shape=(len(a), len(unknown)))

    def _apart(self, unknown: np.ndarray) -> np.ndarray:
        point = unknown.reshape(-1, 2)
        return point[self.first] - point[self.second]


Start = Callable[[np.ndarray, float, np.random.Generator], tuple[np.ndarray, np.ndarray]]
"""(distances (n, M) [m], reach [m], random generator) -> initial positions (n, 2) and landmarks (M, 2) [m]."""


def start_at_random(distance: np.ndarray, reach_m: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Draw positions and landmarks uniformly in a square whose side is the longest distance."""
    half = float(distance.max()) / 2.0
    return rng.uniform(-half, half, (len(distance), 2)), rng.uniform(-half, half, (distance.shape[1], 2))


def start_by_mds(distance: np.ndarray, reach_m: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Compute landmarks by classical scaling of the shortest paths between them, and positions by trilateration.

    A path from landmark k via position i to landmark l has the length ``x_ik + x_il``. Of many positions, some are
    nearly on the straight line between both landmarks, so the shortest path is nearly their distance. Landmarks never
    seen together are joined by paths via other landmarks; InputError if they are not connected by any.
    """
    measured = np.where(find_seen(distance, reach_m), np.asarray(distance, float), np.inf)
    way = np.stack([(measured[:, [k]] + measured).min(axis=0) for k in range(measured.shape[1])])
    np.fill_diagonal(way, 0.0)
    way = shortest_path(way, method="FW", directed=False)
    if not np.isfinite(way).all():
        raise InputError("some landmarks were never seen together with any other: they have no common map")
    landmark = scale_classically(way, np.arange(len(way)))
    return trilaterate(landmark, distance, reach_m), landmark


def choose_readings(segments: Segments, most: int) -> tuple[Segments, torch.Tensor]:
    """Thin out the readings of the segments evenly, so that about ``most`` are left; see ``renumber``."""
    every = max(1, -(-int(segments.count.sum()) // most))
    index, distance = segments.index[:, ::every].contiguous(), segments.distance[:, ::every]
    return renumber(Segments(index, distance, (segments.count - 1) // every + 1, segments.skipped))


def set_up(distance: np.ndarray, reach_m: float, segments: Segments) -> Equations:
    """Set up Eq. 6 for positions with observed distances (n, M) [m], on segments whose ``index`` refers to these."""
    position, landmark = np.nonzero(find_seen(distance, reach_m))
    i, j = torch.triu_indices(segments.index.shape[1], segments.index.shape[1], offset=1)
    pair = segments.valid[:, i] & segments.valid[:, j]
    driven = (segments.distance[:, j] - segments.distance[:, i])[pair]
    return Equations(
        first=np.concatenate([position, segments.index[:, i][pair].numpy()]),
        second=np.concatenate([len(distance) + landmark, segments.index[:, j][pair].numpy()]),
        length=np.concatenate([distance[position, landmark], driven.numpy()]).astype(float),
    )


def solve(equations: Equations, first: np.ndarray, evaluations: int) -> OptimizeResult:
    """Solve the equations by least squares from initial points (P, 2) [m], by a trust region with a sparse Jacobian."""
    return least_squares(
        equations.residual,
        first.ravel(),
        equations.jacobian,  # pyright: ignore[reportArgumentType] (its stub knows dense ones only)
        method="trf",
        tr_solver="lsmr",
        ftol=TOLERANCE,
        xtol=TOLERANCE,
        gtol=TOLERANCE,
        max_nfev=evaluations,
    )


def _fit(
    start: Start, recording: Recording, settings: LearnSettings, seed: int, folder: Path, progress: Report
) -> Fitted:
    reach_m = read_reach(recording)
    segments, chosen = choose_readings(read_segments(recording), settings.explicit.readings)
    distance = np.asarray(recording.observation[chosen.numpy()])
    first = start(distance, reach_m, stream(seed, "start"))
    solution = solve(set_up(distance, reach_m, segments), np.concatenate(first), settings.explicit.evaluations)
    landmark = solution.x.reshape(-1, 2)[len(distance) :]
    training = {
        "steps": int(solution.nfev),
        "parameters": len(solution.x),
        "residual_rms_m": float(np.sqrt(np.mean(solution.fun**2))),
        "converged": bool(solution.success),
    }
    progress(folder.name, 1, 1)
    return Fitted(LandmarkPositioner(landmark, reach_m), training)


fit, fit_from_mds = partial(_fit, start_at_random), partial(_fit, start_by_mds)
"""Solve Eq. 6 from a random start, and from a map of the landmarks by MDS."""


def read_reach(recording: Recording) -> float:
    """Distance from which on landmarks are not seen [m]; infinite if all are."""
    reach_m = recording.manifest.settings.get("landmarks", {}).get("reach_m")
    return np.inf if reach_m is None else float(reach_m)
