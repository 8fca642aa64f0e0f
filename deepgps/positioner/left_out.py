"""What would be known of training images if their own segments had not been driven: a threshold without the truth.

Images of the same segment are trivially alike. So segments are left out in turn, and their images compared with a table
of the others. Where the drive was short, many of these are novel, but then their places are not known either: positions
interpolated between the most alike images of the table are far from those of the map. Such a novelty is not accepted.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.interpolate import RBFInterpolator
from scipy.optimize import minimize
from scipy.special import logit

from deepgps.data.segments import Segments, find_owners, spread_evenly
from deepgps.positioner.confidence import Confidence
from deepgps.positioner.confidence_table import make_table

REFUSED = 0.02
"""Share of the training images that would be refused if their segments had not been driven."""
FAR_M, SELDOM = 0.25, 0.1
"""An image that would be off by more than this [m] with more than this probability is refused as well."""
FOLDS, RIDGE = 20, 1e-6
INTERPOLATED, AROUND, SMOOTHING = 2000, 64, 1e-3
"""Images whose positions are interpolated, entries most alike that are used for each, and the ridge of the fit."""


class LeftOut(NamedTuple):
    """What is known of M training images without their own segments.

    Attributes:
        novelty: Their novelty at the position that the method predicts (M,) [m].
        guessed: Novelty of those that are interpolated, at the interpolated position (I,) [m].
        error: Distance between interpolated and predicted position (I,) [m].
    """

    novelty: np.ndarray
    guessed: np.ndarray
    error: np.ndarray


def leave_segments_out(segments: Segments, features: np.ndarray, positions: np.ndarray) -> LeftOut | None:
    """Compare images with tables without the segments of their fold; None where no segment has others beside it.

    Args:
        segments: Segments of the drive.
        features: Features of its images (N, K).
        positions: Positions that the method predicts for them (N, 2) [m].
    """
    novelty, guessed, error, std = [], [], [], np.zeros(len(positions))
    chosen = spread_evenly(len(positions)).numpy() < INTERPOLATED / max(1, len(positions))
    for inside, others in _split(segments, len(positions)):
        table = make_table(features, positions, std, others)
        novelty.append(table.measure(features[inside], positions[inside])[0])
        some = inside[chosen[inside]]
        place = interpolate(table, features[some])
        guessed.append(table.measure(features[some], place)[0])
        error.append(np.linalg.norm(place - positions[some], axis=1))
    return LeftOut(*(np.concatenate(part) for part in (novelty, guessed, error))) if novelty else None


def interpolate(table: Confidence, features: np.ndarray) -> np.ndarray:
    """Positions (B, 2) [m] of images with these features (B, at least K): a spline through the entries most alike."""
    known = table.features * table.scale
    if not len(features) or not np.ptp(known, axis=0).any():
        return np.tile(table.place.mean(axis=0, dtype=float), (len(features), 1))
    spline = RBFInterpolator(known, table.place, neighbors=AROUND, smoothing=SMOOTHING, kernel="linear")
    return spline(features[:, : len(table.scale)])


def set_threshold(table: Confidence, left_out: LeftOut) -> Confidence:
    """The table that accepts a novelty [m] that most images of the drive have, and at which a position is seldom far
    off.
    """
    usual = float(np.quantile(left_out.novelty, 1.0 - REFUSED, method="higher"))
    threshold = min(usual, find_crossing(left_out.guessed, left_out.error > FAR_M, SELDOM))
    refused = float(np.mean(left_out.novelty > threshold))
    return replace(table, threshold_m=threshold, usual_m=usual, refused=refused)


def find_crossing(novelty: np.ndarray, far: np.ndarray, probability: float) -> float:
    """Novelty [m] at which a position is far off with a probability.

    Infinite where none is; where novelty tells nothing, infinite or zero, by the share of all that is far off.

    Logistic regression of ``far`` (n,) bool on the logarithm of the novelty (n,) [m]; its penalty, ``RIDGE``, matters
    only where a novelty separates the two completely.
    """
    known = novelty > 0.0
    novelty, far = novelty[known], far[known]
    if not far.any():
        return np.inf
    usual = np.inf if far.mean() <= probability else 0.0
    scale = float(np.median(novelty))
    line = np.column_stack([np.ones(len(novelty)), np.log(novelty / scale)])
    sign = np.where(far, -1.0, 1.0)

    def cost(weight: np.ndarray) -> float:
        return float(np.logaddexp(0.0, sign * (line @ weight)).mean() + RIDGE * weight @ weight)

    offset, growth = minimize(cost, np.array([0.0, 1.0])).x
    return float(scale * np.exp((logit(probability) - offset) / growth)) if growth > 0.0 else usual


def _split(segments: Segments, observations: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Of each fold, its observations and those that are on none of its segments."""
    first, last = (owner.numpy() for owner in find_owners(segments, observations))
    fold = np.append((spread_evenly(len(segments.count)) * FOLDS).long().numpy(), -1)
    for number in range(FOLDS):
        others = (first >= 0) & (fold[first] != number) & (fold[last] != number)
        inside = fold[first] == number
        if inside.any() and others.any():
            yield np.flatnonzero(inside), np.flatnonzero(others)
