"""Findings: which faults a diagnosis shows, by the fewest that explain it, and what to set against each."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Any

import numpy as np

from deepgps.diagnosis.diagnosis import Diagnosis, Estimate

CERTAINTY_HALF_WIDTHS = 1.7
"""Half widths of a 95 % interval that a value must be away from what is right: 3.3 standard deviations, since eight
quantities are looked at in every recording."""
RATIO, TRACK, SLIP, STEP, TICK_M, LOST_SHARE = 0.002, 0.003, 0.002, 0.005, 0.002, 0.005
"""Smallest faults that are reported, as parts, or in metres; smaller ones do not matter for a map."""
SPACING_M = 0.08  # Distance between two readings for which the noise of a gap is compared with other noise [m]


UNKNOWN_SCALE_NOTE = (
    "What cannot be known: a factor that all distances share. If both wheels are wrong alike, every distance is, and "
    "no sensor of this robot knows a metre; drive along a tape measure to find out."
)


@dataclass(frozen=True)
class Finding:
    """One fault."""

    fault: str  # Its name: radius, wheel, track, slip, step_noise, ticks, dropout or stuck
    text: str  # What is wrong, how large it is, and its 95 % interval
    cure: str  # What to set
    setting: str  # The testbed's setting that makes this fault


@dataclass(frozen=True)
class Correction:
    """What to set in the odometry, in units of the constants that it has."""

    left: float  # Radius of the left wheel over the one assumed
    right: float  # Radius of the right wheel over the one assumed
    track: float  # Track width over the one assumed
    readings: str | None  # Wheel whose readings have the wrong scale, or none
    wheel: str | None  # Wheel whose own radius is wrong, or none
    exact: bool  # Whether one wheel explains the turns too, so that the track width stays


def list_smallest(diagnosis: Diagnosis) -> dict[str, float]:
    """Smallest size of each fault that can be detected in such a recording, given its ticks and its slip."""
    slip, tick = diagnosis.slip_per_m.value, diagnosis.tick_m.value
    return {
        "radius": max(RATIO, _reach(diagnosis.reading_ratio)),
        "wheel": max(RATIO, _reach(diagnosis.wheel_ratio)),
        "track": max(TRACK, _reach(diagnosis.turn_scale)),
        "slip": max(SLIP, 0.3 * tick),
        "step_noise": max(STEP, 0.4 * slip / np.sqrt(2.0 * SPACING_M), 0.2 * tick / SPACING_M),
        "ticks": TICK_M,
        "dropout": LOST_SHARE,
        "stuck": 0.01,
    }


def correct(diagnosis: Diagnosis) -> Correction:
    """The odometry's constants by the simplest explanation of what the wheels and the camera say.

    The camera knows turns only: their scale S, and the ratio rho of the distances that the wheels really drive to those
    read, right over left. One wrong wheel changes both: S = (1 + rho) / 2 if the right one is right, (1 + 1 / rho) / 2
    if the left one is. Where neither holds, the mean radius is kept and the track width takes the rest.
    """
    least, scale = list_smallest(diagnosis), diagnosis.turn_scale
    reading, wheel = diagnosis.reading_ratio, diagnosis.wheel_ratio
    read_wrong = abs(reading.value - 1.0) > least["radius"]
    wheel_wrong = wheel.known and abs(wheel.value - 1.0) > least["wheel"]
    best, sides = np.inf, (None, None)
    for one, other in product(
        ("left", "right") if read_wrong else (None,), ("left", "right") if wheel_wrong else (None,)
    ):
        expected = _mean(reading.value, one) / _mean(wheel.value, other)
        if abs(np.log(scale.value / expected)) < best:
            best, sides = abs(float(np.log(scale.value / expected))), (one, other)
    exact = best <= least["track"] or not scale.known
    left, right = 1.0, 1.0
    if exact:
        for ratio, side, power in ((reading.value, sides[0], -1.0), (wheel.value, sides[1], 1.0)):
            left *= ratio**-power if side == "left" else 1.0
            right *= ratio**power if side == "right" else 1.0
        return Correction(left, right, 1.0, *sides, True)
    rho = (wheel.value if wheel_wrong else 1.0) / (reading.value if read_wrong else 1.0)
    left, right = 2.0 / (1.0 + rho), 2.0 * rho / (1.0 + rho)
    return Correction(left, right, scale.value * 4.0 * rho / (1.0 + rho) ** 2, *sides, False)


def find_faults(diagnosis: Diagnosis) -> list[Finding]:
    """All faults that are certain, the ones that change a map most first."""
    least, fix = list_smallest(diagnosis), correct(diagnosis)
    return [finding for find in FAULTS if (finding := find(diagnosis, least, fix))]


def as_stored(diagnosis: Diagnosis) -> dict[str, Any]:
    """What ``diagnosis.json`` says beside the quantities: faults, what to set, and the smallest detectable faults."""
    fix, odometry = correct(diagnosis), diagnosis.odometry
    return {
        "faults": [vars(finding) for finding in find_faults(diagnosis)],  # Each fault that was found
        # Values that are right, but for a factor that all distances share [m]
        "set": {
            "left_radius_m": odometry["wheel_radius_m"] * fix.left,
            "right_radius_m": odometry["wheel_radius_m"] * fix.right,
            "track_m": odometry["track_m"] * fix.track,
        },
        "smallest": list_smallest(diagnosis),  # The smallest detectable fault of each name in this recording
        "unknown": UNKNOWN_SCALE_NOTE,  # What cannot be known
    }


def _mean(ratio: float, side: str | None) -> float:
    """Mean of both wheels' scales, if one of them is wrong and their ratio, right over left, is known."""
    return {None: 1.0, "left": (1.0 + 1.0 / ratio) / 2.0, "right": (1.0 + ratio) / 2.0}[side]


