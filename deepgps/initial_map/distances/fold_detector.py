"""Two measures of whether a learned map is folded onto itself; neither uses the ground truth.

Segments are straight, so the predicted ends of a segment must be as far apart as the distance travelled: a fold bends
the segments that cross it. And places predicted next to each other must look alike: a fold overlays different places.
"""

from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import KDTree

from deepgps.data.segments import Segments, find_owners

SAMPLES = 2000
NEIGHBOURS = 32
NEAR_M = 0.1
LOOK_M = 0.3
LENGTH_ERROR_LIMIT, OVERLAP_LIMIT = 0.04, 0.02
"""A map counts as folded if it exceeds either of these."""


@dataclass(frozen=True)
class FoldScore:
    """How far a map is folded: two fractions, each between 0 (not at all) and 1.

    Attributes:
        length_error_fraction: Of the distance travelled, the part on segments whose predicted ends are too close or too
            far apart.
        overlap_fraction: Of the observations with neighbours on the map from other segments, the part that look unlike
            those neighbours.
    """

    length_error_fraction: float
    overlap_fraction: float

    @property
    def worst(self) -> float:
        """The larger fraction in units of its limit."""
        return max(self.length_error_fraction / LENGTH_ERROR_LIMIT, self.overlap_fraction / OVERLAP_LIMIT)

    @property
    def folded(self) -> bool:
        """Whether the map counts as folded."""
        return self.worst > 1.0


def score_folding(
    positions: np.ndarray, features: torch.Tensor, segments: Segments, generator: torch.Generator
) -> FoldScore:
    """Measure how far a map is folded.

    Args:
        positions: Predictions of the training observations (N, 2) [m].
        features: Heading-invariant features of the same (N, K).
        segments: Weak constraints.
        generator: Draws the observations that are examined.
    """
    return FoldScore(
        measure_length_error(positions, segments), measure_overlap(positions, features, segments, generator)
    )


def measure_length_error(positions: np.ndarray, segments: Segments) -> float:
    """Part of the distance travelled on segments whose mapped length is wrong by more than 0.1 m plus a tenth."""
    rows = torch.arange(len(segments.count))
    last = segments.count - 1
    driven = segments.distance[rows, last].numpy()
    ends = positions[segments.index[rows, last].numpy()] - positions[segments.index[:, 0].numpy()]
    wrong = np.abs(np.linalg.norm(ends, axis=1) - driven)
    return float(driven[wrong > 0.1 + 0.1 * driven].sum() / max(driven.sum(), 1e-9))


def measure_overlap(
    positions: np.ndarray, features: torch.Tensor, segments: Segments, generator: torch.Generator
) -> float:
    """Part of the observations that look unlike a quarter or more of their neighbours on the map, within ``NEAR_M``.

    Only neighbours on other segments count; unknown positions (NaN) are left out. Two observations look unlike each
    other if their features differ by more than 1.5 times the 0.9 quantile of the differences between readings
    ``LOOK_M`` apart on one segment.
    """
    owner = find_owners(segments, len(positions))[1].numpy()
    known = np.flatnonzero((owner >= 0) & np.isfinite(positions).all(axis=1))
    chosen = known[torch.randperm(len(known), generator=generator)[:SAMPLES].numpy()]
    apart, found = KDTree(positions[known]).query(positions[chosen], k=min(NEIGHBOURS, len(known)))
    other = known[found]
    near = (apart < NEAR_M) & (owner[other] != owner[chosen][:, None])
    unlike = (features[chosen][:, None] - features[other]).norm(dim=2).numpy() > 1.5 * _usual_difference(
        features, segments
    )
    some = near.any(axis=1)
    share = (unlike & near).sum(axis=1)[some] / near.sum(axis=1)[some]
    return float((share >= 0.25).mean()) if len(share) else 0.0


def _usual_difference(features: torch.Tensor, segments: Segments) -> float:
    found = [torch.zeros(0)]
    for row, count in enumerate(segments.count.tolist()):
        way = segments.distance[row, :count].numpy()
        partner = np.searchsorted(way, way + LOOK_M)
        there = partner < count
        index = segments.index[row]
        found.append((features[index[:count][there]] - features[index[partner[there]]]).norm(dim=1))
    joined = torch.cat(found).numpy()
    return float(np.quantile(joined, 0.9)) if len(joined) else float("inf")
