"""A first map in closed form: the functions of an observation that are linear along every straight drive.

Any coordinate of the plane is a linear function of the way along a straight segment, and only coordinates are so on all
segments that cross one another. So the two coordinates minimise the bend along segments against their variance: a
generalised eigenvalue problem without local minima, which therefore cannot fold. Distances driven then fix lengths and
angles (2 x 2 linear least squares).
"""

import torch

from deepgps.data import Segments
from deepgps.features import solve_generalised

HIDDEN = 1000
RIDGE = 1e-2
ROUNDS = 30
RESIDUAL_M = 0.02


def has_lines(segments: Segments) -> bool:
    """Whether most readings lie on segments of at least three, without which nothing tells straight from bent."""
    return bool(segments.count[segments.count >= 3].sum() > segments.count.sum() / 2)


def map_by_lines(features: torch.Tensor, segments: Segments, generator: torch.Generator) -> torch.Tensor:
    """Positions of the training observations, straight along all segments.

    Args:
        features: (N, K) float32.
        segments: Weak constraints.
        generator: Draws the random layer on which the map is linear.

    Returns:
        (N, 2) float32 [m], in a frame of its own.
    """
    hidden = _expand(features, generator)
    bend = torch.cat([_bend(hidden, segments, row) for row in range(len(segments.count)) if segments.count[row] >= 3])
    noise = bend.T @ bend / len(bend)
    noise += RIDGE * noise.diagonal().mean() * torch.eye(len(noise), dtype=noise.dtype)
    _, axes = solve_generalised(hidden.T @ hidden / len(hidden), noise)
    plane = hidden @ axes[:, -2:]
    return (plane @ _metric(plane, segments)).float()


def _expand(features: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
    weight = torch.randn((features.shape[1], HIDDEN), generator=generator) / features.shape[1] ** 0.5
    shift = 0.5 * torch.randn(HIDDEN, generator=generator)
    hidden = torch.cat([features, torch.relu(features @ weight + shift)], dim=1).double()
    return hidden - hidden.mean(dim=0)


def _bend(hidden: torch.Tensor, segments: Segments, row: int) -> torch.Tensor:
    count = int(segments.count[row])
    along = segments.distance[row, :count].double()
    basis, _ = torch.linalg.qr(torch.stack([torch.ones_like(along), along], dim=1))
    values = hidden[segments.index[row, :count]]
    return values - basis @ (basis.T @ values)


def _metric(plane: torch.Tensor, segments: Segments) -> torch.Tensor:
    # Find the symmetric M with |chord|_M^2 = c^2 for every whole segment and return its root. Least squares, repeated
    # with weights 1 / |residual|, which ends near the least sum of |residual|: corners of the first map are far off.
    rows = torch.arange(len(segments.count))
    last = segments.count - 1
    x, y = (plane[segments.index[rows, last]] - plane[segments.index[:, 0]]).T
    c = segments.distance[rows, last].double().clamp_min(1e-6)
    # Divided by c, a row's residual is about twice |chord| - c.
    terms = torch.stack([x * x, 2.0 * x * y, y * y], dim=1) / c[:, None]
    weight = torch.ones_like(c)
    solution = torch.zeros(3, dtype=torch.float64)
    for _ in range(ROUNDS):
        solution = torch.linalg.lstsq(terms * weight[:, None], c[:, None] * weight[:, None], driver="gelsd").solution[:, 0]
        weight = ((terms @ solution - c).abs() + RESIDUAL_M).rsqrt()
    a, b, d = solution.tolist()
    size, axes = torch.linalg.eigh(torch.tensor([[a, b], [b, d]], dtype=torch.float64))
    return axes * size.clamp_min(1e-3 * float(size.abs().max())).sqrt()
