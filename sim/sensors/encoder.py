"""Wheel encoders: joint angle -> faults -> ticks -> distance, as separate pure functions.

The drive uses the joint sensors themselves; the ticks of a recording are derived from its recorded wheel angles, so
a study of encoder faults repeats only this step, never the drive or the images.

To add a fault, add a setting to ``EncoderSettings`` and a record to ``FAULTS``: recordings, studies, expected errors
and reports read it from there. Faults of plugins (``sim.plugins``) act after these, each with an RNG stream of its own.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from sim.errors import InputError, WorkError
from sim.plugins import ENCODER_FAULTS, LOADING_HINT, name_code
from sim.rng import split
from sim.settings import EncoderSettings

Apply = Callable[[np.ndarray, EncoderSettings, float, np.random.Generator], np.ndarray]


@dataclass(frozen=True)
class Fault:
    """One fault of the encoders."""

    settings: tuple[str, ...]  # Fields of ``EncoderSettings`` that set it; 0 is off
    title: str  # Description of the quantity that grows with the setting
    # Changes the wheel angles (R, 2) [rad], given the settings, the wheels' radius [m] and an RNG stream
    apply: Apply | None = None
    # Draws a mask of the readings, of a given number, that never arrive
    drops: Callable[[int, EncoderSettings, np.random.Generator], np.ndarray] | None = None
    # Expected squared error [m^2] that each gap between two readings adds to the distance along a segment, for faults
    # in data sheets: from the setting, the gaps' lengths [m] and the number of original gaps in each, which is more
    # than one where readings were lost
    variance: Callable[[float, Any, Any], Any] | None = None
    # Mean squared error [m^2] of complete segments of these lengths [m] that is not noise
    bias: Callable[[EncoderSettings, Any], Any] | None = None


def disturb(
    wheel_angle: np.ndarray, settings: EncoderSettings, wheel_radius_m: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Angles (R, 2) [rad] with all faults, and which readings arrive (R,) bool.

    Wheel angles (R, 2) [rad] are those of the left and right joint at each reading, in the order driven. The generator
    is the parent of the faults' streams, which are separate, so that none changes what another draws.
    """
    angle, arrived = wheel_angle, np.ones(len(wheel_angle), bool)
    for fault in FAULTS:
        stream = split(rng, fault.settings[0])
        if fault.apply is not None:
            angle = fault.apply(angle, settings, wheel_radius_m, stream)
        if fault.drops is not None:
            arrived &= ~fault.drops(len(angle), settings, stream)
    for name, strength in settings.plugins.items():
        angle, dropped = _disturb_by_plugin(name, angle, strength, wheel_radius_m, split(rng, "plugins", name))
        arrived &= ~dropped
    return angle, arrived


