"""The two computers of the robot and their clocks, which nothing synchronises.

The computer with the camera records the log. The one with the wheels and the rays stamps its messages by a clock that
differs from the recorder's by a few seconds and runs a little faster or slower.
"""

from dataclasses import dataclass

import numpy as np

from sim.rng import stream

EPOCH_NS = 1_767_225_600 * 10**9
"""What the recorder's clock reads when the drive begins: 1 January 2026, 0:00 UTC [ns]."""
OFFSET_S = (1.0, 5.0)
"""Least and largest difference between the clocks when the drive begins [s]."""
DRIFT = (20e-6, 50e-6)
"""Least and largest relative difference of their rates (quartz oscillators have some 20 to 50 millionths)."""


@dataclass(frozen=True)
class Clock:
    """A computer's clock.

    Attributes:
        offset_s: How far it is ahead of the recorder's when the drive begins [s].
        drift: How much faster it runs than the simulation's time, as a fraction.
    """

    offset_s: float = 0.0
    drift: float = 0.0

    def read(self, time_s: np.ndarray) -> np.ndarray:
        """What it reads (...) int64 [ns since 1970] at times of the simulation (...) [s]."""
        return EPOCH_NS + np.rint((self.offset_s + np.asarray(time_s) * (1.0 + self.drift)) * 1e9).astype(np.int64)

    def fire(self, period_s: float, first_s: float, last_s: float) -> np.ndarray:
        """Times of the simulation [s], after ``first_s`` and up to ``last_s``, when a timer of this period fires."""
        step_s = period_s / (1.0 + self.drift)
        return np.arange(np.floor(first_s / step_s) + 1, np.floor(last_s / step_s) + 1) * step_s


RECORDER = Clock()


def make_base_clock(seed: int) -> Clock:
    """The clock of the computer with the wheels, by the scenario's seed."""
    rng = stream(seed, "log", "clock")
    offset_s, drift = (rng.choice((-1.0, 1.0)) * rng.uniform(*limits) for limits in (OFFSET_S, DRIFT))
    return Clock(float(offset_s), float(drift))
