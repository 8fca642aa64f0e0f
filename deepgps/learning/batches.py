"""Batches for one training step: observations with target positions, or segments with distances."""

from collections.abc import Callable
from dataclasses import dataclass

import torch

from deepgps.config.learning import TrainSettings
from deepgps.data.segments import Segments


@dataclass(frozen=True)
class Batch:
    """The data of one training step."""

    index: torch.Tensor  # Observations (B,) or, segment by segment, (S, m)
    target: torch.Tensor  # Positions (B, 2) [m], or distances along the segment (S, m) [m]
    valid: torch.Tensor  # Which entries exist, in the shape of ``index``


class Inputs:
    """Observations as the network takes them, on one device.

    Features (N, K), whose root mean square is 1, stay as they are, or get noise of this standard deviation if a
    generator is given. Of features at several headings (N, H, K), the first heading is taken, or, if a generator is
    given, a random one, with noise. Polar images (N, rings, sectors, 3) uint8 become (N, 3, rings, sectors) float32; if
    a generator is given and they are to ``shift``, each by a random number of sectors (paper section III-B2).
    """

    def __init__(self, table: torch.Tensor, noise: float = 0.0, shift: bool = True) -> None:
        self.table, self.noise, self.shift = table, noise, shift

    def take(self, index: torch.Tensor | slice, generator: torch.Generator | None = None) -> torch.Tensor:
        """Network input of observations (B,)."""
        chosen = self.table[index]
        if chosen.ndim == 3:
            rows, heading = torch.arange(len(chosen), device=chosen.device), 0
            if generator is not None:
                heading = torch.randint(chosen.shape[1], rows.shape, generator=generator, device=chosen.device)
            chosen = chosen[rows, heading]
        if chosen.ndim == 2:
            if generator is None or self.noise == 0.0:
                return chosen
            return chosen + self.noise * torch.randn(chosen.shape, generator=generator, device=chosen.device)
        if generator is not None and self.shift:
            sectors = chosen.shape[2]
            shift = torch.randint(sectors, (len(chosen), 1), generator=generator, device=chosen.device)
            column = (torch.arange(sectors, device=chosen.device) + shift) % sectors
            column = column[:, None, :, None].expand(-1, chosen.shape[1], -1, chosen.shape[3])
            chosen = chosen.gather(2, column)
        return chosen.permute(0, 3, 1, 2).float() / 255.0

    def __len__(self) -> int:
        return len(self.table)


Draw = Callable[[torch.Generator, float], Batch]  # (generator, fraction of the steps done) -> batch of one step
Loss = Callable[[torch.Tensor, Batch, torch.Tensor], torch.Tensor]
"""(predictions shaped like the batch's index plus outputs, batch, fraction of the steps done (0-dim)) -> scalar."""


def sample_from(segments: Segments, settings: TrainSettings) -> Draw:
    """Return a function that draws batches of segments, on the segments' device."""
    return lambda generator, done: sample_batch(segments, settings.segments, settings.samples, generator)


def sample_batch(segments: Segments, count: int, samples: int, generator: torch.Generator) -> Batch:
    """Draw ``count`` segments in proportion to their readings, and up to ``samples`` readings of each."""
    row = torch.multinomial(segments.count.float(), count, replacement=True, generator=generator)
    valid = torch.arange(segments.index.shape[1], device=row.device) < segments.count[row, None]
    key = torch.rand(valid.shape, generator=generator, device=valid.device)
    place = key.masked_fill(~valid, 2.0).argsort(dim=1)[:, :samples]
    valid = valid.gather(1, place)
    place = place % segments.count[row, None]  # what fills short segments is theirs: batch normalisation sees it
    return Batch(segments.index[row].gather(1, place), segments.distance[row].gather(1, place), valid)
