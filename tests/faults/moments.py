"""Moments of a command's work, as far on as it is and not by the clock, which tells nothing on a busy machine."""

import random
import time
from pathlib import Path

from tests.faults.command import Running, has_ended

MAX_WAIT_S = 120.0
PACE_S = 0.01


def wait_for_moment(
    running: Running, place: Path, clean: dict[str, str], rng: random.Random, early: float = 0.1
) -> str:
    """Wait until a command has come to a moment drawn by chance, or has ended; returns which moment that was.

    Args:
        running: The command.
        place: All that it writes is below this folder.
        clean: The names of what it writes in the end.
        rng: Draws a file, which then has just been written, and a bit of time.
        early: How often it is a moment of the first seconds instead.
    """
    names = sorted({name.partition(":")[0] for name in clean})
    name = "" if rng.random() < early else rng.choice(names)
    more = rng.uniform(0.0, 2.0 if rng.random() < 0.2 else 0.3)
    begun = time.time() - (time.monotonic() - running.started)
    end = time.monotonic() + MAX_WAIT_S
    while name and not _is_there(place, name, begun) and not has_ended(running) and time.monotonic() < end:
        time.sleep(PACE_S)
    more = more if name else 10 * more
    time.sleep(more)
    return f"{more:.2f} s after {name or 'the start'}"


def _is_there(place: Path, name: str, since: float) -> bool:
    """Whether a file of this name was written below a folder since then, whatever folder it is built in."""
    own = Path(name)
    for path in place.rglob(own.name):
        try:
            if path.parent.name == (own.parent.name or path.parent.name) and path.stat().st_mtime >= since:
                return True
        except OSError:  # it has just been moved
            continue
    return False
