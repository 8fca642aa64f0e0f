"""Novelty, acceptance and radii as a torch module: ``methods/confidence.py`` in operations that ONNX has."""

import numpy as np
import torch
from torch import nn

from deepgps.positioner.confidence import ALIKE, GROWTH, LEVELS, NEAREST, Confidence, find_normal_radius


class ConfidenceModule(nn.Module):
    """Says how far to trust positions, as a table of confidence does.

    Args:
        table: The table.
    """

    known: torch.Tensor
    scale: torch.Tensor
    place: torch.Tensor
    metres: torch.Tensor
    map_std: torch.Tensor
    slope: torch.Tensor
    normal: torch.Tensor

    def __init__(self, table: Confidence) -> None:
        super().__init__()
        self.threshold_m, self.reach_m = table.threshold_m, table.reach_m
        self.gives_radii = bool(np.isfinite(table.slope).all())
        arrays = {
            "known": table.features,
            "scale": np.float32(table.scale),
            "metres": np.float32(table.metres),
            "normal": find_normal_radius(np.array(LEVELS)),
            **{name: np.float64(getattr(table, name)) for name in ("place", "map_std", "slope")},
        }
        for name, array in arrays.items():
            self.register_buffer(name, torch.from_numpy(np.ascontiguousarray(array)))

    def forward(self, features: torch.Tensor, position: torch.Tensor) -> dict[str, torch.Tensor]:
        """Parts of ``Poses`` by name, of images with features (B, K) whose camera was at positions (B, 2) [m]."""
        away = (position[:, None] - self.place).square().sum(dim=2)
        rows = away.topk(min(NEAREST, len(self.place)), largest=False).indices
        unlike = self.known[rows].float() * self.scale - features[:, None, : len(self.scale)]
        distance = unlike.square().sum(dim=2).sqrt()
        alike = distance.topk(min(ALIKE, distance.shape[1]), largest=False).values
        novelty = (alike.mean(dim=1) * self.metres[rows].mean(dim=1)).double()
        found = {"novelty": novelty, "accepted": novelty <= self.threshold_m}
        if not self.gives_radii:
            return found
        flat = self.slope[:, 0] + novelty[:, None] ** GROWTH * self.slope[:, 1]
        from_map = self.map_std[rows[:, :1]] * self.normal
        radius = (flat.square() + from_map.square()).sqrt()
        small = radius[:, 0].clamp_max(self.reach_m)
        return {**found, "radius_68": small, "radius_95": torch.maximum(small, radius[:, 1].clamp_max(self.reach_m))}
