"""What plugins add to the simulation, faults of the wheel encoders; and where a plugin's code has failed."""

import traceback
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class EncoderFault:
    """A fault of the wheel encoders that a plugin adds; the setting ``encoder.plugins.<name>`` is its strength.

    Attributes:
        title: Description of the quantity that the setting is, with its unit, for reports.
        apply: (wheel angles (R, 2) [rad] in the order driven, strength, wheel radius [m], RNG) -> faulty angles.
        drops: (number of readings R, strength, RNG) -> mask (R,) bool of the readings that never arrive.
        bias: (strength, lengths of complete segments [m]) -> expected squared error of each length [m^2].
        limits: Smallest and largest strength; 0 is off and always allowed.
    """

    title: str
    apply: Callable[[np.ndarray, float, float, np.random.Generator], np.ndarray] | None = None
    drops: Callable[[int, float, np.random.Generator], np.ndarray] | None = None
    bias: Callable[[float, Any], Any] | None = None
    limits: tuple[float, float] = (0.0, float("inf"))


ENCODER_FAULTS: dict[str, EncoderFault] = {}
"""Encoder faults of plugins by name: one table, as settings check themselves wherever they are made."""
LOADING_HINT = "--plugin FILE loads one, in Python plugins=[FILE]"
MODULE_PREFIX = "deepgps_plugin_"  # Beginning of the names of modules that are plugins


def name_code(function: Callable[..., Any]) -> str:
    """File and name of a plugin's function."""
    code = getattr(function, "__code__", None)
    return f"{code.co_filename}, {code.co_name}" if code else repr(function)


def locate_failure(error: BaseException) -> str | None:
    """The plugin's file and line in which an exception was raised; None: not in a plugin's code."""
    if isinstance(error, SyntaxError) and error.filename and error.lineno:
        return f"plugin {error.filename}, line {error.lineno}"
    frames = [
        (frame, line)
        for frame, line in traceback.walk_tb(error.__traceback__)
        if frame.f_globals.get("__name__", "").startswith(MODULE_PREFIX)
    ]
    return f"plugin {frames[-1][0].f_code.co_filename}, line {frames[-1][1]}" if frames else None
