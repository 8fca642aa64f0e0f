"""Seconds that each stage of a run took, summed over all sittings."""

import logging
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sim.errors import DamagedError
from sim.files.checksums import read_json, write_json

TIMED = ("collect", "train", "evaluate")
"""The stages whose seconds ``metrics.json`` holds."""

log = logging.getLogger(__name__)


@contextmanager
def timed(folder: Path, stage: str, done: bool = False) -> Iterator[None]:
    """Add the seconds of a stage, or of the part before it was interrupted, to the run's ``timing.json`` and its log,
    unless the stage was already done."""
    start = time.perf_counter()
    try:
        yield
    finally:
        if not done:
            _add_time(folder, stage, time.perf_counter() - start)


def stage_times(folder: Path) -> dict[str, float]:
    """Seconds of collecting, training and evaluating, without work done elsewhere, such as a study's recordings."""
    times = _read_times(folder)
    parts = {name: [times[one] for one in times if one.partition(" ")[0] == name] for name in TIMED}
    return {name: round(sum(seconds), 2) for name, seconds in parts.items() if seconds}


def _read_times(folder: Path) -> dict[str, float]:
    """Seconds of a run's stages so far."""
    path = folder / "timing.json"
    try:
        return read_json(path) if path.is_file() else {}
    except DamagedError as error:
        log.warning("%s; seconds are counted from zero", error)
        return {}


def _add_time(folder: Path, stage: str, seconds: float) -> None:
    path = folder / "timing.json"
    times = _read_times(folder)
    write_json(path, {**times, stage: round(times.get(stage, 0.0) + seconds, 2)})
    with (folder / "log.txt").open("a", encoding="utf-8") as file:
        file.write(f"{time.strftime('%Y-%m-%d %H:%M:%S')} {stage}: {seconds:.1f} s\n")
