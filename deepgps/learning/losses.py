"""Losses on distances (paper Eq. 2, 3 and 5), which depend on differences of predictions, never on positions.

Each loss is the mean over pairs where the paper writes the sum, so that its size does not depend on the batch. The
end-point strategy is the case of two samples in a segment.
"""

from typing import NamedTuple

import torch

from deepgps.config.learning import PairLoss


class Weights(NamedTuple):
    """Weights of residuals; None: 1.

    Attributes:
        pairs: Weights of the distance between each two readings of a segment (S, m, m).
        places: Weights of each reading's place along its line (S, m).
    """

    pairs: torch.Tensor | None = None
    places: torch.Tensor | None = None


def weigh_equally(batch: object) -> Weights:
    """Return the paper's weights: every residual counts the same."""
    return Weights()


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


def dense(
    positions: torch.Tensor,
    along: torch.Tensor,
    valid: torch.Tensor,
    kind: PairLoss,
    trust: torch.Tensor | None = None,
    curvature: float = 0.0,
) -> torch.Tensor:
    """Mean loss over all pairs inside each segment (Eq. 5).

    Args:
        positions: Predictions (S, m, D) [m].
        along: Distance of each sample from its segment's start (S, m) [m].
        valid: Which samples exist (S, m) bool.
        kind: Loss of one pair.
        trust: Factor of each pair's loss (S, m, m); none: 1.
        curvature: Of the segments [1 / m]: positions are as far apart as the chord, (2 / k) sin(k c / 2).

    Returns:
        A scalar; zero if there is no pair.
    """
    i, j = torch.triu_indices(positions.shape[1], positions.shape[1], offset=1, device=positions.device)
    way = (along[:, i] - along[:, j]).abs()
    if curvature:
        way = 2.0 / curvature * (curvature * way / 2.0).sin()
    pair = PAIR_LOSSES[kind](distance(positions[:, i], positions[:, j]), way)
    weight = (valid[:, i] & valid[:, j]).to(pair.dtype)
    if trust is not None:
        pair = pair * trust[:, i, j]
    return (pair * weight).sum() / weight.sum().clamp_min(1.0)


def straight(
    positions: torch.Tensor,
    along: torch.Tensor,
    valid: torch.Tensor,
    trust: torch.Tensor | None = None,
    curvature: float = 0.0,
) -> torch.Tensor:
    """Mean distance of predictions from the straight line along which the robot drove; ours, not the paper's.

    All distances of a segment are right exactly when ``p_i = mean(p) + (c_i - mean(c)) u`` with a unit vector ``u``. A
    bend by a small angle shortens distances only by its square, but moves predictions off this line in proportion to
    the angle, so this loss responds to bends to which |d - c| hardly responds. ``u`` points along
    ``sum_i (c_i - mean(c)) (p_i - mean(p))``.

    Args:
        positions: Predictions (S, m, D) [m].
        along: Distance of each sample from its segment's start (S, m) [m].
        valid: Which samples exist (S, m) bool.
        trust: Factor of the part of the distance along the line (S, m), since encoders err along the line and not
            across it; none: 1.
        curvature: Of the segments, to the left [1 / m]; other than 0 only for positions in a plane that is not
            mirrored. The line is then an arc: sin(k c) / k along ``u`` and (1 - cos(k c)) / k to its left.

    Returns:
        A scalar [m]; zero if there is no sample.
    """
    weight = valid.to(positions.dtype)
    share = weight / weight.sum(dim=1, keepdim=True).clamp_min(1.0)
    p = positions - (share[..., None] * positions).sum(dim=1, keepdim=True)
    c = along - (share * along).sum(dim=1, keepdim=True)
    total = ((weight * c)[..., None] * p).sum(dim=1, keepdim=True)
    length = distance(total, torch.zeros_like(total))[..., None]
    u = total / torch.where(length > 0, length, 1.0)
    if curvature:
        left = torch.stack([-u[..., 1], u[..., 0]], dim=-1)
        bent, c = (1.0 - (curvature * c).cos()) / curvature, (curvature * c).sin() / curvature
        p = p - (bent - (share * bent).sum(dim=1, keepdim=True))[..., None] * left
        c = c - (share * c).sum(dim=1, keepdim=True)
    if trust is None:
        away = distance(p, c[..., None] * u)
    else:
        ahead = ((p * u).sum(dim=-1) - c)[..., None] * u
        away = distance(p - c[..., None] * u, (1.0 - trust[..., None]) * ahead)
    return (away * weight).sum() / weight.sum().clamp_min(1.0)