def _disturb_by_plugin(
    name: str, angle: np.ndarray, strength: float, wheel_radius_m: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Angles with a plugin's fault, and which readings it drops; raises WorkError if it returns something else."""
    if name not in ENCODER_FAULTS:
        raise InputError(f"encoder.plugins.{name} {strength}: no plugin that is loaded defines it; {LOADING_HINT}")
    fault = ENCODER_FAULTS[name]
    dropped = np.zeros(len(angle), bool)
    shape = angle.shape
    if fault.apply is not None:
        angle = np.asarray(fault.apply(angle.copy(), strength, wheel_radius_m, rng), float)
        if angle.shape != shape or not np.isfinite(angle).all():
            raise WorkError(f"{name_code(fault.apply)} must return finite angles {shape}, not {angle.shape}")
    if fault.drops is not None:
        dropped = np.asarray(fault.drops(len(dropped), strength, rng))
        if dropped.shape != shape[:1] or dropped.dtype != bool:
            got = f"{dropped.shape} of {dropped.dtype}"
            raise WorkError(f"{name_code(fault.drops)} must return a mask {shape[:1]} of bool, not {got}")
    return angle, dropped


def scale_wheels(wheel_angle: np.ndarray, error_left: float, error_right: float) -> np.ndarray:
    """Angles (R, 2) as seen when each wheel's radius is assumed too large by a fraction: (1 + error) angle."""
    start = wheel_angle[:1]
    return start + (wheel_angle - start) * (1.0 + np.array([error_left, error_right]))


def slip_wheels(
    wheel_angle: np.ndarray, slip_per_m: float, wheel_radius_m: float, rng: np.random.Generator
) -> np.ndarray:
    """Angles (R, 2) with slip: each gap of length s gains a normal error of standard deviation slip_per_m sqrt(s).

    Slip is a random walk of each wheel along its path, so the error does not depend on how often the wheel is read.
    """
    gap = np.diff(wheel_angle, axis=0)
    distance_m = np.abs(gap) * wheel_radius_m
    noise = rng.standard_normal(gap.shape) * slip_per_m * np.sqrt(distance_m) / wheel_radius_m
    return _accumulate(wheel_angle, gap + noise)


def disturb_gaps(wheel_angle: np.ndarray, step_noise: float, rng: np.random.Generator) -> np.ndarray:
    """Angles (R, 2) whose consecutive gaps are multiplied by 1 + w n, n ~ N(0, 1) (paper, Sec. V-A).

    Both wheels share n, since the paper disturbs the distance that they measure together.
    """
    gap = np.diff(wheel_angle, axis=0)
    return _accumulate(wheel_angle, gap * (1.0 + step_noise * rng.standard_normal((len(gap), 1))))


def stick_wheel(wheel_angle: np.ndarray, stuck: float, rng: np.random.Generator) -> np.ndarray:
    """Angles (R, 2) in which one random wheel counts nothing for this fraction of the gaps, in one random stretch."""
    gap = np.diff(wheel_angle, axis=0)
    wheel, length = int(rng.integers(2)), round(stuck * len(gap))
    first = int(rng.integers(len(gap) - length + 1))
    gap[first : first + length, wheel] = 0.0
    return _accumulate(wheel_angle, gap) if length else wheel_angle


def _accumulate(wheel_angle: np.ndarray, gap: np.ndarray) -> np.ndarray:
    start = wheel_angle[:1]
    return np.concatenate([start, start + np.cumsum(gap, axis=0)])


def _bias_of_radii(encoder: EncoderSettings, distance: Any) -> Any:
    """A wheel radius that is wrong by the fraction e makes every distance longer by e / 2."""
    return ((encoder.radius_error_left + encoder.radius_error_right) / 2.0 * distance) ** 2


def _bias_of_sticking(encoder: EncoderSettings, distance: Any) -> Any:
    """A stuck encoder halves the measured distances on its part of the drive; ``distance`` is already halved there."""
    return encoder.stuck_fraction / (1.0 - 0.75 * encoder.stuck_fraction) * (distance / 2.0) ** 2


FAULTS: tuple[Fault, ...] = (
    Fault(
        ("radius_error_left", "radius_error_right"),
        "error of both wheels' radius",
        apply=lambda angle, encoder, radius_m, rng: scale_wheels(
            angle, encoder.radius_error_left, encoder.radius_error_right
        ),
        bias=_bias_of_radii,
    ),
    Fault(
        ("slip_per_m",),
        "slip after a metre [m]",
        apply=lambda angle, encoder, radius_m, rng: slip_wheels(angle, encoder.slip_per_m, radius_m, rng),
        variance=lambda slip, gap, made_of: slip**2 * gap / 2.0,  # the mean of two wheels, each slip^2 gap
    ),
    Fault(
        ("step_noise",),
        "noise w of each gap",
        apply=lambda angle, encoder, radius_m, rng: disturb_gaps(angle, encoder.step_noise, rng),
        variance=lambda noise, gap, made_of: (noise * gap) ** 2 / made_of,  # (paper, Sec. V-A)
    ),
    Fault(
        ("dropout",),
        "part of the readings lost",
        drops=lambda count, encoder, rng: rng.random(count) < encoder.dropout,
    ),
    Fault(
        ("stuck_fraction",),
        "part of the drive that one encoder sticks",
        apply=lambda angle, encoder, radius_m, rng: stick_wheel(angle, encoder.stuck_fraction, rng),
        bias=_bias_of_sticking,
    ),
    Fault(("track_error",), "error of the track width"),  # an assumed constant of the odometry that affects only turns
)


DATA_SHEET_SETTINGS = tuple(fault.settings[0] for fault in FAULTS if fault.variance)
"""Settings whose values a robot's builder knows, so that recordings hold them and methods use them."""


def expect_variance(odometry: Mapping[str, float], gap: Any, made_of: Any) -> Any:
    """Expected squared error [m^2] that each gap [m] adds, from the encoders' data sheets."""
    return sum(fault.variance(odometry.get(fault.settings[0], 0.0), gap, made_of) for fault in FAULTS if fault.variance)


def expect_bias(encoder: EncoderSettings, distance: Any) -> Any:
    """Mean squared error [m^2] of complete segments of these lengths [m] from faults that are in no data sheet."""
    own = sum(fault.bias(encoder, distance) for fault in FAULTS if fault.bias)
    for name, strength in encoder.plugins.items():
        if name in ENCODER_FAULTS and (bias := ENCODER_FAULTS[name].bias):
            own = own + bias(strength, distance)
    return own


Constants = dict[str, float]
RANGES = {
    "wheel_radius_m": (1e-6, 1e6),
    "track_m": (1e-6, 1e6),
    "ticks_per_rev": (1.0, 1e9),
    **dict.fromkeys(DATA_SHEET_SETTINGS, (0.0, 1e3)),
}
"""Allowed ranges of odometry constants; a constant that may be zero may also be missing."""
MAX_EXACT_TICKS = 2**40  # Number of ticks from which a conversion to metres in floating point becomes too coarse


def read_encoders(
    wheel_angle: np.ndarray, wheel_radius_m: float, settings: EncoderSettings, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Cumulative ticks (R, 2) int64 that the encoders report for a complete drive, and which readings arrive (R,) bool;
    arguments as for ``disturb``."""
    angle, arrived = disturb(wheel_angle, settings, wheel_radius_m, rng)
    return count_ticks(angle, settings), arrived


def describe_odometry(settings: EncoderSettings, wheel_radius_m: float, track_m: float) -> Constants:
    """What a robot's builder knows of its odometry: constants with their set errors, and the noise in data sheets.

    The wheels' radius and the distance between them are the true ones [m].
    """
    return {
        "wheel_radius_m": wheel_radius_m,
        "track_m": track_m * (1.0 + settings.track_error),
        "ticks_per_rev": settings.ticks_per_rev,
        **{name: getattr(settings, name) for name in DATA_SHEET_SETTINGS},
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
    return ticks - ticks[:1] if len(ticks) and (np.abs(ticks.astype(float)) >= MAX_EXACT_TICKS).any() else ticks
