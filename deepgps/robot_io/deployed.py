"""What of a trained method torch computes, as a module that ONNX can express: features and positions of images."""

import torch
from torch import nn

from deepgps.data.features import PRODUCT_FLOOR, Features, describe_rings, make_waves, rank_values
from deepgps.positioner.positioner import FeaturePositioner, NetworkPositioner


class Deployed(nn.Module):
    """Features by which polar images of an upright camera are registered, and the camera's positions by a network."""

    def __init__(self, positioner: FeaturePositioner) -> None:
        super().__init__()
        known, self.network, inputs = positioner.appearance, None, None
        if isinstance(positioner, NetworkPositioner):
            self.network, inputs = positioner.network, positioner.features
            self.centre, self.axes = nn.Buffer(positioner.centre), nn.Buffer(positioner.axes)
        self.features = None if known is None else FeatureModule(known.features)
        self.inputs = None if inputs is None else FeatureModule(inputs)

    def forward(self, image: torch.Tensor) -> dict[str, torch.Tensor]:
        """Whitened features (B, K) and positions (B, 2) [m] of images (B, rings, sectors, 3) uint8, by name."""
        image = image.float()
        found = {} if self.features is None else {"features": self.features(image)}
        if self.network is not None:  # as ``NetworkPositioner.locate_camera``
            inputs = image.permute(0, 3, 1, 2) / 255.0 if self.inputs is None else self.inputs(image)
            found["position"] = (self.network(inputs) - self.centre) @ self.axes
        return found


class FeatureModule(nn.Module):
    """``Features.apply`` for polar images."""

    def __init__(self, features: Features) -> None:
        super().__init__()
        _, sectors, _ = features.shape
        self.by_rank = features.values == "ranks"
        count = min(features.frequencies, sectors // 2)
        self.wave = nn.Buffer(make_waves(sectors, count))
        # As a single number, the optimiser of ONNX models takes this for zero and drops it.
        self.least = nn.Buffer(torch.full((count,), PRODUCT_FLOOR))
        self.mean, self.basis = nn.Buffer(features.mean), nn.Buffer(features.basis)

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        """Features (B, components) of images (B, rings, sectors, 3) float32."""
        image = image.transpose(2, 3)
        described = describe_rings(rank_values(image) if self.by_rank else image, self.wave, self.least)
        return (described - self.mean) @ self.basis
