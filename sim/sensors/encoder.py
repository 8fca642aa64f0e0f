"""Wheel encoders: joint angle -> faults of the way -> ticks -> distance, as separate pure functions.

The drive uses the joint sensors themselves; the ticks of a recording are derived from its recorded wheel angles, so
a study over encoder faults repeats only this file, never the drive or the images.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from sim.errors import InputError
from sim.settings import EncoderSettings

Constants = dict[str, float]
RANGES = {
    "wheel_radius_m": (1e-6, 1e6),
    "track_m": (1e-6, 1e6),
    "ticks_per_rev": (1.0, 1e9),
    "gap_noise": (0.0, 1e3),
    "slip_per_m": (0.0, 1e3),
}
"""Odometry constants that can be; what may be zero may also be missing."""
LARGE = 2**40
"""Ticks from which on metres, which are no integers, begin to lose them."""


def read_encoders(
    wheel_angle: np.ndarray, wheel_radius_m: float, settings: EncoderSettings, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Ticks that the encoders report for a whole drive, and which readings arrive.

    Args:
        wheel_angle: Left and right joint angle at each reading (R, 2) [rad], in the order driven.
        wheel_radius_m: The radius by which slip, given per metre, becomes an angle [m].
        settings: Resolution and faults.
        rng: Source of slip, gap noise, losses and what sticks; one stream each, so that one does not shift another.

    Returns:
        Cumulative ticks (R, 2) int64 and a mask (R,) bool of the readings that arrive.
    """
    slip_rng, gap_rng, lost_rng, stuck_rng = rng.spawn(4)
    angle = scale_wheels(wheel_angle, settings.radius_error_left, settings.radius_error_right)
    angle = slip_wheels(angle, settings.slip_per_m, wheel_radius_m, slip_rng)
    angle = disturb_gaps(angle, settings.gap_noise, gap_rng)
    angle = stick_wheel(angle, settings.stuck, stuck_rng)
    return count_ticks(angle, settings), keep_readings(len(angle), settings.lost, lost_rng)


def scale_wheels(wheel_angle: np.ndarray, error_left: float, error_right: float) -> np.ndarray:
    """Angles (R, 2) as seen when each wheel's way is measured too long by a fraction: (1 + error) angle."""
    start = wheel_angle[:1]
    return start + (wheel_angle - start) * (1.0 + np.array([error_left, error_right]))


def slip_wheels(
    wheel_angle: np.ndarray, slip_per_m: float, wheel_radius_m: float, rng: np.random.Generator
) -> np.ndarray:
    """Angles (R, 2) with slip: each gap of way s gains a normal error of standard deviation slip_per_m sqrt(s).

    A random walk of each wheel along its way, so that the error of a way does not depend on how often it is read.
    """
    gap = np.diff(wheel_angle, axis=0)
    way_m = np.abs(gap) * wheel_radius_m
    noise = rng.standard_normal(gap.shape) * slip_per_m * np.sqrt(way_m) / wheel_radius_m
    return _accumulate(wheel_angle, gap + noise)


def disturb_gaps(wheel_angle: np.ndarray, gap_noise: float, rng: np.random.Generator) -> np.ndarray:
    """Angles (R, 2) whose consecutive gaps are multiplied by 1 + w n, n ~ N(0, 1) (paper, Sec. V-A).

    Both wheels share n, since the paper disturbs the distance that they measure together.
    """
    gap = np.diff(wheel_angle, axis=0)
    return _accumulate(wheel_angle, gap * (1.0 + gap_noise * rng.standard_normal((len(gap), 1))))


def stick_wheel(wheel_angle: np.ndarray, stuck: float, rng: np.random.Generator) -> np.ndarray:
    """Angles (R, 2) of which one wheel's stand still for this fraction of the gaps, in one stretch by chance."""
    gap = np.diff(wheel_angle, axis=0)
    wheel, length = int(rng.integers(2)), round(stuck * len(gap))
    first = int(rng.integers(len(gap) - length + 1))
    gap[first : first + length, wheel] = 0.0
    return _accumulate(wheel_angle, gap) if length else wheel_angle


def describe_odometry(settings: EncoderSettings, wheel_radius_m: float, track_m: float) -> Constants:
    """What a robot's builder knows of its odometry: constants, as wrong as they are set, and the noise in data sheets.

    Args:
        settings: The encoders.
        wheel_radius_m: Radius of both wheels [m].
        track_m: True distance of the wheels [m].
    """
    return {
        "wheel_radius_m": wheel_radius_m,
        "track_m": track_m * (1.0 + settings.track_error),
        "ticks_per_rev": settings.ticks_per_rev,
        "gap_noise": settings.gap_noise,
        "slip_per_m": settings.slip_per_m,
    }


def read_odometry(manifest: Mapping[str, Any]) -> Mapping[str, float]:
    """Odometry constants of a recording; raises InputError naming the first that cannot be."""
    odometry = manifest.get("odometry")
    if not isinstance(odometry, Mapping):
        odometry = {}
    for name, (low, high) in RANGES.items():
        value = odometry.get(name, 0.0 if low == 0.0 else None)
        if not isinstance(value, int | float) or isinstance(value, bool) or not low <= value <= high:
            raise InputError(f"manifest: odometry.{name} must be a number from {low:g} to {high:g}, and is {value!r}")
    return odometry


def count_ticks(wheel_angle: np.ndarray, settings: EncoderSettings) -> np.ndarray:
    """Whole ticks (R, 2) int64 of angles (R, 2) [rad]: floor or nearest of angle x ticks_per_rev / 2 pi."""
    turns = np.asarray(wheel_angle) * (settings.ticks_per_rev / (2 * np.pi))
    return {"floor": np.floor, "nearest": np.rint}[settings.rounding](turns).astype(np.int64)


def ticks_to_distance(ticks: np.ndarray, wheel_radius_m: float, ticks_per_rev: int) -> np.ndarray:
    """Way (...) [m] of a wheel that counted ``ticks`` (...): 2 pi r ticks / ticks_per_rev."""
    return np.asarray(ticks) * (2 * np.pi * wheel_radius_m / ticks_per_rev)


def count_from_first(ticks: np.ndarray) -> np.ndarray:
    """Cumulative ticks (R, 2) int64 counted from the first reading if they are so large that metres would lose them.

    Smaller ones stay as they are. A counter that overflows 64 bits on the way is taken to go on.
    """
    return ticks - ticks[:1] if len(ticks) and (np.abs(ticks.astype(float)) >= LARGE).any() else ticks


def keep_readings(count: int, lost: float, rng: np.random.Generator) -> np.ndarray:
    """Mask (count,) bool of the readings that arrive; each is lost with probability ``lost``."""
    return rng.random(count) >= lost


def _accumulate(wheel_angle: np.ndarray, gap: np.ndarray) -> np.ndarray:
    start = wheel_angle[:1]
    return np.concatenate([start, start + np.cumsum(gap, axis=0)])
