"""Angles of coarse encoders between their counts.

While a coarse encoder counts nothing, its wheel turns on. Where it was is known when a count changes: half-way between
the two. Between such moments the angle is interpolated, and where no count comes for long, the wheel rests at its
last count. Without this, a robot that drives evenly seems to jump, stop and turn.
"""

from dataclasses import replace

import numpy as np

from deepgps.robot_io.logs.wheels import Wheels

COARSE = 0.125
"""Smallest step of an angle over its usual step between two messages, from which its encoder is coarse."""
SMALLEST = 1.0
"""Percentile of the steps that counts as the smallest; smaller ones may be repairs."""
WAIT_S, SETTLE_S = 0.3, 0.15
"""Time between two counts after which the wheel may have rested between them, and the time in which it comes to rest
after a count, or begins to turn before the next one [s]."""

COARSEST = 12
"""Ticks per revolution below which turns in place are not found reliably; 16 were enough in tests."""


def fill_counts(wheels: Wheels, topic: str) -> Wheels:
    """The wheels with the angles of coarse encoders interpolated between their counts; others stay as they are.

    Args:
        wheels: The wheels.
        topic: Name for a note on encoders that are too coarse.
    """
    coarse = [is_coarse(one) for one in wheels.angle.T]
    angle = [_fill(wheels.time_s, one) if has else one for one, has in zip(wheels.angle.T, coarse, strict=True)]
    ticks = [2 * np.pi / _find_tick(one) for one, has in zip(wheels.angle.T, coarse, strict=True) if has]
    notes = list(wheels.notes)
    if ticks and (least := min(ticks)) < COARSEST:
        notes.append(f"{topic}: an encoder counts {least:.0f} ticks a turn of its wheel: turns in place may be missed")
    return replace(wheels, angle=np.column_stack(angle), notes=tuple(notes))


def is_coarse(angle: np.ndarray) -> bool:
    """Whether angles (n,) [rad] change by few counts of the encoder between two messages."""
    step = np.abs(np.diff(angle))
    return bool(step.any()) and _find_tick(angle) > COARSE * float(np.median(step[step > 0.0]))


def _find_tick(angle: np.ndarray) -> float:
    """The smallest step of angles (n,) [rad], but for repairs."""
    step = np.abs(np.diff(angle))
    return float(np.percentile(step[step > 0.0], SMALLEST))


def _fill(time_s: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Angles (n,) [rad] of one wheel, interpolated between the changes of its counts."""
    row = np.flatnonzero(np.diff(angle))
    change_s, middle = (time_s[row] + time_s[row + 1]) / 2, (angle[row] + angle[row + 1]) / 2
    begins, ends = np.r_[time_s[0], change_s], np.r_[change_s, time_s[-1]]
    rests = ends - begins > WAIT_S
    count = angle[np.r_[0, row + 1]][rests]  # at which the wheel rests in each of these intervals
    knots_s = np.concatenate([change_s, begins[rests] + SETTLE_S, ends[rests] - SETTLE_S])
    order = np.argsort(knots_s, kind="stable")
    return np.interp(time_s, knots_s[order], np.concatenate([middle, count, count])[order])