def _reach(estimate: Estimate) -> float:
    return CERTAINTY_HALF_WIDTHS * (estimate.high - estimate.low) / 2.0


def _percent(estimate: Estimate) -> str:
    return f"{100 * estimate.value:.3g} % ({100 * estimate.low:.3g} to {100 * estimate.high:.3g})"


def _off(ratio: Estimate, side: str) -> tuple[float, str]:
    """By how much one wheel differs from the other one, and the same in words."""
    low, value, high = (1.0 / ratio.high, 1.0 / ratio.value, 1.0 / ratio.low) if side == "left" else (
        ratio.low, ratio.value, ratio.high
    )  # fmt: skip
    bounds = sorted((abs(low - 1.0), abs(high - 1.0)))
    return value - 1.0, f"{100 * abs(value - 1.0):.2f} % ({100 * bounds[0]:.2f} to {100 * bounds[1]:.2f})"


def _find_radius(diagnosis: Diagnosis, least: dict[str, float], fix: Correction) -> Finding | None:
    if fix.readings is None:
        return None
    side, other = fix.readings, "right" if fix.readings == "left" else "left"
    error, size = _off(diagnosis.reading_ratio, side)
    way = "long" if error > 0 else "short"
    sure = f" Turns say that it is the {side} one, if the track width is right."
    if not fix.exact:
        sure = f" Or the {other} one's are too {'short' if error > 0 else 'long'}: turns do not tell."
    return Finding(
        "radius",
        f"The {side} wheel's readings are {size} too {way} against the {other} one's, while the robot drives straight: "
        f"the radius that is assumed for it is too {'large' if error > 0 else 'small'}, or its ticks per turn of the "
        f"wheel are wrong.{sure}",
        _say_radii(diagnosis, fix),
        f"--encoder.radius-error-{side} {error:.4f}",
    )


def _find_wheel(diagnosis: Diagnosis, least: dict[str, float], fix: Correction) -> Finding | None:
    if fix.wheel is None:
        return None
    error, size = _off(diagnosis.wheel_ratio, "left")
    bigger, smaller = ("left", "right") if error > 0 else ("right", "left")
    curve = np.degrees(2 * abs(error) / (2 + error) / diagnosis.track_m.value)
    return Finding(
        "wheel",
        f"The {bigger} wheel is {size} larger than the {smaller} one: with equal angles of both wheels the robot "
        f"curves to the {smaller} by {curve:.2f} degrees a metre.",
        f"change the tyre, or steer by distances instead of angles of the wheels; {_say_radii(diagnosis, fix)}",
        f"--robot.wheel-radius-error {error:.4f}",
    )


