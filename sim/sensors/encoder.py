"""Wheel encoders: joint angle -> faults -> ticks -> distance, as separate pure functions.

The drive uses the joint sensors themselves; the ticks of a recording are derived from its recorded wheel angles, so
a study of encoder faults repeats only this step, never the drive or the images.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from sim.errors import InputError
from sim.sensors.encoder_faults import IN_DATA_SHEETS, disturb
from sim.settings import EncoderSettings

Constants = dict[str, float]
RANGES = {
    "wheel_radius_m": (1e-6, 1e6),
    "track_m": (1e-6, 1e6),
    "ticks_per_rev": (1.0, 1e9),
    **dict.fromkeys(IN_DATA_SHEETS, (0.0, 1e3)),
}
"""Allowed ranges of odometry constants; a constant that may be zero may also be missing."""
LARGE = 2**40
"""Number of ticks from which a conversion to metres in floating point becomes too coarse."""


def read_encoders(
    wheel_angle: np.ndarray, wheel_radius_m: float, settings: EncoderSettings, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Ticks that the encoders report for a complete drive, and which readings arrive.

    Args:
        wheel_angle: Left and right joint angle at each reading (R, 2) [rad], in the order driven.
        wheel_radius_m: Radius that converts slip per metre to an angle [m].
        settings: Resolution and faults.
        rng: Parent of the faults' RNG streams.

    Returns:
        Cumulative ticks (R, 2) int64 and a mask (R,) bool of the readings that arrive.
    """
    angle, arrived = disturb(wheel_angle, settings, wheel_radius_m, rng)
    return count_ticks(angle, settings), arrived


def describe_odometry(settings: EncoderSettings, wheel_radius_m: float, track_m: float) -> Constants:
    """What a robot's builder knows of its odometry: constants with their set errors, and the noise in data sheets.

    Args:
        settings: The encoders.
        wheel_radius_m: Radius of both wheels [m].
        track_m: True distance between the wheels [m].
    """
    return {
        "wheel_radius_m": wheel_radius_m,
        "track_m": track_m * (1.0 + settings.track_error),
        "ticks_per_rev": settings.ticks_per_rev,
        **{name: getattr(settings, name) for name in IN_DATA_SHEETS},
    }


def check_odometry(odometry: Mapping[str, Any]) -> Mapping[str, float]:
    """Check a manifest's odometry constants; raises InputError that names the first invalid one."""
    for name, (low, high) in RANGES.items():
        value = odometry.get(name, 0.0 if low == 0.0 else None)
        if not isinstance(value, int | float) or isinstance(value, bool) or not low <= value <= high:
            raise InputError(f"manifest: odometry.{name} must be a number from {low:g} to {high:g}, and is {value!r}")
    return odometry


def count_ticks(wheel_angle: np.ndarray, settings: EncoderSettings) -> np.ndarray:
    """Integer ticks (R, 2) int64 of angles (R, 2) [rad]: floor of angle x ticks_per_rev / 2 pi."""
    return np.floor(np.asarray(wheel_angle) * (settings.ticks_per_rev / (2 * np.pi))).astype(np.int64)


def ticks_to_distance(ticks: np.ndarray, wheel_radius_m: float, ticks_per_rev: float) -> np.ndarray:
    """Distance (...) [m] travelled by a wheel that counted ``ticks`` (...): 2 pi r ticks / ticks_per_rev."""
    return np.asarray(ticks) * (2 * np.pi * wheel_radius_m / ticks_per_rev)


def measure_tick(odometry: Mapping[str, Any]) -> float:
    """Distance that a wheel travels in one tick [m]."""
    return float(ticks_to_distance(np.array(1), odometry["wheel_radius_m"], odometry["ticks_per_rev"]))


def count_from_first(ticks: np.ndarray) -> np.ndarray:
    """Cumulative ticks (R, 2) int64, counted from the first reading if they are too large for a conversion to metres.

    Smaller ticks are returned unchanged. The difference also unwraps a counter that overflows 64 bits.
    """
    return ticks - ticks[:1] if len(ticks) and (np.abs(ticks.astype(float)) >= LARGE).any() else ticks
