"""Unfolding by lifting: a network with more than two outputs, which a penalty flattens into a plane during training."""

import torch

from deepgps.config.learning import LiftSettings
from deepgps.learning import losses
from deepgps.learning.batches import Batch
from deepgps.learning.step import Loss

FLATTEN_FROM, FLATTEN_TO = 0.35, 0.7
"""Fractions of the steps at which the penalty on deviations from the plane begins, and reaches its full weight."""


def flatten_later(loss: Loss, lift: LiftSettings) -> Loss:
    """Add, with increasing weight, the mean distance of predictions from the plane of their two principal axes.

    It reads values back from a GPU, which therefore cannot replay its steps.
    """

    def both(out: torch.Tensor, batch: Batch, done: torch.Tensor) -> torch.Tensor:
        push = lift.penalty * min(1.0, max(0.0, (float(done) - FLATTEN_FROM) / (FLATTEN_TO - FLATTEN_FROM)))
        if push == 0.0:
            return loss(out, batch, done)
        points = out[batch.valid]
        if not points.isfinite().all():  # the training has diverged, as its loss will show
            return loss(out, batch, done)
        centre, axes = find_plane(points.detach())
        points = points - centre
        return loss(out, batch, done) + push * losses.distance(points, points @ axes @ axes.T).mean()

    return both


def find_plane(points: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Centre (D,) and two principal axes (D, 2) of points (n, D); for D = 2, the origin and the coordinate axes."""
    if points.shape[1] == 2:
        return torch.zeros_like(points[0]), torch.eye(2, dtype=points.dtype, device=points.device)
    centre = points.mean(dim=0)
    _, axes = torch.linalg.eigh((points - centre).T @ (points - centre))
    return centre, axes[:, -2:]
