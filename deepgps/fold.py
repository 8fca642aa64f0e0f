"""Does a learned map lie folded on itself? Three signs, none of which looks at the truth.

A segment was driven straight, so its predictions must lie as far apart as driven: a fold bends what crosses it. Places
predicted side by side must look alike: a fold puts different places on one another. Places that look alike must be
predicted side by side: a tear puts them apart.
"""

from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial.distance import cdist

from deepgps.data import Segments, find_owners
from deepgps.settings import FoldSettings

SAMPLES = 2000
NEAR_M = 0.3


@dataclass(frozen=True)
class Signs:
    """Signs of a fold, each a fraction between 0 (none) and 1.

    Attributes:
        bent: Of the way driven, the part on segments whose predicted ends lie too close or too far apart.
        doubled: Of the observations, the part whose neighbours on the map, from other segments, look unlike them.
        torn: Of the observations, the part whose most similar one from another segment is far off on the map.
    """

    bent: float
    doubled: float
    torn: float

    def folded(self, settings: FoldSettings) -> bool:
        """Whether the map counts as folded."""
        return self.worst(settings) > 1.0

    def worst(self, settings: FoldSettings) -> float:
        """The largest sign in units of its limit; a map counts as folded above 1."""
        return max(self.bent / settings.bent, self.doubled / settings.doubled, self.torn / settings.torn)


def find_signs(positions: np.ndarray, features: torch.Tensor, segments: Segments, generator: torch.Generator) -> Signs:
    """Measure the signs of a fold.

    Args:
        positions: Predictions of the training observations (N, 2) [m].
        features: Heading-invariant features of the same (N, K).
        segments: Weak constraints.
        generator: Chooses the observations looked at.
    """
    doubled, torn = _compare_looks(positions, features, segments, generator)
    return Signs(_measure_bent(positions, segments), doubled, torn)


def _measure_bent(positions: np.ndarray, segments: Segments) -> float:
    rows = torch.arange(len(segments.count))
    last = segments.count - 1
    driven = segments.distance[rows, last].numpy()
    ends = positions[segments.index[rows, last].numpy()] - positions[segments.index[:, 0].numpy()]
    wrong = np.abs(np.linalg.norm(ends, axis=1) - driven)
    return float(driven[wrong > 0.1 + 0.1 * driven].sum() / driven.sum())


def _compare_looks(
    positions: np.ndarray, features: torch.Tensor, segments: Segments, generator: torch.Generator
) -> tuple[float, float]:
    owner = find_owners(segments, len(positions))[1].numpy()
    known = np.flatnonzero(owner >= 0)
    chosen = known[torch.randperm(len(known), generator=generator)[:SAMPLES].numpy()]
    unlike = torch.cdist(features[chosen], features[known]).numpy()
    apart = cdist(positions[chosen], positions[known])
    foreign = owner[chosen][:, None] != owner[known]
    usual = _usual_difference(features, segments)
    # Places side by side on the map ...
    near = foreign & (apart < NEAR_M)
    some = near.any(axis=1)
    looks = np.ma.masked_array(unlike[some], np.logical_not(near[some]))
    doubled = np.ma.median(looks, axis=1) > 2.0 * usual
    # ... and places that look alike.
    twin = np.where(foreign, unlike, np.inf).argmin(axis=1)[:, None]
    alike = np.take_along_axis(unlike, twin, axis=1) < usual
    torn = alike & (np.take_along_axis(apart, twin, axis=1) > 2.0 * NEAR_M)
    return float(doubled.sum() / max(1, some.sum())), float(torn.sum() / max(1, alike.sum()))


def _usual_difference(features: torch.Tensor, segments: Segments) -> float:
    # How unlike two observations of one segment about NEAR_M apart are: the 90th percentile.
    found = []
    for row in range(len(segments.count)):
        count = int(segments.count[row])
        way = segments.distance[row, :count].numpy()
        partner = np.minimum(np.searchsorted(way, way + NEAR_M), count - 1)
        index = segments.index[row, :count]
        found.append((features[index] - features[index[partner]]).norm(dim=1)[partner < count - 1])
    joined = torch.cat(found)
    return float(joined.quantile(0.9)) if len(joined) else float("inf")