def _find_track(diagnosis: Diagnosis, least: dict[str, float], fix: Correction) -> Finding | None:
    if fix.exact:
        return None
    scale, assumed = diagnosis.turn_scale, diagnosis.odometry["track_m"]
    off = 100 * abs(scale.value - 1.0)
    bounds = sorted((100 * abs(scale.low - 1.0), 100 * abs(scale.high - 1.0)))
    way, track, both = ("large", "small", "large") if scale.value > 1 else ("small", "large", "small")
    return Finding(
        "track",
        f"Turns by the wheels are {off:.2f} % ({bounds[0]:.2f} to {bounds[1]:.2f}) too {way}: the track width that is "
        f"assumed is too {track}, or both radii are too {both}. No angle tells these two apart; they differ in what a "
        "metre is, which only a tape measure knows.",
        f"track width {1000 * assumed * fix.track:.2f} mm (now {1000 * assumed:.2f}), which makes turns right in both "
        "cases; drive a metre along a tape to know which",
        f"--encoder.track-error {1 / scale.value - 1:.4f}",
    )


def _find_stuck(diagnosis: Diagnosis, least: dict[str, float], fix: Correction) -> Finding | None:
    if not diagnosis.stretches:
        return None
    when = ", ".join(f"the {one.wheel} one from {one.begin_s:.0f} to {one.end_s:.0f} s" for one in diagnosis.stretches)
    return Finding(
        "stuck",
        f"A wheel counts nothing in {_percent(diagnosis.stuck_fraction)} of the gaps while the other one turns: "
        f"{when}.",
        "look at that encoder's plug and magnet; distances in these stretches are halved, but methods that learn with "
        "the diagnosis take them from the other wheel",
        f"--encoder.stuck-fraction {diagnosis.stuck_fraction.value:.3f}",
    )


STRENGTHS = {
    "slip": (
        "slip_per_m",
        "Each wheel slips by {mm} in a metre, at random.",
        "nothing in the odometry; clean wheels and floor, drive slower, and learn with registration",
        "--encoder.slip-per-m {value:.4f}",
    ),
    "step_noise": (
        "step_noise",
        "The distance between two readings is wrong by {percent} of it, at random, for both wheels alike.",
        "nothing in the odometry; look at the times of readings, and learn with registration",
        "--encoder.step-noise {value:.3f}",
    ),
    "dropout": (
        "dropout",
        "{percent} of the readings never arrived.",
        "look at cable and bus; the distances between the others are right",
        "--encoder.dropout {value:.3f}",
    ),
}
"""Faults that have a strength: the quantity that is it, what is wrong, what to set, and the testbed's setting."""


def _find_strength(name: str, diagnosis: Diagnosis, least: dict[str, float], fix: Correction) -> Finding | None:
    quantity, text, cure, setting = STRENGTHS[name]
    found = diagnosis.quantities[quantity]
    if found.value <= max(least[name], CERTAINTY_HALF_WIDTHS * (found.value - found.low)):
        return None
    mm = f"{1000 * found.value:.1f} mm ({1000 * found.low:.1f} to {1000 * found.high:.1f})"
    return Finding(name, text.format(mm=mm, percent=_percent(found)), cure, setting.format(value=found.value))


def _find_ticks(diagnosis: Diagnosis, least: dict[str, float], fix: Correction) -> Finding | None:
    tick_m, odometry = diagnosis.tick_m.value, diagnosis.odometry
    if tick_m < least["ticks"]:
        return None
    ticks = round(2 * np.pi * odometry["wheel_radius_m"] / tick_m)
    return Finding(
        "ticks",
        f"A tick is {1000 * tick_m:.1f} mm long, {ticks} in a turn of the wheel.",
        "an encoder with more ticks, or one on the motor's side of the gear; four in a turn are enough for a map",
        f"--encoder.ticks-per-rev {ticks}",
    )


def _say_radii(diagnosis: Diagnosis, fix: Correction) -> str:
    radius_mm = 1000 * diagnosis.odometry["wheel_radius_m"]
    sides = [(name, value) for name, value in (("left", fix.left), ("right", fix.right)) if abs(value - 1.0) > 1e-9]
    radii = " and ".join(f"{name} radius {radius_mm * value:.3f} mm" for name, value in sides)
    return f"{radii} (now {radius_mm:.3f})"


FAULTS: tuple[Callable[[Diagnosis, dict[str, float], Correction], Finding | None], ...] = (
    *(_find_radius, _find_wheel, _find_track, _find_stuck, partial(_find_strength, "slip")),
    *(partial(_find_strength, "step_noise"), _find_ticks, partial(_find_strength, "dropout")),
)
