"""A trained method as a torch module that ONNX can express: images in, poses with yaw and confidence out."""

from typing import NamedTuple

import numpy as np
import torch
from torch import nn

from deepgps.data.features import PRODUCT_FLOOR, Features, make_waves
from deepgps.positioner import confidence, headings
from deepgps.positioner.positioner import NetworkPositioner
from sim.alignment import Alignment
from sim.sensors.visual_compass import MATCH_FLOOR, MIN_CONTRAST


class FoundYaw(NamedTuple):
    """Hypotheses of the yaw of B images, the likelier first, and the standard deviation of their positions."""

    yaw: torch.Tensor  # Yaw (B, 2) [rad], NaN where there is none
    std: torch.Tensor  # Its standard deviation (B, 2) [rad]
    weight: torch.Tensor  # Share of the entries that agree on each (B, 2)
    position_std: torch.Tensor  # Standard deviation of the position along one axis (B,) [m]


class YawModule(nn.Module):
    """Finds yaw as a table of headings does, in images of so many rings and sectors."""

    def __init__(self, table: headings.HeadingTable, rings: int, sectors: int) -> None:
        super().__init__()
        self.chirality, self.std_factor, self.sectors = table.chirality, table.std_factor, sectors
        pool, passed = _pool(rings), headings.filter_frequencies(sectors)
        wave = np.exp(-2j * np.pi / sectors * np.outer(np.arange(sectors), np.arange(1, len(passed) + 1))) * passed
        angle = (
            2.0
            * np.pi
            / headings.ANGLE_SAMPLES
            * np.outer(np.arange(1, len(passed) + 1), np.arange(headings.ANGLE_SAMPLES))
        )
        self.spectrum = _keep(np.concatenate([table.spectrum[..., 0], table.spectrum[..., 1]], axis=2))
        self.place, self.heading = _keep(table.place, np.float64), _keep(table.heading, np.float64)
        self.parallax, self.position_std = _keep(table.parallax, np.float64), _keep(table.position_std, np.float64)
        self.pool, self.loud = _keep(pool, np.float32), _keep(np.sqrt(np.arange(len(pool)) + 0.5)[:, None], np.float32)
        self.wave = _keep(np.concatenate([wave.real, wave.imag], axis=1), np.float32)
        self.curve = _keep(np.concatenate([np.cos(angle), -np.sin(angle)]), np.float32)

    def forward(self, image: torch.Tensor, position: torch.Tensor) -> FoundYaw:
        """Yaw of images (B, rings, sectors, channels) float32 whose camera was at positions (B, 2) float64 [m]."""
        phases, blank = self._take_phases(image)
        away = position[:, None] - self.place
        nearest = away.square().sum(dim=2).topk(min(headings.NEAREST_ENTRIES, len(self.place)), largest=False).indices
        rows = torch.cat([nearest, self._find_alike(phases)], dim=1)
        yaw, trust = self._weigh(phases, rows, position)
        trust = trust * (~blank)[:, None]
        std = self.position_std[nearest].square().mean(dim=1).sqrt()
        return FoundYaw(*self._choose(yaw, trust), std)

    def _take_phases(self, image: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Coefficients (B, L, 2 K): real parts, then imaginary ones; and which images are blank (B,)."""
        pooled = self.pool @ image.permute(0, 3, 1, 2)
        found = pooled @ self.wave * self.loud
        energy = found.square().sum(dim=(1, 2, 3))
        blank = energy <= MIN_CONTRAST * self.sectors * pooled.square().sum(dim=(1, 2, 3))
        found = torch.where(blank[:, None, None, None], torch.zeros_like(found), found).flatten(1, 2)
        return _normalise(found), blank

    def _find_alike(self, phases: torch.Tensor) -> torch.Tensor:
        """Rows of the entries most alike (B, ALIKE); what the table alone decides is computed on loading."""
        known = _take_looks(_normalise(self.spectrum.float()))
        mean = known.mean(dim=0)
        likeness = _divide(_take_looks(phases) - mean) @ _divide(known - mean).T
        return likeness.topk(min(headings.SIMILAR_ENTRIES, len(self.place))).indices

    def _weigh(
        self, phases: torch.Tensor, rows: torch.Tensor, position: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Angles and their weights (B, 2 M) by comparison with entries (B, M)."""
        angle, height = self._correlate(_normalise(self.spectrum[rows].float()), phases)
        unexplained = (1.0 - height.square()).clamp_min(0.0) + MATCH_FLOOR
        real, imaginary = phases.double().chunk(2, dim=2)
        power = (real.square() + imaginary.square()).sum(dim=1)
        values = 2.0 * power.sum(dim=1).square() / power.square().sum(dim=1).clamp_min(1e-30)
        share = (unexplained / unexplained[..., :1]) ** (-values[:, None, None] / 2.0)
        share = torch.where(height > 0.0, share, torch.zeros_like(share))
        first = (unexplained[..., :1] + 0.01).square()
        trust = share / share.sum(dim=2, keepdim=True).clamp_min(1e-30) / first
        away = position[:, None] - self.place[rows]
        distance = away.square().sum(dim=2, keepdim=True).sqrt()
        near = (headings.MAX_PARALLAX_M / distance.clamp_min(1e-9)).clamp_max(1.0) * (
            distance < 3.0 * headings.MAX_PARALLAX_M
        )
        shift = self.heading[rows] + (self.parallax[rows] * away * near).sum(dim=2)
        return (shift[..., None] + self.chirality * angle).flatten(1), trust.flatten(1)

    def _correlate(self, known: torch.Tensor, phases: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Angle and height (B, M, 2) float64 of the two highest peaks of the correlation with known images."""
        a, b = phases[:, None].chunk(2, dim=3)
        c, d = known.chunk(2, dim=3)
        cross = torch.cat([(a * c + b * d).sum(dim=2), (a * d - b * c).sum(dim=2)], dim=2)
        curve = cross @ self.curve
        before, after = curve.roll(1, dims=2), curve.roll(-1, dims=2)
        peaks = torch.where((curve > before) & (curve >= after), curve, -torch.ones_like(curve))
        sample, found = torch.arange(headings.ANGLE_SAMPLES), []
        for _ in range(2):
            place = peaks.argmax(dim=2, keepdim=True)
            low, top, high = (part.gather(2, place).double() for part in (before, curve, after))
            bend = low - 2.0 * top + high
            aside = torch.where(bend < 0.0, (low - high) / (2.0 * bend.clamp_max(-1e-30)), torch.zeros_like(bend))
            found.append((2.0 * np.pi / headings.ANGLE_SAMPLES * (place + aside), peaks.gather(2, place).double()))
            peaks = torch.where(sample == place, -torch.ones_like(peaks), peaks)
        angle, height = (torch.cat(part, dim=2) for part in zip(*found, strict=True))
        return angle, height

    def _choose(self, yaw: torch.Tensor, trust: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """The two likeliest hypotheses (B, 2) among angles (B, M) with these weights."""
        first, spread, weight = _find_mode(yaw, trust)
        other = torch.where(
            wrap(yaw - first[:, None]).abs() > headings.MODE_SEPARATION_RAD, trust, torch.zeros_like(trust)
        )
        second, other_spread, other_weight = _find_mode(yaw, other)
        both = torch.stack([weight, other_weight], dim=1) / trust.sum(dim=1).clamp_min(1e-30)[:, None]
        both = torch.where(both < headings.MIN_WEIGHT, torch.zeros_like(both), both)
        found, std = torch.stack([first, second], dim=1), self.std_factor * torch.stack([spread, other_spread], dim=1)
        none = torch.full_like(both, torch.nan)
        return torch.where(both > 0.0, wrap(found), none), torch.where(both > 0.0, std, none), both


def _keep(array: np.ndarray, kind: type[np.generic] | None = None) -> nn.Buffer:
    return nn.Buffer(torch.from_numpy(np.array(array, kind, order="C")))


def _pool(rings: int) -> np.ndarray:
    """Matrix (P, rings) that takes the means of neighbouring rings."""
    edge = np.append(headings.choose_parts(rings, headings.RINGS), rings)
    ring = np.arange(rings)
    inside = (ring >= edge[:-1, None]) & (ring < edge[1:, None])
    return inside / np.diff(edge)[:, None]


def _find_mode(angle: torch.Tensor, weight: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Robust mean of the angles near the mode of angles (B, M), their spread, and their weight, each (B,)."""
    near = (wrap(angle[:, :, None] - angle[:, None]).abs() < headings.MODE_WIDTH_RAD).double()
    total = (near * weight[:, None]).sum(dim=2) * (weight > 0.0)
    best = total.argmax(dim=1, keepdim=True)
    mode = angle.gather(1, best)
    member = near.gather(1, best[..., None].expand(-1, 1, near.shape[2]))[:, 0] * weight
    member = member.clamp_min(1e-30)
    for _ in range(5):
        missed = wrap(angle - mode)
        robust = member / (1.0 + (missed / headings.SCALE_RAD).square())
        mode = mode + (robust * missed).sum(dim=1, keepdim=True) / robust.sum(dim=1, keepdim=True)
    square = (robust * wrap(angle - mode).square()).sum(dim=1) / robust.sum(dim=1)
    return mode[:, 0], (square + headings.MIN_SPREAD_RAD**2).sqrt(), total.gather(1, best)[:, 0]


def wrap(angle: torch.Tensor) -> torch.Tensor:
    """The same angles [rad] between -pi and pi."""
    turns = (angle + np.pi) / (2.0 * np.pi)
    return angle - 2.0 * np.pi * turns.floor()


def _normalise(phases: torch.Tensor) -> torch.Tensor:
    size = phases.square().sum(dim=(-2, -1), keepdim=True).sqrt()
    return phases / size.clamp_min(1e-12)


def _take_looks(phases: torch.Tensor) -> torch.Tensor:
    """What of coefficients (n, L, 2 K) no turn changes (n, L K)."""
    real, imaginary = phases.chunk(2, dim=2)
    return (real.square() + imaginary.square()).sqrt().sqrt().flatten(1)


def _divide(rows: torch.Tensor) -> torch.Tensor:
    return rows / rows.square().sum(dim=1, keepdim=True).sqrt().clamp_min(1e-12)


class ConfidenceModule(nn.Module):
    """Says how far to trust positions, as a table of confidence does."""

    def __init__(self, table: confidence.Confidence) -> None:
        super().__init__()
        self.threshold_m, self.reach_m = table.threshold_m, table.reach_m
        self.gives_radii = bool(np.isfinite(table.slope).all())
        self.known, self.normal = (
            _keep(table.features),
            _keep(confidence.find_normal_radius(np.array(confidence.LEVELS))),
        )
        self.scale, self.metres = _keep(table.scale, np.float32), _keep(table.metres, np.float32)
        self.place, self.map_std, self.slope = (
            _keep(part, np.float64) for part in (table.place, table.map_std, table.slope)
        )

    def forward(self, features: torch.Tensor, position: torch.Tensor) -> dict[str, torch.Tensor]:
        """Parts of ``Poses`` by name, of images with features (B, K) whose camera was at positions (B, 2) [m]."""
        away = (position[:, None] - self.place).square().sum(dim=2)
        rows = away.topk(min(confidence.NEAREST_ENTRIES, len(self.place)), largest=False).indices
        unlike = self.known[rows].float() * self.scale - features[:, None, : len(self.scale)]
        distance = unlike.square().sum(dim=2).sqrt()
        alike = distance.topk(min(confidence.SIMILAR_ENTRIES, distance.shape[1]), largest=False).values
        novelty = (alike.mean(dim=1) * self.metres[rows].mean(dim=1)).double()
        found = {"novelty": novelty, "accepted": novelty <= self.threshold_m}
        if not self.gives_radii:
            return found
        flat = self.slope[:, 0] + novelty[:, None] ** confidence.GROWTH * self.slope[:, 1]
        from_map = self.map_std[rows[:, :1]] * self.normal
        radius = (flat.square() + from_map.square()).sqrt()
        small = radius[:, 0].clamp_max(self.reach_m)
        return {**found, "radius_68": small, "radius_95": torch.maximum(small, radius[:, 1].clamp_max(self.reach_m))}


class Deployed(nn.Module):
    """Poses of polar images of an upright camera, aligned or in the map's frame."""

    def __init__(self, positioner: NetworkPositioner, alignment: Alignment | None) -> None:
        super().__init__()
        rings, sectors, _ = positioner.shape
        self.features = None if positioner.features is None else FeatureModule(positioner.features)
        self.likeness = None if positioner.likeness is None else FeatureModule(positioner.likeness)
        self.network, self.mount = positioner.network, positioner.mount
        self.centre, self.axes = nn.Buffer(positioner.centre), nn.Buffer(positioner.axes.double())
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

    def __init__(self, alignment: Alignment) -> None:
        super().__init__()
        self.angle = float(np.arctan2(*alignment.rotation[::-1, 0]))
        self.sign = float(np.sign(np.linalg.det(alignment.rotation)))
        self.rotation, self.translation = _keep(alignment.rotation.T), _keep(alignment.translation)

    def forward(self, position: torch.Tensor) -> torch.Tensor:
        """Positions (B, 2) float64 [m] in the frame that the alignment leads to."""
        return position @ self.rotation + self.translation

    def turn(self, yaw: torch.Tensor) -> torch.Tensor:
        """Yaws of any shape float64 [rad] in that frame; NaN stays NaN."""
        return wrap(self.angle + self.sign * yaw)
