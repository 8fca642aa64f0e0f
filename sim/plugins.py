"""What plugins add to the simulation: faults of the encoders, each with the checksum of the source that defines it."""

import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from sim.errors import InputError, WorkError, one_line


@dataclass(frozen=True)
class Source:
    """Where a plugin's code comes from.

    Attributes:
        file: The file.
        sha256: Checksum of the source.
        installed: Whether it is installed as an entry point, so that every process finds it by itself.
    """

    file: Path
    sha256: str
    installed: bool = False


@dataclass(frozen=True)
class EncoderFault:
    """A fault of the wheel encoders that a plugin adds; the setting ``encoder.plugins.<name>`` is its strength.

    Attributes:
        title: Description of the quantity that the setting is, with its unit, for reports.
        apply: (wheel angles (R, 2) [rad] in the order driven, strength, wheel radius [m], RNG) -> faulty angles.
        drops: (number of readings R, strength, RNG) -> mask (R,) bool of the readings that never arrive.
        bias: (strength, lengths of complete segments [m]) -> expected squared error of each length [m^2].
        limits: Smallest and largest strength; 0 is off and always allowed.
        source: Set when the plugin is loaded.
    """

    title: str
    apply: Callable[[np.ndarray, float, float, np.random.Generator], np.ndarray] | None = None
    drops: Callable[[int, float, np.random.Generator], np.ndarray] | None = None
    bias: Callable[[float, Any], Any] | None = None
    limits: tuple[float, float] = (0.0, float("inf"))
    source: Source | None = field(default=None, compare=False)


ENCODER_FAULTS: dict[str, EncoderFault] = {}
"""Encoder faults of plugins by name, filled by ``deepgps.config.plugins.load_plugins`` alone.

One table for the whole process, as settings check themselves wherever they are made, from YAML, in a study or when a
run is opened, and no table can be passed there.
"""


def find_fault(name: str) -> EncoderFault:
    """The loaded fault of this name; raises InputError if no plugin that defines it is loaded."""
    if name not in ENCODER_FAULTS:
        raise InputError(f"encoder.plugins.{name}: no plugin that is loaded defines it; {HOW_TO_LOAD}")
    return ENCODER_FAULTS[name]


HOW_TO_LOAD = "--plugin FILE loads one, in Python plugins=[FILE]"


@contextmanager
def calling(source: Source | None) -> Iterator[None]:
    """Turn an exception of a plugin's code into a WorkError of one line that names the plugin's file and line."""
    try:
        yield
    except (InputError, WorkError):
        raise
    except Exception as error:
        if source is None:
            raise
        raise WorkError(describe_failure(error, source.file)) from error


def describe_failure(error: BaseException, file: Path) -> str:
    """An exception in one line: the innermost line of the plugin's file that was running, and the message."""
    if isinstance(error, SyntaxError) and error.lineno:
        return f"plugin {file}, line {error.lineno}: {type(error).__name__}: {error.msg}"
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(file)]
    where = f", line {lines[-1]}" if lines else ""
    return f"plugin {file}{where}: {type(error).__name__}: {one_line(error)}"
