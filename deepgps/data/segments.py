"""Weak constraints from a recording: what lies on one straight segment, and how far along it. Never the truth."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch

from deepgps.learning.trainer import Batch
from sim.errors import InputError
from sim.recording.format import Recording
from sim.sensors.encoder import count_from_first, read_odometry, ticks_to_distance

MOST_FITTED = 16_000
"""Observations that features, a first map and the search for folds look at, at most: there everything meets everything,
so that a longer recording would cost memory and time without end."""
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
    travelled = travel(recording.reading[:, 2:], recording.manifest).mean(axis=1)
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


def spread(segments: Segments, observations: int, most: int = MOST_FITTED) -> tuple[Segments, torch.Tensor]:
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


def travel(ticks: np.ndarray, manifest: Mapping[str, Any]) -> np.ndarray:
    """Way of each wheel [m] from its cumulative ticks, both (R, 2); only differences of ways mean anything."""
    odometry = read_odometry(manifest)
    return ticks_to_distance(count_from_first(ticks), odometry["wheel_radius_m"], int(odometry["ticks_per_rev"]))


def dead_reckon(recording: Recording) -> np.ndarray:
    """Path by encoders alone: pose at each reading (R, 3): x, y [m], yaw [rad], from (0, 0, 0).

    Each step turns by the difference of the wheels' ways over the track and drives their mean along the mean heading;
    between segments the robot backs off what it touched first, and then turns in place.
    """
    way = np.diff(travel(recording.reading[:, 2:], recording.manifest), axis=0)
    turn = (way[:, 1] - way[:, 0]) / read_odometry(recording.manifest)["track_m"]
    yaw = np.concatenate([[0.0], np.cumsum(turn)])
    heading = yaw[:-1] + turn / 2.0
    between = np.diff(recording.reading[:, 0]) != 0
    heading = np.where(between, yaw[:-1], heading)
    step = way.mean(axis=1)[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    place = np.concatenate([np.zeros((1, 2)), np.cumsum(step, axis=0)])
    return np.concatenate([place, yaw[:, None]], axis=1)


def draw(segments: Segments, count: int, samples: int, generator: torch.Generator) -> Batch:
    """Draw ``count`` segments, readings as often as they are believed, and up to ``samples`` different ones of each."""
    often = segments.count.float() if segments.weight is None else segments.count * segments.weight
    row = torch.multinomial(often, count, replacement=True, generator=generator)
    valid = torch.arange(segments.index.shape[1], device=row.device) < segments.count[row, None]
    key = torch.rand(valid.shape, generator=generator, device=valid.device)
    place = key.masked_fill(~valid, 2.0).argsort(dim=1)[:, :samples]
    index, along = segments.index[row].gather(1, place), segments.distance[row].gather(1, place)
    variance = None if segments.variance is None else segments.variance[row].gather(1, place)
    return Batch(index, along, valid.gather(1, place), variance)


def find_owners(segments: Segments, observations: int) -> tuple[torch.Tensor, torch.Tensor]:
    """First and last segment on which each observation lies (N,), (N,); a turning place lies on two. -1: on none."""
    first, last = torch.full((observations,), -1), torch.full((observations,), -1)
    for row, count in enumerate(segments.count.tolist()):
        index = segments.index[row, :count]
        last[index] = row
        first[index] = torch.where(first[index] < 0, row, first[index])
    return first, last
