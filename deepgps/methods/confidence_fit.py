"""Makes a trained method's table of confidence, and calibrates it without the truth.

The threshold comes from novelties of training images against a table without their segments: images of the same
segment are trivially alike. The radii come from segments that the network has not learned from: each is a straight bar
of known length, and how far predictions are from such a bar is their error, but for the bar's own motion in the plane.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.optimize import linprog
from scipy.spatial import KDTree
from scipy.spatial.distance import pdist

from deepgps.data.segments import Segments, find_held_out, find_owners, spread_evenly
from deepgps.methods.confidence import CHUNK, GROWTH, LEVELS, NEAREST, Confidence
from deepgps.methods.heading_fit import thin_out
from deepgps.methods.headings import find_nearest

CELL_M = 0.05
"""The table has one image for each square of the map with sides of this length [m]."""
COMPONENTS = 64
"""Features that are compared, the slowest; more tell no more."""
REFUSED = 0.02
"""Share of the training images that would be refused if their segments had not been driven."""
FOLDS, COMPARED = 20, 500
CLEARLY = 0.67
"""Median distance across bars over that along them, below which the encoders err more than the network."""
LEAST_READINGS, LEAST_ERRORS, MOST_ERRORS = 4, 20, 4000
"""Readings that make a bar, and errors from which radii are calibrated; with fewer they stay unknown."""


def make_confidence(
    segments: Segments, features: np.ndarray, positions: np.ndarray, map_std: np.ndarray | None = None
) -> Confidence | None:
    """Make the table, its threshold and its radii; None where all images are of one segment, or nearly so.

    Args:
        segments: Segments of the drive.
        features: Features of its images (N, K).
        positions: Positions that the method predicts for them (N, 2) [m].
        map_std: Standard deviation of the map at each of them, along one axis (N,) [m]; None: unknown.
    """
    held = find_held_out(segments, len(positions)).numpy()
    std = np.zeros(len(positions)) if map_std is None else np.nan_to_num(map_std)
    apart = _leave_segments_out(segments, features, positions, std)
    if not len(apart):
        return None
    table = _make_table(features, positions, std, np.flatnonzero(~held))
    table = replace(table, threshold_m=float(np.quantile(apart, 1.0 - REFUSED, method="higher")))
    error = measure_bars(segments, positions, held)
    measured = np.isfinite(error)
    if measured.sum() < LEAST_ERRORS:
        return table
    novelty, _ = table.measure(features[measured], positions[measured])
    least = find_least_growth(table)
    slope = [fit_quantile(novelty, error[measured], *one) for one in zip(LEVELS, least, strict=True)]
    return replace(table, slope=np.array(slope))


def measure_bars(segments: Segments, positions: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Distance of predictions from their segment as a bar with known spacing (N,) [m]; NaN where unknown.

    Place, heading and length of a bar, four unknowns, are fitted to 2 n coordinates, which hides a part of the error:
    the root of (2 n - 4) / 2 n is divided out. All bars may be bent alike, as those of a robot that curves. Distances
    along a bar contain the encoders' errors too; where they are clearly larger than those across, they are scaled to
    these.

    Args:
        segments: The segments, of which those held out are measured.
        positions: Predictions (N, 2) [m].
        chosen: Predictions that count (N,) bool.
    """
    error = np.full(len(positions), np.nan)
    bars = list(_fit_bars(segments, positions, chosen))
    if not bars:
        return error
    index = np.concatenate([bar.index for bar in bars])
    along, across, bow, hidden = (np.concatenate(part) for part in zip(*(bar[1:] for bar in bars), strict=True))
    across = across - bow * (bow @ across) / max(bow @ bow, 1e-12)
    usual = np.median(np.abs(across)) / max(np.median(np.abs(along)), 1e-12)
    error[index] = np.hypot(along * (usual if usual < CLEARLY else 1.0), across) / hidden
    return error


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
        if len(index) < LEAST_READINGS or not np.ptp(way):
            continue
        way, place = way - way.mean(), positions[index] - positions[index].mean(axis=0)
        direction = way @ place / (way @ way)
        missed = place - np.outer(way, direction)
        ahead = direction / max(np.linalg.norm(direction), 1e-12)
        bow = way**2 / 2.0
        bow = bow - bow.mean() - way * (bow @ way) / (way @ way)
        hidden = np.full(len(index), np.sqrt(1.0 - 2.0 / len(index)))
        yield _Bar(index, missed @ ahead, missed @ np.array([-ahead[1], ahead[0]]), bow, hidden)


