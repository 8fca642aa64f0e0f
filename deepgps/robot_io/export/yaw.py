"""The yaw of a polar image as a torch module: ``methods/headings.py`` in operations that ONNX has.

Fourier transforms are products with matrices, and the nearest places are found without a tree. Complex numbers are
pairs of real ones.
"""

from typing import NamedTuple

import numpy as np
import torch
from torch import nn

from deepgps.positioner.headings import (
    ALIKE,
    APART_RAD,
    FARTHEST_M,
    FINE,
    FLOOR_RAD,
    LEAST_WEIGHT,
    NEAREST,
    RINGS,
    SCALE_RAD,
    TOGETHER_RAD,
    HeadingTable,
    choose_parts,
    filter_frequencies,
)
from sim.sensors.compass import LEAST_CONTRAST, MATCH_FLOOR


class FoundYaw(NamedTuple):
    """Hypotheses of the yaw of B images, the likelier first, and the standard deviation of their positions.

    Attributes:
        yaw: Yaw (B, 2) [rad], NaN where there is none.
        std: Its standard deviation (B, 2) [rad].
        weight: Share of the entries that agree on each (B, 2).
        position_std: Standard deviation of the position along one axis (B,) [m].
    """

    yaw: torch.Tensor
    std: torch.Tensor
    weight: torch.Tensor
    position_std: torch.Tensor


class YawModule(nn.Module):
    """Finds yaw as a table of headings does.

    Args:
        table: The table.
        rings: Rings of the images.
        sectors: Sectors of the images.
    """

    spectrum: torch.Tensor
    place: torch.Tensor
    heading: torch.Tensor
    parallax: torch.Tensor
    position_std: torch.Tensor
    pool: torch.Tensor
    loud: torch.Tensor
    wave: torch.Tensor
    curve: torch.Tensor

    def __init__(self, table: HeadingTable, rings: int, sectors: int) -> None:
        super().__init__()
        self.chirality, self.std_factor, self.sectors = table.chirality, table.std_factor, sectors
        pool, passed = _pool(rings), filter_frequencies(sectors)
        wave = np.exp(-2j * np.pi / sectors * np.outer(np.arange(sectors), np.arange(1, len(passed) + 1))) * passed
        angle = 2.0 * np.pi / FINE * np.outer(np.arange(1, len(passed) + 1), np.arange(FINE))
        arrays = {
            "spectrum": np.concatenate([table.spectrum[..., 0], table.spectrum[..., 1]], axis=2),
            **{name: np.float64(getattr(table, name)) for name in ("place", "heading", "parallax", "position_std")},
            "pool": np.float32(pool),
            "loud": np.sqrt(np.arange(len(pool)) + 0.5)[:, None].astype(np.float32),
            "wave": np.float32(np.concatenate([wave.real, wave.imag], axis=1)),
            "curve": np.float32(np.concatenate([np.cos(angle), -np.sin(angle)])),
        }
        for name, array in arrays.items():
            self.register_buffer(name, torch.from_numpy(np.ascontiguousarray(array)))

    def forward(self, image: torch.Tensor, position: torch.Tensor) -> FoundYaw:
        """Yaw of images (B, rings, sectors, channels) float32 whose camera was at positions (B, 2) float64 [m]."""
        phases, blank = self._take_phases(image)
        away = position[:, None] - self.place
        nearest = away.square().sum(dim=2).topk(min(NEAREST, len(self.place)), largest=False).indices
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
        blank = energy <= LEAST_CONTRAST * self.sectors * pooled.square().sum(dim=(1, 2, 3))
        found = torch.where(blank[:, None, None, None], torch.zeros_like(found), found).flatten(1, 2)
        return _normalise(found), blank

    def _find_alike(self, phases: torch.Tensor) -> torch.Tensor:
        """Rows of the entries most alike (B, ALIKE); what is made of the table alone is made when a model is loaded."""
        known = _take_looks(_normalise(self.spectrum.float()))
        mean = known.mean(dim=0)
        likeness = _divide(_take_looks(phases) - mean) @ _divide(known - mean).T
        return likeness.topk(min(ALIKE, len(self.place))).indices

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
        near = (FARTHEST_M / distance.clamp_min(1e-9)).clamp_max(1.0) * (distance < 3.0 * FARTHEST_M)
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
        sample, found = torch.arange(FINE), []
        for _ in range(2):
            place = peaks.argmax(dim=2, keepdim=True)
            low, top, high = (part.gather(2, place).double() for part in (before, curve, after))
            bend = low - 2.0 * top + high
            aside = torch.where(bend < 0.0, (low - high) / (2.0 * bend.clamp_max(-1e-30)), torch.zeros_like(bend))
            found.append((2.0 * np.pi / FINE * (place + aside), peaks.gather(2, place).double()))
            peaks = torch.where(sample == place, -torch.ones_like(peaks), peaks)
        angle, height = (torch.cat(part, dim=2) for part in zip(*found, strict=True))
        return angle, height

    def _choose(self, yaw: torch.Tensor, trust: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """The two likeliest hypotheses (B, 2) among angles (B, M) with these weights."""
        first, spread, weight = _find_mode(yaw, trust)
        other = torch.where(wrap(yaw - first[:, None]).abs() > APART_RAD, trust, torch.zeros_like(trust))
        second, other_spread, other_weight = _find_mode(yaw, other)
        both = torch.stack([weight, other_weight], dim=1) / trust.sum(dim=1).clamp_min(1e-30)[:, None]
        both = torch.where(both < LEAST_WEIGHT, torch.zeros_like(both), both)
        found, std = torch.stack([first, second], dim=1), self.std_factor * torch.stack([spread, other_spread], dim=1)
        none = torch.full_like(both, torch.nan)
        return torch.where(both > 0.0, wrap(found), none), torch.where(both > 0.0, std, none), both


def _pool(rings: int) -> np.ndarray:
    """Matrix (P, rings) that takes the means of neighbouring rings."""
    edge = np.append(choose_parts(rings, RINGS), rings)
    ring = np.arange(rings)
    inside = (ring >= edge[:-1, None]) & (ring < edge[1:, None])
    return inside / np.diff(edge)[:, None]


def _find_mode(angle: torch.Tensor, weight: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Robust mean of the angles near the mode of angles (B, M), their spread, and their weight, each (B,)."""
    near = (wrap(angle[:, :, None] - angle[:, None]).abs() < TOGETHER_RAD).double()
    total = (near * weight[:, None]).sum(dim=2) * (weight > 0.0)
    best = total.argmax(dim=1, keepdim=True)
    mode = angle.gather(1, best)
    member = near.gather(1, best[..., None].expand(-1, 1, near.shape[2]))[:, 0] * weight
    member = member.clamp_min(1e-30)
    for _ in range(5):
        missed = wrap(angle - mode)
        robust = member / (1.0 + (missed / SCALE_RAD).square())
        mode = mode + (robust * missed).sum(dim=1, keepdim=True) / robust.sum(dim=1, keepdim=True)
    square = (robust * wrap(angle - mode).square()).sum(dim=1) / robust.sum(dim=1)
    return mode[:, 0], (square + FLOOR_RAD**2).sqrt(), total.gather(1, best)[:, 0]


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
