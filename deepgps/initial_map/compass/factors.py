"""Registrations of training images on one another, as factors of a map by compass.

An image that is registered on those of other segments lies at ``sum_k weight_k x_k + offset``. Such a factor moves the
image and those from which it is predicted, as loop closures of WiFi maps do (Huang et al., "Efficient, Generalized
Indoor WiFi GraphSLAM", ICRA 2011).
"""

from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np

from deepgps.initial_map.compass.bars import CAMERA_UNKNOWNS, Bars, turn
from deepgps.initial_map.compass.closures import ROBUST_SCALE
from deepgps.initial_map.compass.least_squares import Equations, carry, rescale_by


@dataclass(frozen=True)
class Factors:
    """Registrations of m observations on k others each; in a fit, the numbers are of readings."""

    one: np.ndarray  # Numbers (m,)
    others: np.ndarray  # Numbers of those from which each is predicted (m, k)
    weight: np.ndarray  # Their weights, which add up to 1 (m, k)
    offset: np.ndarray  # Where each was registered, less the weighted mean of the others' places then (m, 2) [m]
    variance: np.ndarray  # Of where it was registered, along either axis (m,) [m^2]

    def take(self, rows: np.ndarray) -> Self:
        """Those with these numbers, or of a mask."""
        return type(self)(*(getattr(self, field.name)[rows] for field in fields(self)))

    def number(self, reading: np.ndarray) -> Self:
        """The factors between readings, of which each observation has one (N,); those without, -1, are left out."""
        one, others = reading[self.one], reading[self.others]
        return replace(self, one=one, others=others).take((one >= 0) & (others >= 0).all(axis=1))

    def compare(self, places: np.ndarray) -> np.ndarray:
        """Residuals (m, 2) [m] with all at these places (N, 2) [m]; or (m, 2, n), of samples (N, 2, n)."""
        predicted = np.einsum("mk,mk...->m...", self.weight, places[self.others])
        moved = places[self.one] - predicted
        return moved - self.offset if places.ndim == 2 else moved


def add_factors(equations: Equations, bars: Bars, factors: Factors, scale: float) -> None:
    """Add the residuals of factors between readings, whose standard deviations are ``scale`` times as large."""
    count, size = factors.others.shape
    columns, values = (part[:, :, CAMERA_UNKNOWNS] for part in bars.derive(factors.one))
    columns_others, values_others = (part.reshape(count, size, 2, -1) for part in bars.derive(factors.others.ravel()))
    values_others = -factors.weight[:, :, None, None] * values_others
    residual, std = factors.compare(bars.camera), scale * np.sqrt(factors.variance)
    squared = (residual**2).sum(axis=1) / std**2
    weight = 1.0 / (std * np.sqrt(1.0 + squared / (2.0 * ROBUST_SCALE**2)))
    for axis in range(2):
        equations.add(
            np.concatenate([columns[:, axis], columns_others[:, :, axis].reshape(count, -1)], axis=1),
            np.concatenate([values[:, axis], values_others[:, :, axis].reshape(count, -1)], axis=1),
            residual[:, axis],
            weight,
        )


def rescale_factors(bars: Bars, factors: Factors, samples: np.ndarray, scale: float) -> float:
    """Rescale the factors' expected errors by their residuals, as those of turns and lengths are."""
    residual, left = factors.compare(bars.camera), factors.compare(carry(bars, samples))
    std = np.sqrt(factors.variance)
    return rescale_by(residual.ravel(), left.reshape(-1, left.shape[2]), std.repeat(2), scale)


def even_out(bars: Bars, laid_out: Bars, factors: Factors, scale: float, length_scale: float) -> None:
    """Move readings within their bars to where they are expected by their factors and as they were laid out."""
    factors = factors.take(~np.isin(factors.one, np.concatenate([bars.first, bars.last])))
    one = factors.one
    ahead = turn(bars.heading[one], np.array([[1.0, 0.0]]))
    stretch = np.exp(bars.unknown[bars.row[one], 3])
    moved = stretch * (bars.along - laid_out.along)[one]
    away = -(factors.compare(bars.camera) * ahead).sum(axis=1)
    expected, variance = laid_out.uneven_m2[one] * length_scale**2, factors.variance * scale**2
    gain = expected / (expected + variance) / (1.0 + away**2 / (ROBUST_SCALE**2 * (expected + variance)))
    bars.along, bars.uneven_m2 = bars.along.copy(), bars.uneven_m2.copy()
    bars.along[one] += (gain * (moved + away) - moved) / stretch
    bars.uneven_m2[one] = (1.0 - gain) * laid_out.uneven_m2[one]
