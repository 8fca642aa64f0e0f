"""The recordings of the study ``diagnose``: faults drawn log-uniform, alone and in pairs, on a few shared drives."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from sim.rng import stream

Point = dict[str, Any]
LIMITS: dict[str, tuple[float, float]] = {
    "encoder.radius_error_left": (0.01, 0.1),
    "encoder.radius_error_right": (0.01, 0.1),
    "encoder.track_error": (0.02, 0.1),
    "encoder.slip_per_m": (0.005, 0.1),
    "encoder.step_noise": (0.02, 0.3),
    "encoder.ticks_per_rev": (4, 256),
    "encoder.dropout": (0.1, 0.6),
    "encoder.stuck_fraction": (0.05, 0.5),
}
"""Smallest and largest strength in the study ``encoder``; errors may have either sign."""
ALIKE = ("encoder.radius_error_left", "encoder.radius_error_right")
SHORTER = (10, 9, 8, 7, 6)
"""Lengths of the recordings without faults, in tenths of the drive."""
ALONE, PAIRS = 11, 2
"""Recordings of each drive with one fault, and with two."""
WHEEL = "robot.wheel_radius_error"


def draw_runs(common: Mapping[str, Any], drives: Sequence[tuple[int, Point]]) -> list[tuple[int, Point]]:
    """Seeds and settings of all recordings.

    A drive with equal wheels gives five recordings without faults, five with radii that are wrong alike, eleven with
    one fault and two with two; one with unequal wheels a recording with this fault alone, and one with a second fault.

    Args:
        common: Settings of all recordings.
        drives: Seed and settings of each drive.
    """
    runs: list[tuple[int, Point]] = []
    single = 0
    for number, (seed, drive) in enumerate(drives):
        rng = stream(seed, "diagnose", number)
        samples: int = common["drive.samples"]

        def add(faults: Point, seed: int = seed, drive: Point = drive, add: Callable = runs.append) -> None:
            add((seed, {**drive, **faults}))

        if drive.get(WHEEL):
            add({})
            add(_draw(rng, _choose(rng, 1)))
            continue
        for tenths in SHORTER:
            add({"drive.samples": samples * tenths // 10})
        for _ in range(len(SHORTER)):
            add(dict.fromkeys(ALIKE, _draw(rng, ALIKE[:1])[ALIKE[0]]))
        for _ in range(ALONE):
            add(_draw(rng, [list(LIMITS)[single % len(LIMITS)]]))
            single += 1
        for _ in range(PAIRS):
            add(_draw(rng, _choose(rng, 2)))
    return runs


def _choose(rng: np.random.Generator, count: int) -> list[str]:
    names = [name for name in LIMITS if name != ALIKE[int(rng.integers(2))]]
    return [names[place] for place in rng.choice(len(names), count, replace=False)]


def _draw(rng: np.random.Generator, names: Sequence[str]) -> Point:
    """A strength of each fault."""
    drawn: Point = {}
    for name in names:
        low, high = LIMITS[name]
        value = float(np.exp(rng.uniform(np.log(low), np.log(high))))
        sign = int(rng.choice((-1, 1))) if "error" in name else 1
        drawn[name] = round(value) if isinstance(low, int) else round(sign * value, 5)
    return drawn
