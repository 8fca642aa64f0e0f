"""Unfolded starts of a training: by imitation of an initial map, or by lifting into more dimensions.

By imitation the network first learns an initial map, and later is only kept near it. By lifting, a network with more
than two outputs, which a penalty flattens into a plane during training.
"""

import torch

from deepgps.config.learning import LiftSettings
from deepgps.learning import losses
from deepgps.learning.batches import Batch, Draw
from deepgps.learning.step import Loss

IMITATE = 0.2
"""Fraction of the steps in which the network imitates the initial map, with decreasing weight."""


def imitate_first(loss: Loss, known: torch.Tensor, slack_m: float, weight: float = 1.0) -> Loss:
    """Pull predictions towards an initial map: all of them at first, later only those farther than ``slack_m`` from it.

    Args:
        loss: The loss that takes over gradually during the first ``IMITATE`` of the steps.
        known: Initial map (N, 2) [m]; NaN for observations that are not on it.
        slack_m: Approximate error of the initial map [m].
        weight: Weight of that later pull beside the loss.
    """
    mapped = known.isfinite().all(dim=1)
    known = known.where(mapped[:, None], 0.0)

    def both(out: torch.Tensor, batch: Batch, done: torch.Tensor) -> torch.Tensor:
        pull = (1.0 - done / IMITATE).clamp_min(0.0)
        used = batch.valid & mapped[batch.index]
        away = losses.distance(out, known[batch.index]).where(used, 0.0)
        count = used.sum().clamp_min(1)
        imitation, leash = away.sum() / count, (away - slack_m).clamp_min(0.0).sum() / count
        return (1.0 - pull) * (loss(out, batch, done) + weight * leash) + pull * imitation

    return both


def sample_mapped_first(draw: Draw, sample_mapped: Draw) -> Draw:
    """Draw batches of mapped segments while the initial map is imitated, and of all segments afterwards.

    Args:
        draw: Draws batches of all segments.
        sample_mapped: Draws batches of the segments on the map.
    """

    def draw_in_turn(generator: torch.Generator, done: float) -> Batch:
        return (draw if done >= IMITATE else sample_mapped)(generator, done)

    return draw_in_turn


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
