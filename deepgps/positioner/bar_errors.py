"""How far predictions are off, without the truth: each segment held out is a straight bar of known length."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from deepgps.data.segments import Segments

CLEARLY = 0.67
"""Median distance across bars over that along them, below which the encoders err more than the network."""
LEAST_READINGS = 4
"""Readings that make a bar."""
FAR, MOST_FITS, PRECISE_M = 3.5, 50, 1e-6
"""Residual that weighs a quarter, as a multiple of the median; steps of a fit, and the change at which it ends."""


def measure_bars(segments: Segments, positions: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Distance of predictions from their segment as a bar with known spacing (N,) [m]; NaN where unknown.

    Place, heading and length of a bar, four unknowns, are fitted to 2 n coordinates, which hides a part of the error:
    the root of (2 n - 4) / 2 n is divided out. All bars may be bent alike, as those of a robot that curves. Both fits
    are robust, since a few images far off would spoil the errors of their whole bar. Distances along a bar contain the
    encoders' errors too; where they are clearly larger than those across, they are scaled to these.

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
    (across,) = find_residuals(bow[:, None], across)
    usual = np.median(np.abs(across)) / max(np.median(np.abs(along)), 1e-12)
    error[index] = np.hypot(along * (usual if usual < CLEARLY else 1.0), across) / hidden
    return error


def find_residuals(design: np.ndarray, values: np.ndarray, *others: np.ndarray) -> list[np.ndarray]:
    """Residuals (n,) of a linear fit in which values far off hardly count, and of others with the same weights.

    Iteratively reweighted least squares with Geman and McClure's cost.

    Args:
        design: Known factors of the coefficients (n, k).
        values: What is fitted (n,) [m].
        others: More values (n,).
    """
    weight, missed = np.ones(len(design)), np.zeros(len(design))
    for _ in range(MOST_FITS):
        root, before = np.sqrt(weight), missed
        fit = np.linalg.pinv(root[:, None] * design) * root
        missed = values - design @ (fit @ values)
        if np.allclose(missed, before, rtol=0.0, atol=PRECISE_M):
            break
        weight = (1.0 + (missed / max(FAR * np.median(np.abs(missed)), 1e-12)) ** 2) ** -2
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
        if len(index) < LEAST_READINGS or not np.ptp(way):
            continue
        line = np.column_stack([np.ones(len(way)), way - way.mean()])
        direction = (np.linalg.pinv(line) @ positions[index])[1]
        ahead = direction / max(np.linalg.norm(direction), 1e-12)
        along, across = positions[index] @ ahead, positions[index] @ np.array([-ahead[1], ahead[0]])
        (along,) = find_residuals(line, along)
        across, bow = find_residuals(line, across, way**2 / 2.0)
        yield _Bar(index, along, across, bow, np.full(len(index), np.sqrt(1.0 - 2.0 / len(index))))
