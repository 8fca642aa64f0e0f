"""Measure how long set-up, runs and tests take on this machine, and print the table that the README quotes.

Usage: python docs/times.py [COMMAND ...], some of set-up, demo, tiny and test, by default all. Everything runs in
temporary folders of ``runs/``; set-up means a new clone.
"""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from deepgps.reports.table import tabulate
from deepgps.runs.provenance import describe_origin
from sim.processes import usable_cores

ROOT = Path(__file__).parents[1]
SLOWEST_OVER_FASTEST = 3.0
"""One training step on the slowest machine that we measured over one on the fastest; it scales the other column."""
COLUMNS = ("a fast laptop", "a slow two-core machine")
RUN = (sys.executable, "-m", "deepgps.commands.main", "run")
COMMANDS = {
    "set-up": ("set-up of a new clone", (".ci/setup",)),
    "demo": ("`make demo` after it", (*RUN, "demo", "--out", "{folder}/demo")),
    "tiny": ("`deepgps run tiny`", (*RUN, "tiny", "--out", "{folder}/tiny")),
    "test": ("`make test` after set-up", ("make", "test")),
}
"""What is timed: its name in the table, and its command."""


def measure(name: str, folder: Path) -> float:
    """Seconds of a command of ``COMMANDS``; set-up works in a clone of the repository in the folder."""
    place = ROOT
    if name == "set-up":
        place = folder / "clone"
        subprocess.run(["git", "clone", "-q", str(ROOT), str(place)], check=True)
    words = [word.format(folder=folder) for word in COMMANDS[name][1]]
    environment = {**os.environ, "PYTHONPATH": str(place)}
    start = time.perf_counter()
    subprocess.run(words, cwd=place, env=environment, check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - start


def list_rows(seconds: dict[str, float], slow: bool) -> Iterator[tuple[str, str, str]]:
    """A row for each command: on a fast machine and on a slow one, of which one was measured."""
    for name, measured in seconds.items():
        fast = measured / SLOWEST_OVER_FASTEST if slow else measured
        yield COMMANDS[name][0], say(fast), say(fast * SLOWEST_OVER_FASTEST)


def say(seconds: float) -> str:
    """Seconds to ten, or minutes."""
    return f"{max(10 * round(seconds / 10), 10)} s" if seconds < 95 else f"{round(seconds / 60)} min"


def main() -> None:
    """Measure, and print the table and where it comes from."""
    slow = usable_cores() <= 2
    (ROOT / "runs").mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory(dir=ROOT / "runs", prefix="times-") as folder:
        seconds = dict[str, float]()
        for name in sys.argv[1:] or COMMANDS:
            seconds[name] = measure(name, Path(folder))
            print(f"{COMMANDS[name][0]}: {seconds[name]:.0f} s", file=sys.stderr, flush=True)
    print(tabulate(("", *COLUMNS), [*list_rows(seconds, slow)]))
    print(
        f"\n{describe_origin([])} Measured: {COLUMNS[slow]}; the other column is that "
        f"{'over' if slow else 'times'} {SLOWEST_OVER_FASTEST:.0f}, a training step on the slowest machine that we "
        "measured over one on the fastest."
    )


if __name__ == "__main__":
    main()
