"""Weak constraints from a recording: straight segments, the distances along them, and the path by dead reckoning.

The ground truth is not used.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch

from sim.errors import InputError
from sim.recording.format import Recording
from sim.sensors.encoder import check_odometry, count_from_first, ticks_to_distance


def travel(ticks: np.ndarray, constants: Mapping[str, Any]) -> np.ndarray:
    """Distance travelled by each wheel [m] from its cumulative ticks, both (R, 2); only differences are meaningful."""
    odometry = check_odometry(constants)
    return ticks_to_distance(count_from_first(ticks), odometry["wheel_radius_m"], odometry["ticks_per_rev"])


def dead_reckon(recording: Recording) -> np.ndarray:
    """Dead-reckoned pose at each reading (R, 3): x, y [m], yaw [rad], starting at (0, 0, 0).

    In each step the robot turns by the difference of the wheels' distances over the track, and drives their mean along
    the mean heading. Between segments it first backs off from what it touched and then turns in place.
    """
    distance = np.diff(travel(recording.reading[:, 2:], recording.manifest.odometry), axis=0)
    turn = (distance[:, 1] - distance[:, 0]) / check_odometry(recording.manifest.odometry)["track_m"]
    yaw = np.concatenate([[0.0], np.cumsum(turn)])
    heading = yaw[:-1] + turn / 2.0
    between = np.diff(recording.reading[:, 0]) != 0
    heading = np.where(between, yaw[:-1], heading)
    step = distance.mean(axis=1)[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    place = np.concatenate([np.zeros((1, 2)), np.cumsum(step, axis=0)])
    return np.concatenate([place, yaw[:, None]], axis=1)


def find_starts(segment: np.ndarray) -> np.ndarray:
    """Index of the first reading of each reading's segment (R,), for segments (R,) in the order driven."""
    first = np.flatnonzero(np.r_[True, segment[1:] != segment[:-1]])
    return np.repeat(first, np.diff(np.r_[first, len(segment)]))


def find_lasts(start: np.ndarray) -> np.ndarray:
    """Index of the last reading of each segment (S,), from the result of ``find_starts`` (R,)."""
    return np.flatnonzero(np.r_[start[1:] != start[:-1], True])


def find_stretches(mask: np.ndarray) -> np.ndarray:
    """First and last index of each stretch (n, 2) in which a mask (N,) is true."""
    edge = np.diff(np.r_[0, mask.astype(int), 0])
    return np.stack([np.flatnonzero(edge > 0), np.flatnonzero(edge < 0) - 1], axis=1)


def fill_stretches(stretches: Sequence[Sequence[int]], size: int) -> np.ndarray:
    """The mask (size,) that is true in these stretches alone, as ``find_stretches`` gives them."""
    mask = np.zeros(size, bool)
    for first, last in stretches:
        mask[first : last + 1] = True
    return mask


MAX_FITTED = 16_000
"""Most observations on which features are fitted, for which a sample is as good, and of which the initial map by
distances alone is made, which was not tried with more. The map by compass is of all observations."""
GOLDEN_RATIO = (5.0**0.5 - 1.0) / 2.0
HELD_OUT_SHARE, MIN_SEGMENTS = 0.04, 50
"""Share of the segments that no network learns from, since they show its errors; of few segments it learns from all."""
MIN_DISTANCE_M = 0.001
"""Shortest plausible spacing or length [m]; coarse encoders, or those that stick, may count nothing."""


@dataclass(frozen=True)
class Segments:
    """Straight segments, padded to the longest; entries past ``count`` are zero and have no meaning."""

    index: torch.Tensor  # Observations in the order driven (L, longest) int64
    # Distance of each from the segment's first reading, by encoder (L, longest) [m]. Those that an initial map has
    # corrected begin elsewhere: only their differences have a meaning
    distance: torch.Tensor
    count: torch.Tensor  # Readings of each segment (L,) int64, at least 2
    skipped: int  # Segments left out because fewer than two readings arrived
    doubted: torch.Tensor | None = None  # Segments on which the two wheels disagree (L,) bool; None: none
    # Part of each distance's expected squared error that grows with it (L, longest) [m^2]; None: unknown
    variance: torch.Tensor | None = None
    rounding_m2: float = 0.0  # Constant part of the expected squared error of a distance between two readings [m^2]
    held_out: torch.Tensor | None = None  # Segments that no network learns from (L,) bool; None: none

    @property
    def learned(self) -> "Segments":
        """The segments that networks learn from."""
        return self if self.held_out is None else self.take((~self.held_out).nonzero()[:, 0])

    @property
    def valid(self) -> torch.Tensor:
        """Mask (L, longest) bool of the entries that hold a reading."""
        return torch.arange(self.index.shape[1], device=self.index.device) < self.count[:, None]

    def to(self, device: torch.device) -> "Segments":
        """Return the segments on a device."""
        tensors = {name: value.to(device) for name, value in vars(self).items() if isinstance(value, torch.Tensor)}
        return replace(self, **tensors)

    def take(self, rows: torch.Tensor) -> "Segments":
        """Return the segments ``rows`` (n,) int64, with their observations numbered as before."""
        tensors = {name: value[rows] for name, value in vars(self).items() if isinstance(value, torch.Tensor)}
        return replace(self, **tensors)

    def through(self, observations: torch.Tensor) -> "Segments":
        """Return the segments through any of the observations marked (N,) bool."""
        return self.take((observations[self.index] & self.valid).any(dim=1).nonzero()[:, 0])


