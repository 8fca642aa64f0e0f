"""A trained method as a torch module that ONNX can express: images in, poses out, as for the run itself."""

import numpy as np
import torch
from torch import nn

from deepgps.data.features import LEAST, Features, make_waves
from deepgps.positioner.confidence import ALIKE, GROWTH, LEVELS, NEAREST, Confidence, find_normal_radius
from deepgps.positioner.positioner import NetworkPositioner
from deepgps.robot_io.export.yaw import YawModule, wrap
from sim.alignment import Alignment


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


class Deployed(nn.Module):
    """Poses of polar images of an upright camera; what sets images upright comes before.

    Args:
        positioner: A trained network on polar images.
        alignment: From its map's frame to that of the poses; None: the poses are in the map's frame.
    """

    centre: torch.Tensor
    axes: torch.Tensor

    def __init__(self, positioner: NetworkPositioner, alignment: Alignment | None) -> None:
        super().__init__()
        rings, sectors, _ = positioner.shape
        self.features = None if positioner.features is None else FeatureModule(positioner.features)
        self.likeness = None if positioner.likeness is None else FeatureModule(positioner.likeness)
        self.network, self.mount = positioner.network, positioner.mount
        self.register_buffer("centre", positioner.centre)
        self.register_buffer("axes", positioner.axes.double())
        table = positioner.headings
        self.yaws = None if table is None else YawModule(table, rings, sectors)
        self.chirality = 1 if table is None else table.chirality
        self.confidence = None if positioner.confidence is None else ConfidenceModule(positioner.confidence)
        self.frame = None if alignment is None else FrameModule(alignment)

    def forward(self, image: torch.Tensor) -> dict[str, torch.Tensor]:
        """Poses of images (B, rings, sectors, 3) uint8: the parts of ``Poses`` that the method gives, by name."""
        image = image.float()
        inputs = image.permute(0, 3, 1, 2) / 255.0 if self.features is None else self.features(image)
        position = (self.network(inputs) - self.centre).double() @ self.axes
        features = inputs if self.likeness is None else self.likeness(image)
        found = {} if self.confidence is None else self.confidence(features, position)
        if self.yaws is not None:
            yaw, std, weight, position_std = self.yaws(image, position)
            position = self._leave_camera(position, yaw[:, 0])
            if self.frame is not None:
                yaw = self.frame.turn(yaw)
            found |= {
                "position_std": position_std,
                "yaw": yaw[:, 0],
                "yaw_std": std[:, 0],
                "yaw_weight": weight[:, 0],
                "other_yaw": yaw[:, 1],
                "other_weight": weight[:, 1],
            }
        position = position if self.frame is None else self.frame(position)
        found = {"position": position, **found}
        return {name: part if part.dtype == torch.bool else part.float() for name, part in found.items()}

    def _leave_camera(self, camera: torch.Tensor, yaw: torch.Tensor) -> torch.Tensor:
        """Positions of the axle (B, 2) by those of the camera; where the yaw is NaN, the same."""
        ahead, left = self.mount[0], self.mount[1] * self.chirality
        if not any(self.mount):
            return camera
        cos, sin = yaw.cos(), yaw.sin()
        way = torch.stack([cos * ahead - sin * left, sin * ahead + cos * left], dim=1)
        return camera - torch.where(yaw.isnan()[:, None], torch.zeros_like(way), way)


class FeatureModule(nn.Module):
    """``Features.apply`` for polar images."""

    wave: torch.Tensor
    least: torch.Tensor
    mean: torch.Tensor
    basis: torch.Tensor

    def __init__(self, features: Features) -> None:
        super().__init__()
        _, sectors, _ = features.shape
        self.by_rank = features.values == "ranks"
        self.register_buffer("wave", make_waves(sectors, min(features.frequencies, sectors // 2)))
        # As a single number, the optimiser of ONNX models takes this for zero and drops it.
        self.register_buffer("least", torch.full((min(features.frequencies, sectors // 2),), LEAST))
        self.register_buffer("mean", features.mean)
        self.register_buffer("basis", features.basis)

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        """Features (B, components) of images (B, rings, sectors, 3) float32."""
        image = image.transpose(2, 3)
        image = _rank_values(image) if self.by_rank else image
        real, imaginary = (image @ self.wave).chunk(2, dim=3)
        size = (real.square() + imaginary.square()).sqrt()
        a, b, c, d = real[:, :-1, :, 1:], imaginary[:, :-1, :, 1:], real[:, 1:, :, 1:], imaginary[:, 1:, :, 1:]
        half = (size[:, :-1, :, 1:] * size[:, 1:, :, 1:] + self.least).sqrt()
        shrink = (half * half.sqrt()).reciprocal()
        product = torch.stack([(a * c + b * d) * shrink, (b * c - a * d) * shrink], dim=4)
        described = torch.cat([size.sqrt().flatten(1), product.flatten(1)], dim=1)
        return (described - self.mean) @ self.basis


def _rank_values(image: torch.Tensor) -> torch.Tensor:
    """``data.ranks.rank_values`` of images (B, rings, colours, sectors)."""
    place = image.long().flatten(1)
    count = torch.zeros((len(place), 256)).scatter_add(1, place, torch.ones(place.shape))
    darker = (count.cumsum(dim=1) - count / 2) * (255.0 / place.shape[1])
    return darker.gather(1, place).view(image.shape)


class FrameModule(nn.Module):
    """An ``Alignment``."""

    rotation: torch.Tensor
    translation: torch.Tensor

    def __init__(self, alignment: Alignment) -> None:
        super().__init__()
        self.angle = float(np.arctan2(*alignment.rotation[::-1, 0]))
        self.sign = float(np.sign(np.linalg.det(alignment.rotation)))
        self.register_buffer("rotation", torch.from_numpy(alignment.rotation.T.copy()))
        self.register_buffer("translation", torch.from_numpy(alignment.translation.copy()))

    def forward(self, position: torch.Tensor) -> torch.Tensor:
        """Positions (B, 2) float64 [m] in the frame that the alignment leads to."""
        return position @ self.rotation + self.translation

    def turn(self, yaw: torch.Tensor) -> torch.Tensor:
        """Yaws of any shape float64 [rad] in that frame; NaN stays NaN."""
        return wrap(self.angle + self.sign * yaw)
