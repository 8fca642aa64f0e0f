"""Weak constraints from a recording: what lies on one straight segment, and how far along it. Never the truth."""

from dataclasses import dataclass, replace

import numpy as np
import torch

from deepgps.data.dead_reckoning import travel
from sim.errors import InputError
from sim.recording.format import Recording

MOST_FITTED = 16_000
"""Observations that features, initial map and fold detector use, at most: all of them are compared with one another, so
memory and time grow with the square."""
GOLDEN = (5.0**0.5 - 1.0) / 2.0


@dataclass(frozen=True)
class Segments:
    """Straight segments, padded to the longest; positions past ``count`` are zero and mean nothing.

    Attributes:
        index: Observations in the order driven (L, longest) int64.
        distance: Distance of each from the segment's first reading, by encoder (L, longest) [m].
        count: Readings of each segment (L,) int64, at least 2.
        skipped: Segments left out because fewer than two readings arrived.
        weight: How much each is believed (L,), from 0 to 1; None: all alike.
        variance: Expected squared error of each distance that grows with the way (L, longest) [m^2]; None: not asked.
        rounding_m2: The same of any distance between two readings that does not [m^2].
    """

    index: torch.Tensor
    distance: torch.Tensor
    count: torch.Tensor
    skipped: int
    weight: torch.Tensor | None = None
    variance: torch.Tensor | None = None
    rounding_m2: float = 0.0

    @property
    def valid(self) -> torch.Tensor:
        """Which places hold a reading (L, longest) bool."""
        return torch.arange(self.index.shape[1], device=self.index.device) < self.count[:, None]

    def to(self, device: torch.device) -> "Segments":
        """The same on a device."""
        tensors = {name: value.to(device) for name, value in vars(self).items() if isinstance(value, torch.Tensor)}
        return replace(self, **tensors)

    def take(self, rows: torch.Tensor) -> "Segments":
        """Some of the segments (n,) int64, with their observations numbered as before."""
        tensors = {name: value[rows] for name, value in vars(self).items() if isinstance(value, torch.Tensor)}
        return replace(self, **tensors)


def read_segments(recording: Recording) -> Segments:
    """Straight segments of a recording: runs of readings with one segment number.

    A distance is ``2 pi r / ticks_per_rev`` times the mean of the left and right ticks since the first reading.

    Raises:
        InputError: No segment has two readings, no wheel turned, or the odometry constants are missing.
    """
    travelled = travel(recording.reading[:, 2:], recording.manifest.odometry).mean(axis=1)
    runs = find_runs(recording)
    kept = [run for run in runs if len(run) >= 2]
    if not kept:
        raise InputError(f"{recording.folder}: no segment has two readings, so there is no distance to learn from")
    longest = max(len(run) for run in kept)
    index = np.zeros((len(kept), longest), np.int64)
    distance = np.zeros((len(kept), longest), np.float64)
    for row, run in enumerate(kept):
        index[row, : len(run)] = recording.reading[run, 1]
        distance[row, : len(run)] = np.abs(travelled[run] - travelled[run[0]])
    if not distance.any():
        raise InputError(f"{recording.folder}: no wheel turned on any segment, so there is no distance to learn from")
    return Segments(
        index=torch.from_numpy(index),
        distance=torch.from_numpy(distance.astype(np.float32)),
        count=torch.tensor([len(run) for run in kept]),
        skipped=len(runs) - len(kept),
    )


def find_runs(recording: Recording) -> list[np.ndarray]:
    """The readings (n,) of each segment in the order driven; of those with at least two, ``Segments`` has a row."""
    number = recording.reading[:, 0]
    return np.split(np.arange(len(number)), np.flatnonzero(np.diff(number)) + 1)


def subsample(segments: Segments, observations: int, most: int = MOST_FITTED) -> tuple[Segments, torch.Tensor]:
    """Whole segments spread evenly over a drive; all of them where the recording is no longer than ``most``.

    Args:
        segments: All segments.
        observations: How many the recording has.
        most: How many may be left.

    Returns:
        The segments kept, their observations numbered anew, and which observation each of these is (n,) int64.
    """
    if observations <= most:
        return segments, torch.arange(observations)
    # Multiples of the golden section, modulo 1, fill it evenly: so do the segments whose multiple is small.
    key = torch.arange(len(segments.count), dtype=torch.float64) * GOLDEN % 1.0
    order = key.argsort()
    rows = order[segments.count[order].cumsum(0) <= most].sort().values
    kept = segments.take(rows)
    chosen = kept.index[kept.valid].unique()
    return replace(kept, index=torch.searchsorted(chosen, kept.index) * kept.valid), chosen


def find_owners(segments: Segments, observations: int) -> tuple[torch.Tensor, torch.Tensor]:
    """First and last segment on which each observation lies (N,), (N,); a turning place lies on two. -1: on none."""
    first, last = torch.full((observations,), -1), torch.full((observations,), -1)
    for row, count in enumerate(segments.count.tolist()):
        index = segments.index[row, :count]
        last[index] = row
        first[index] = torch.where(first[index] < 0, row, first[index])
    return first, last
