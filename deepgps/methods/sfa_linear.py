"""Slow features and a linear map from them to positions, learned from straight segments: an older twin of DeepGPS.

Franzius, Metka, Haris and Bauer-Wersing, "Unsupervised Learning of Metric Representations with Slow Features from
Omnidirectional Views"; Metka's thesis (Bielefeld University), section 5.3.1; Metka et al., PLOS ONE 13(9), 2018.

Theirs are the slow features of omnidirectional images, the linear map, and its cost: the mean of the squares of
``W'f - o - d (cos a, sin a)`` over all images with features f at a distance d along a line, of which the origin o and
the direction a are unknown. Ours are the features, of which the slowest are multiplied by one another (as in each layer
of their networks); the solution by turns, for W and for the directions, from several random ones since there are local
minima; and the number of products, which is chosen by segments left out.

Positions are complex numbers here, so that a direction is a number of size 1.
"""

from pathlib import Path

import numpy as np
import torch

from deepgps.config.learning import LearnSettings
from deepgps.data.segments import Segments, spread_evenly, subsample_learned
from deepgps.learning.training_data import prepare
from deepgps.positioner.positioner import Fitted, LinearPositioner, multiply_slowest
from deepgps.terminal.progress import Report
from sim.errors import InputError
from sim.recording.format import Recording
from sim.rng import stream

MULTIPLIED = (0, 8, 16, 32, 48, 64)  # How many of the slowest features are multiplied by one another, to try
STARTS, ROUNDS = 16, 500  # Random starts; rounds from each
RIDGE = 1e-4  # Penalty of the squares of W, over the mean square of a feature within segments
LEFT_OUT_SHARE = 0.2  # Share of the segments by which the number of products is chosen
TOGETHER = 16  # Segments whose products are in memory at once


def fit(recording: Recording, settings: LearnSettings, seed: int, folder: Path, progress: Report) -> Fitted:
    """Learn the linear map, without the segments held out."""
    data = prepare(recording, settings, seed, folder.parent)
    segments, chosen = subsample_learned(data.segments, len(data.features))
    weights = learn(data.features[chosen].double().numpy(), segments, seed)
    progress(folder.name, 1, 1)
    return Fitted(LinearPositioner(data.projection, weights), {"parameters": weights.numel()})


def learn(features: np.ndarray, segments: Segments, seed: int) -> torch.Tensor:
    """Weights (D, 2) [m] of features (N, K) and of products of the slowest, as ``multiply_slowest`` orders them.

    Raises InputError if there is one segment only.
    """
    left_out, count = spread_evenly(len(segments.count)).numpy() < LEFT_OUT_SHARE, features.shape[1]
    if left_out.all():
        raise InputError("sfa_linear: one segment does not tell directions apart")
    most = min(MULTIPLIED[-1], count)
    sums = (add_up(features, segments, np.flatnonzero(rows), most) for rows in (~left_out, left_out))
    (square, along), (square_left, along_left) = sums

    def find_cost(size: int) -> float:  # less a constant
        w = solve(square[:size, :size], along[:size], seed)
        return (w.conj() @ square_left[:size, :size] @ w).real - 2.0 * np.abs(along_left[:size].T @ w).sum()

    sizes = sorted({count + number * (number + 1) // 2 for number in np.minimum(MULTIPLIED, most)})
    size = min(sizes, key=find_cost)
    weights = solve((square + square_left)[:size, :size], np.hstack([along, along_left])[:size], seed)
    return torch.from_numpy(np.stack([weights.real, weights.imag], axis=1))


def add_up(features: np.ndarray, segments: Segments, rows: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Sums over the images of segments ``rows`` (n,), from each of which the segment's mean is subtracted.

    Returns those of the products of two features (D, D), and of feature and distance for each segment (D, n), where
    features (N, K) are followed by the products of the first ``most``.
    """
    square, along = np.zeros(()), []
    for part in np.array_split(rows, -(-len(rows) // TOGETHER)):
        valid = segments.valid[part].numpy()[..., None]
        x = centre(multiply_slowest(features[segments.index[part].numpy()], most), valid)
        d = centre(segments.distance[part].double().numpy()[..., None], valid)
        square = square + np.tensordot(x, x, axes=((0, 1), (0, 1)))
        along.append((np.swapaxes(x, 1, 2) @ d)[..., 0].T)
    return square, np.hstack(along)


def centre(values: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Values (n, longest, K) of n segments less the segment's mean, and 0 where they are not valid (n, longest, 1)."""
    return valid * (values - (valid * values).sum(axis=1, keepdims=True) / valid.sum(axis=1, keepdims=True))


def solve(square: np.ndarray, along: np.ndarray, seed: int) -> np.ndarray:
    """Weights (D,) complex [m] of least cost, for sums as ``add_up`` returns them.

    For given directions u (n,) the best weights are ``B u``, with a cost that falls as ``u' along' B u`` grows; for
    given weights, the best direction of a segment is that of its row of ``along' B u``. By turns, the cost only falls.
    """
    size = len(square)
    best = np.linalg.solve(square + RIDGE * square.trace() / size * np.eye(size), along)
    gain = along.T @ best
    direction = np.exp(2j * np.pi * stream(seed, "directions").random((len(gain), STARTS)))
    for _ in range(ROUNDS):
        direction = gain @ direction
        direction /= np.maximum(np.abs(direction), 1e-12)
    gained = (direction.conj() * (gain @ direction)).real.sum(axis=0)
    return best @ direction[:, gained.argmax()]
