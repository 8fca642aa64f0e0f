"""Makes a trained method's table of confidence, and calibrates it without the truth.

The threshold comes from images whose segments are left out. The radii come from segments that the network has not
learned from; where a drive is too short for these, from positions interpolated without an image's own segment, among
the images that are accepted.

How far predictions are off shows at segments: each one held out is a straight bar of known length.

Images of the same segment are trivially alike. So, for the threshold, segments are left out in turn, and their images
compared with a table of the others. Where the drive was short, many of these are novel, but then their places are not
known either: positions interpolated between the most alike images of the table are far from those of the map. Such a
novelty is not accepted.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.interpolate import RBFInterpolator
from scipy.optimize import linprog, minimize
from scipy.spatial.distance import pdist
from scipy.special import logit

from deepgps.data.segments import Segments, find_held_out, find_owners, spread_evenly
from deepgps.positioner.confidence import GROWTH, LEVELS, Confidence, make_table

MIN_SPREAD_RATIO = 0.67  # Of distances across bars over those along them; below, encoders err more than the network
MIN_READINGS = 4  # Readings that make a bar
ROBUST_SCALE, MAX_FITS, CONVERGENCE_M = 3.5, 50, 1e-6
"""Residual that weighs a quarter, as a multiple of the median; steps of a fit, and the change at which it ends."""


def measure_bars(segments: Segments, positions: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Distance of predictions (N, 2) from their held-out segment as a bar with known spacing (N,) [m]; NaN: unknown.

    Only predictions that are ``chosen`` (N,) count. Place, heading and length of a bar, four unknowns, are fitted to 2
    n coordinates, which hides a part of the error: the root of (2 n - 4) / 2 n is divided out. All bars may be bent
    alike, as those of a robot that curves. Both fits are robust, since a few images far off would spoil the errors of
    their whole bar. Distances along a bar contain the encoders' errors too; where they are clearly larger than those
    across, they are scaled to these.
    """
    error = np.full(len(positions), np.nan)
    bars = list(_fit_bars(segments, positions, chosen))
    if not bars:
        return error
    index = np.concatenate([bar.index for bar in bars])
    along, across, bow, hidden = (np.concatenate(part) for part in zip(*(bar[1:] for bar in bars), strict=True))
    (across,) = find_residuals(bow[:, None], across)
    usual = np.median(np.abs(across)) / max(np.median(np.abs(along)), 1e-12)
    error[index] = np.hypot(along * (usual if usual < MIN_SPREAD_RATIO else 1.0), across) / hidden
    return error


def find_residuals(design: np.ndarray, values: np.ndarray, *others: np.ndarray) -> list[np.ndarray]:
    """Residuals (n,) [m] of a linear fit, and of ``others`` with the same weights; values far off hardly count.

    Iteratively reweighted least squares of ``design`` (n, k) with Geman and McClure's cost.
    """
    weight, missed = np.ones(len(design)), np.zeros(len(design))
    for _ in range(MAX_FITS):
        root, before = np.sqrt(weight), missed
        fit = np.linalg.pinv(root[:, None] * design) * root
        missed = values - design @ (fit @ values)
        if np.allclose(missed, before, rtol=0.0, atol=CONVERGENCE_M):
            break
        weight = (1.0 + (missed / max(ROBUST_SCALE * np.median(np.abs(missed)), 1e-12)) ** 2) ** -2
    return [missed, *(other - design @ (fit @ other) for other in others)]


class _Bar(NamedTuple):
    """Observations of a bar (n,), how far they are from it along and across (n,) [m], the shape of a bar that is bent
    by one radian a metre (n,) [m], and the share of the error that the fit leaves (n,).
    """

    index: np.ndarray
    along: np.ndarray
    across: np.ndarray
    bow: np.ndarray
    hidden: np.ndarray


def _fit_bars(segments: Segments, positions: np.ndarray, chosen: np.ndarray) -> Iterator[_Bar]:
    held = [] if segments.held_out is None else segments.held_out.nonzero()[:, 0].tolist()
    for row in held:
        index, way = (part[row, : segments.count[row]].numpy() for part in (segments.index, segments.distance))
        index, way = index[chosen[index]], way[chosen[index]].astype(float)
        if len(index) < MIN_READINGS or not np.ptp(way):
            continue
        line = np.column_stack([np.ones(len(way)), way - way.mean()])
        direction = (np.linalg.pinv(line) @ positions[index])[1]
        ahead = direction / max(np.linalg.norm(direction), 1e-12)
        along, across = positions[index] @ ahead, positions[index] @ np.array([-ahead[1], ahead[0]])
        (along,) = find_residuals(line, along)
        across, bow = find_residuals(line, across, way**2 / 2.0)
        yield _Bar(index, along, across, bow, np.full(len(index), np.sqrt(1.0 - 2.0 / len(index))))


REFUSED_SHARE = 0.02  # Share of the training images that would be refused if their segments had not been driven
LARGE_ERROR_M, MAX_ERROR_PROBABILITY = 0.25, 0.1
"""An image that would be off by more than this [m] with more than this probability is refused as well."""
FOLDS, RIDGE = 20, 1e-6
INTERPOLATED_IMAGES, SIMILAR_ENTRIES, SMOOTHING_RIDGE = 2000, 64, 1e-3
"""Images whose positions are interpolated, entries most alike that are used for each, and the ridge of the fit."""