def read_segments(recording: Recording) -> Segments:
    """Read the straight segments of a recording: runs of readings with the same segment number.

    A distance is ``2 pi r / ticks_per_rev`` times the mean of the left and right ticks since the first reading. Raises
    InputError if no segment has two readings, no wheel turned, or the odometry constants are missing.
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
        held_out=spread_evenly(len(kept)) < HELD_OUT_SHARE if len(kept) >= MIN_SEGMENTS else None,
    )


def spread_evenly(count: int) -> torch.Tensor:
    """Numbers (count,) from 0 to 1: those in any interval belong to segments spread evenly over the drive.

    Multiples of the golden section, modulo 1, fill it evenly.
    """
    return torch.arange(count, dtype=torch.float64) * GOLDEN_RATIO % 1.0


def find_held_out(segments: Segments, observations: int) -> torch.Tensor:
    """Mask (N,) bool of the observations that are only on segments held out; nothing is learned from these."""
    if segments.held_out is None:
        return torch.zeros(observations, dtype=torch.bool)
    first, last = find_owners(segments, observations)
    return (first >= 0) & segments.held_out[first] & segments.held_out[last]


def leave_held_out(
    index: torch.Tensor, places: torch.Tensor, segments: Segments, observations: int
) -> tuple[torch.Tensor, torch.Tensor]:
    """The labelled observations (n,) and their positions (n, 2) [m] that are not held out from learning.

    Raises InputError if none is left.
    """
    learned = ~find_held_out(segments, observations)[index]
    if not learned.any():
        raise InputError("only segments that are held out have labels, so there is nothing to learn from")
    return index[learned], places[learned]


def find_runs(recording: Recording) -> list[np.ndarray]:
    """Readings (n,) of each segment in the order driven; ``Segments`` has a row for each with at least two."""
    number = recording.reading[:, 0]
    return np.split(np.arange(len(number)), np.flatnonzero(np.diff(number)) + 1)


def subsample(segments: Segments, observations: int, most: int = MAX_FITTED) -> tuple[Segments, torch.Tensor]:
    """Choose complete segments spread evenly over a drive; all if there are at most ``most`` observations.

    Their observations are renumbered; the original numbers of these (n,) int64 are returned too.
    """
    if observations <= most:
        return segments, torch.arange(observations)
    order = spread_evenly(len(segments.count)).argsort()
    rows = order[segments.count[order].cumsum(0) <= most].sort().values
    if not len(rows):
        raise InputError(
            f"a segment has {int(segments.count[order[0]])} readings, more than the {most} that are fitted at once: "
            "are straight segments numbered one by one?"
        )
    return renumber(segments.take(rows))


def subsample_learned(segments: Segments, observations: int) -> tuple[Segments, torch.Tensor]:
    """Like ``subsample``, without the segments held out: these stay as new as the images of another drive."""
    if segments.held_out is None:
        return subsample(segments, observations)
    learned, known = renumber(segments.learned)
    kept, chosen = subsample(learned, len(known))
    return kept, known[chosen]


def renumber(segments: Segments) -> tuple[Segments, torch.Tensor]:
    """The segments with their observations numbered from zero, and the original numbers of these (n,) int64."""
    chosen = segments.index[segments.valid].unique()
    return replace(segments, index=torch.searchsorted(chosen, segments.index) * segments.valid), chosen


def measure_spacing(gap: np.ndarray) -> float:
    """Median of the gaps (n,) between consecutive readings [m], without those in which encoders count nothing."""
    moved = gap[gap > 0.0]
    return float(np.median(moved)) if len(moved) else MIN_DISTANCE_M


def find_owners(segments: Segments, observations: int) -> tuple[torch.Tensor, torch.Tensor]:
    """First and last segment of each observation (N,), (N,); a turning place is on two segments. -1: on none."""
    first, last = torch.full((observations,), -1), torch.full((observations,), -1)
    for row, count in enumerate(segments.count.tolist()):
        index = segments.index[row, :count]
        last[index] = row
        first[index] = torch.where(first[index] < 0, row, first[index])
    return first, last
