"""How far predictions are off, without the truth: each segment held out is a straight bar of known length."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from deepgps.data.segments import Segments

CLEARLY = 0.67
"""Median distance across bars over that along them, below which the encoders err more than the network."""
LEAST_READINGS = 4
"""Readings that make a bar."""


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