class LeftOut(NamedTuple):
    """What is known of M training images without their own segments."""

    novelty: np.ndarray  # Their novelty at the position that the method predicts (M,) [m]
    guessed: np.ndarray  # Novelty of those that are interpolated, at the interpolated position (I,) [m]
    error: np.ndarray  # Distance between interpolated and predicted position (I,) [m]


def leave_segments_out(segments: Segments, features: np.ndarray, positions: np.ndarray) -> LeftOut | None:
    """Compare images with tables without the segments of their fold; None where no segment has others beside it.

    Their features are (N, K), and the positions that the method predicts for them (N, 2) [m].
    """
    novelty, guessed, error, std = [], [], [], np.zeros(len(positions))
    chosen = spread_evenly(len(positions)).numpy() < INTERPOLATED_IMAGES / max(1, len(positions))
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
    spline = RBFInterpolator(known, table.place, neighbors=SIMILAR_ENTRIES, smoothing=SMOOTHING_RIDGE, kernel="linear")
    return spline(features[:, : len(table.scale)])


def set_threshold(table: Confidence, left_out: LeftOut) -> Confidence:
    """The table that accepts a novelty [m] that most images of the drive have, and at which a position is seldom far
    off.
    """
    usual = float(np.quantile(left_out.novelty, 1.0 - REFUSED_SHARE, method="higher"))
    threshold = min(usual, find_crossing(left_out.guessed, left_out.error > LARGE_ERROR_M, MAX_ERROR_PROBABILITY))
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


COMPARED_IMAGES = 500
MIN_ERRORS, MAX_ERRORS = 20, 4000  # Errors from which radii are calibrated; with fewer they stay unknown


def make_confidence(
    segments: Segments,
    features: np.ndarray,
    positions: np.ndarray,
    map_std: np.ndarray | None = None,
    undecided: np.ndarray | None = None,
) -> Confidence | None:
    """Make the table, its threshold and its radii; None where all images are of one segment, or nearly so.

    Images that may lie elsewhere come into no table, so that those like them are refused as new.

    Args:
        segments: Segments of the drive.
        features: Features of its images (N, K).
        positions: Positions that the method predicts for them (N, 2) [m].
        map_std: Standard deviation of the map at each of them, along one axis (N,) [m]; None: unknown.
        undecided: Images that may lie elsewhere on the map (N,) bool; None: none.
    """
    left_out = leave_segments_out(segments, features, positions)
    if left_out is None:
        return None
    held = find_held_out(segments, len(positions)).numpy()
    std = np.zeros(len(positions)) if map_std is None else np.nan_to_num(map_std)
    known = ~held if undecided is None or undecided[~held].all() else ~held & ~undecided
    table = set_threshold(make_table(features, positions, std, np.flatnonzero(known)), left_out)
    error = measure_bars(segments, positions, held)
    measured = np.isfinite(error)
    if measured.sum() >= MIN_ERRORS:
        return fit_radii(table, table.measure(features[measured], positions[measured])[0], error[measured])
    accepted = left_out.guessed <= table.threshold_m
    return fit_radii(table, left_out.guessed[accepted], left_out.error[accepted])


def fit_radii(table: Confidence, novelty: np.ndarray, error: np.ndarray) -> Confidence:
    """The table with radii that hold errors (n,) [m] of images with a novelty (n,) [m]; too few of them tell none."""
    if np.count_nonzero(novelty) < MIN_ERRORS:
        return table
    least = find_least_growth(table)
    slope = [fit_quantile(novelty, error, *one) for one in zip(LEVELS, least, strict=True)]
    return replace(table, slope=np.array(slope))


def find_least_growth(table: Confidence) -> np.ndarray:
    """Least b for each of ``LEVELS`` (2,) [m], since errors on the drive say little of places far from it.

    An image that is as unlike the entries as these are unlike one another could be anywhere on the map.
    """
    some = spread_evenly(len(table.place)).argsort()[:COMPARED_IMAGES].numpy()
    unlike = np.median(pdist(table.features[some] * table.scale)) * np.median(table.metres)
    return np.quantile(pdist(table.place[some]), LEVELS) / max(unlike, 1e-12) ** GROWTH


def fit_quantile(novelty: np.ndarray, error: np.ndarray, level: float, least: float = 0.0) -> tuple[float, float]:
    """a >= 0 and b >= ``least`` for which a share ``level`` of the errors (n,) is below ``a + b novelty^GROWTH``.

    Linear quantile regression (Koenker and Bassett 1978): the sum of ``level`` times errors above the line and of
    ``1 - level`` times those below it is smallest.
    """
    thin = slice(None, None, -(-len(error) // MAX_ERRORS))
    novelty, error = novelty[thin], error[thin]
    count, size = len(error), np.mean(novelty**GROWTH)  # of this size, so that both unknowns are of one order
    line = np.column_stack([np.ones(count), novelty**GROWTH / size])
    equal = sparse.hstack([line, sparse.eye(count), -sparse.eye(count)], "csc")
    cost = np.concatenate([[0.0, 0.0], np.full(count, level), np.full(count, 1.0 - level)])
    bounds = [(0.0, None), (least * size, None)] + 2 * count * [(0.0, None)]
    found = linprog(cost, A_eq=equal, b_eq=error, bounds=bounds, method="highs").x
    return float(found[0]), float(found[1] / size)
