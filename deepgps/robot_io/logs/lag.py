"""How much later than the images the wheels are, from turns in place that both see.

The turn between two images is the circular shift that makes their rings agree best. The lag is the shift in time at
which the wheels turn as the images do.
"""

from typing import NamedTuple

import numpy as np

from sim.geometry import wrap

FINER = 16
"""Points between two sectors at which shifts are compared."""
LONGEST_S = 0.5
"""Largest lag that is looked for [s]."""
STEP_S = 0.002
OUTLIER_RAD = 0.1
"""Differences from here on count no more [rad]."""
LEAST_RAD = 0.05
"""Turns between two images that are smaller than this tell nothing [rad]."""
FEWEST = 12
"""Fewest pairs of images from which a lag is estimated."""


class Pairs(NamedTuple):
    """Pairs of images taken while the robot turned in place.

    Attributes:
        first_s: Time of the first image of each (p,) [s].
        second_s: Time of the second one (p,) [s].
        turned: The turn between them by the images (p,) [rad], to the left.
    """

    first_s: np.ndarray
    second_s: np.ndarray
    turned: np.ndarray


class Lag(NamedTuple):
    """A lag.

    Attributes:
        seconds: How much later than the images the wheels are [s].
        agree: Share of pairs in which wheels and images turn by the same angle then.
        mirrored: The same share if images turned the other way.
        pairs: Number of pairs.
        ratio: How many times as far the wheels turn, as a median.
    """

    seconds: float
    agree: float
    mirrored: float
    pairs: int
    ratio: float


def measure_shift(first: np.ndarray, second: np.ndarray) -> float:
    """Turn to the left between two polar images (rings, sectors, 3) of one place [rad], by cross-correlation."""
    one, two = (np.fft.rfft(_sharpen(image), axis=1) for image in (first, second))
    sectors = first.shape[1]
    likely = np.fft.irfft((one * two.conj()).sum(axis=(0, 2)), sectors * FINER)
    return float(wrap(2 * np.pi * np.argmax(likely) / (sectors * FINER)))


def _sharpen(image: np.ndarray) -> np.ndarray:
    """Differences along the rings, weighted by their length."""
    light = image.astype(np.float32)
    size = np.arange(1, len(light) + 1)[:, None, None]
    return (light - np.roll(light, 1, axis=1)) * np.sqrt(size)


def estimate_lag(pairs: Pairs, time_s: np.ndarray, yaw: np.ndarray) -> Lag | None:
    """The lag at which the wheels' heading (n,) [rad] at times (n,) [s] turns as the images; None: too few turns."""
    known = np.abs(pairs.turned) > LEAST_RAD
    first_s, second_s, turned = (values[known] for values in pairs)
    if len(turned) < FEWEST:
        return None

    def turn_by_wheels(lag_s: float) -> np.ndarray:
        return np.interp(second_s + lag_s, time_s, yaw) - np.interp(first_s + lag_s, time_s, yaw)

    def differ(lag_s: float, sign: float = 1.0) -> np.ndarray:
        return np.abs(wrap(sign * turned - turn_by_wheels(lag_s)))

    def best(sign: float) -> tuple[float, float]:
        lags = np.arange(-LONGEST_S, LONGEST_S + STEP_S / 2, STEP_S)
        cost = np.array([np.minimum(differ(lag, sign) ** 2, OUTLIER_RAD**2).sum() for lag in lags])
        lag_s = float(lags[int(np.argmin(cost))])
        return lag_s, float((differ(lag_s, sign) < OUTLIER_RAD / 2).mean())

    (lag_s, agree), (_, mirrored) = best(1.0), best(-1.0)
    ratio = float(np.median(np.abs(turn_by_wheels(lag_s) / turned)))
    return Lag(round(lag_s, 4), agree, mirrored, len(turned), ratio)