def find_least_growth(table: Confidence) -> np.ndarray:
    """Least b for each of ``LEVELS`` (2,) [m], since errors on the drive say little of places far from it.

    An image that is as unlike the entries as these are unlike one another could be anywhere on the map.
    """
    some = spread_evenly(len(table.place)).argsort()[:COMPARED].numpy()
    unlike = np.median(pdist(table.features[some] * table.scale)) * np.median(table.metres)
    return np.quantile(pdist(table.place[some]), LEVELS) / max(unlike, 1e-12) ** GROWTH


def fit_quantile(novelty: np.ndarray, error: np.ndarray, level: float, least: float = 0.0) -> tuple[float, float]:
    """a >= 0 and b >= ``least`` for which a share ``level`` of the errors (n,) is below ``a + b novelty^GROWTH``.

    Linear quantile regression (Koenker and Bassett 1978): the sum of ``level`` times errors above the line and of
    ``1 - level`` times those below it is smallest.
    """
    thin = slice(None, None, -(-len(error) // MOST_ERRORS))
    novelty, error = novelty[thin], error[thin]
    count, size = len(error), np.mean(novelty**GROWTH)  # of this size, so that both unknowns are of one order
    line = np.column_stack([np.ones(count), novelty**GROWTH / size])
    equal = sparse.hstack([line, sparse.eye(count), -sparse.eye(count)], "csc")
    cost = np.concatenate([[0.0, 0.0], np.full(count, level), np.full(count, 1.0 - level)])
    bounds = [(0.0, None), (least * size, None)] + 2 * count * [(0.0, None)]
    found = linprog(cost, A_eq=equal, b_eq=error, bounds=bounds, method="highs").x
    return float(found[0]), float(found[1] / size)


def _make_table(features: np.ndarray, positions: np.ndarray, std: np.ndarray, rows: np.ndarray) -> Confidence:
    """The table of the observations ``rows`` (n,), without threshold and radii."""
    entry = rows[thin_out(positions[rows], CELL_M)]
    known, place = features[entry, :COMPONENTS], positions[entry]
    scale = np.maximum(np.abs(known).max(axis=0), 1e-12).astype(np.float32) / np.float32(127.0)
    middle = np.linalg.norm(place - place.mean(axis=0), axis=1).max()
    return Confidence(
        features=np.rint(known / scale).astype(np.int8),
        scale=scale,
        place=place.astype(np.float32),
        metres=_convert(known, place),
        map_std=std[entry].astype(np.float32),
        threshold_m=np.inf,
        slope=np.full((len(LEVELS), 2), np.nan),
        reach_m=float(2.0 * middle),
    )


def _convert(known: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Median distance on the map over the distance in features (E,) [m], between each entry and those around it."""
    apart, around = find_nearest(KDTree(place), place, NEAREST)
    found = np.zeros(len(place), np.float32)
    for start in range(0, len(place), CHUNK):
        part = slice(start, start + CHUNK)
        unlike = np.linalg.norm(known[around[part]] - known[part, None], axis=2)
        other = (apart[part] > 0.0) & (unlike > 0.0)  # an entry is near itself
        ratio = np.divide(apart[part], unlike, out=np.full(unlike.shape, np.nan), where=other)
        seen = other.any(axis=1)
        found[part][seen] = np.nanmedian(ratio[seen], axis=1)
    return found


def _leave_segments_out(segments: Segments, features: np.ndarray, positions: np.ndarray, std: np.ndarray) -> np.ndarray:
    """Novelties of images, each against a table without the segments of its fold."""
    found = [np.empty(0)]
    for inside, others in _split(segments, len(positions)):
        table = _make_table(features, positions, std, others)
        found.append(table.measure(features[inside], positions[inside])[0])
    return np.concatenate(found)


def _split(segments: Segments, observations: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Of each fold, its observations and those that are on none of its segments."""
    first, last = (owner.numpy() for owner in find_owners(segments, observations))
    fold = np.append((spread_evenly(len(segments.count)) * FOLDS).long().numpy(), -1)
    for number in range(FOLDS):
        others = (first >= 0) & (fold[first] != number) & (fold[last] != number)
        inside = fold[first] == number
        if inside.any() and others.any():
            yield np.flatnonzero(inside), np.flatnonzero(others)
