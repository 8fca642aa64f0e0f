"""Losses on distances (paper Eq. 2, 3 and 5), which depend on differences of predictions, never on positions.

Each loss is the mean over pairs where the paper writes the sum, so that its size does not depend on the batch. The
end-point strategy is the case of two samples in a segment.

Two wrappers of a loss give a training an unfolded start: by imitation the network first learns an initial map, and
later is only kept near it; by lifting, a penalty flattens a network with more than two outputs into a plane.
"""

import torch

from deepgps.config.learning import LiftSettings, PairLoss
from deepgps.learning.batches import Batch, Draw, Loss


def distance(first: torch.Tensor, second: torch.Tensor) -> torch.Tensor:
    """Euclidean distance over the last axis; its gradient at zero distance is zero, not infinite."""
    squared = (first - second).square().sum(dim=-1)
    apart = squared > 0
    return torch.where(apart, torch.where(apart, squared, 1.0).sqrt(), 0.0)


def absolute(d: torch.Tensor, c: torch.Tensor) -> torch.Tensor:
    """|d - c| of each pair (Eq. 2) [m]."""
    return (d - c).abs()


def normalised(d: torch.Tensor, c: torch.Tensor) -> torch.Tensor:
    """|d - c| / (d + c) of each pair (Eq. 3), 0 where both are zero."""
    total = d + c
    return (d - c).abs() / torch.where(total > 0, total, 1.0)


PAIR_LOSSES = {"absolute": absolute, "normalised": normalised}


def dense(positions: torch.Tensor, along: torch.Tensor, valid: torch.Tensor, kind: PairLoss) -> torch.Tensor:
    """Mean loss of a kind over all pairs inside each segment (Eq. 5); zero if there is no pair.

    Predictions are (S, m, D) [m], the distances of samples from their segments' starts (S, m) [m]; ``valid`` (S, m)
    bool says which samples exist.
    """
    i, j = torch.triu_indices(positions.shape[1], positions.shape[1], offset=1, device=positions.device)
    pair = PAIR_LOSSES[kind](distance(positions[:, i], positions[:, j]), (along[:, i] - along[:, j]).abs())
    weight = (valid[:, i] & valid[:, j]).to(pair.dtype)
    return (pair * weight).sum() / weight.sum().clamp_min(1.0)


def straight(positions: torch.Tensor, along: torch.Tensor, valid: torch.Tensor) -> torch.Tensor:
    """Mean distance [m] of predictions from the straight line along which the robot drove; ours, not the paper's.

    All distances of a segment are right exactly when ``p_i = mean(p) + (c_i - mean(c)) u`` with a unit vector ``u``. A
    bend by a small angle shortens distances only by its square, but moves predictions off this line in proportion to
    the angle, so this loss responds to bends to which |d - c| hardly responds. ``u`` points along
    ``sum_i (c_i - mean(c)) (p_i - mean(p))``. Arguments as of ``dense``.
    """
    weight = valid.to(positions.dtype)
    share = weight / weight.sum(dim=1, keepdim=True).clamp_min(1.0)
    p = positions - (share[..., None] * positions).sum(dim=1, keepdim=True)
    c = along - (share * along).sum(dim=1, keepdim=True)
    total = ((weight * c)[..., None] * p).sum(dim=1, keepdim=True)
    length = distance(total, torch.zeros_like(total))[..., None]
    u = total / torch.where(length > 0, length, 1.0)
    away = distance(p, c[..., None] * u)
    return (away * weight).sum() / weight.sum().clamp_min(1.0)


IMITATION_SHARE = 0.2  # Fraction of the steps in which the network imitates the initial map, with decreasing weight


def imitate_first(loss: Loss, known: torch.Tensor, slack_m: float) -> Loss:
    """Pull predictions towards an initial map (N, 2) [m], whose error is about ``slack_m``; NaN: not on the map.

    At first all are pulled, while the loss takes over during the first ``IMITATION_SHARE`` of the steps; later only
    those farther from the map than ``slack_m`` [m].
    """
    mapped = known.isfinite().all(dim=1)
    known = known.where(mapped[:, None], 0.0)

    def both(out: torch.Tensor, batch: Batch, done: torch.Tensor) -> torch.Tensor:
        pull = (1.0 - done / IMITATION_SHARE).clamp_min(0.0)
        used = batch.valid & mapped[batch.index]
        away = distance(out, known[batch.index]).where(used, 0.0)
        count = used.sum().clamp_min(1)
        imitation, leash = away.sum() / count, (away - slack_m).clamp_min(0.0).sum() / count
        return (1.0 - pull) * (loss(out, batch, done) + leash) + pull * imitation

    return both


def sample_mapped_first(draw: Draw, sample_mapped: Draw) -> Draw:
    """Draw batches of mapped segments while the initial map is imitated, and of all segments afterwards."""

    def draw_in_turn(generator: torch.Generator, done: float) -> Batch:
        return (draw if done >= IMITATION_SHARE else sample_mapped)(generator, done)

    return draw_in_turn


FLATTENING_START, FLATTENING_END = 0.35, 0.7
"""Fractions of the steps at which the penalty on deviations from the plane begins, and reaches its full weight."""


def flatten_later(loss: Loss, lift: LiftSettings) -> Loss:
    """Add, with increasing weight, the mean distance of predictions from the plane of their two principal axes."""

    def both(out: torch.Tensor, batch: Batch, done: torch.Tensor) -> torch.Tensor:
        push = lift.penalty * min(1.0, max(0.0, (float(done) - FLATTENING_START) / (FLATTENING_END - FLATTENING_START)))
        if push == 0.0:
            return loss(out, batch, done)
        points = out[batch.valid]
        if not points.isfinite().all():  # the training has diverged, as its loss will show
            return loss(out, batch, done)
        centre, axes = find_plane(points.detach())
        points = points - centre
        return loss(out, batch, done) + push * distance(points, points @ axes @ axes.T).mean()

    return both


def find_plane(points: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Centre (D,) and two principal axes (D, 2) of points (n, D); for D = 2, the origin and the coordinate axes."""
    if points.shape[1] == 2:
        return torch.zeros_like(points[0]), torch.eye(2, dtype=points.dtype, device=points.device)
    centre = points.mean(dim=0)
    _, axes = torch.linalg.eigh((points - centre).T @ (points - centre))
    return centre, axes[:, -2:]
