"""Makes a trained method's table of confidence, and calibrates it without the truth.

The threshold comes from images whose segments are left out. The radii come from segments that the network has not
learned from; where a drive is too short for these, from positions interpolated without an image's own segment, among
the images that are accepted.
"""

from dataclasses import replace

import numpy as np
from scipy import sparse
from scipy.optimize import linprog
from scipy.spatial.distance import pdist

from deepgps.data.segments import Segments, find_held_out, spread_evenly
from deepgps.positioner.bar_errors import measure_bars
from deepgps.positioner.confidence import GROWTH, LEVELS, Confidence
from deepgps.positioner.confidence_table import make_table
from deepgps.positioner.left_out import leave_segments_out, set_threshold

COMPARED = 500
LEAST_ERRORS, MOST_ERRORS = 20, 4000
"""Errors from which radii are calibrated; with fewer they stay unknown."""


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
    if measured.sum() >= LEAST_ERRORS:
        return fit_radii(table, table.measure(features[measured], positions[measured])[0], error[measured])
    accepted = left_out.guessed <= table.threshold_m
    return fit_radii(table, left_out.guessed[accepted], left_out.error[accepted])


def fit_radii(table: Confidence, novelty: np.ndarray, error: np.ndarray) -> Confidence:
    """The table with radii that hold errors (n,) [m] of images with a novelty (n,) [m]; too few of them tell none."""
    if np.count_nonzero(novelty) < LEAST_ERRORS:
        return table
    least = find_least_growth(table)
    slope = [fit_quantile(novelty, error, *one) for one in zip(LEVELS, least, strict=True)]
    return replace(table, slope=np.array(slope))


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
