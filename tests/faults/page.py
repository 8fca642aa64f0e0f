"""The page of the docs: what was tried, when, on what, and the table."""

import os
import platform
import subprocess
from collections.abc import Sequence
from datetime import UTC, datetime

from tests.faults.attack import Result, tabulate
from tests.faults.command import REPOSITORY

LONGEST = 700
HEAD = """# Attempts to break it

`make faults` attacks the testbed from outside, through its commands alone: it plants files of a user's, flips bits,
fills disks, kills processes, feeds hostile files, and counts how often what should hold did hold. Every draw follows
from a seed; without `--seed` each run draws new cases. `.venv/bin/python -m tests.faults --help` shows how to run a
part of it, how to make it longer, and how to see one failure again.
"""


def write_page(results: Sequence[Result], seed: int, seconds: float) -> str:
    """The page in Markdown.

    Args:
        results: Of all tests.
        seed: Of all draws.
        seconds: How long it took.
    """
    made = f"Made on {datetime.now(UTC):%Y-%m-%d}, commit {_commit()}, seed {seed}"
    blocks = [HEAD.strip(), f"{made}, in {seconds / 60:.0f} minutes on {_machine()}.", tabulate(results)]
    fallen = [f"- {one.family}, {one.test}: {example[:LONGEST]}" for one in results for example in one.examples]
    return "\n\n".join([*blocks, *(["## What failed", "\n".join(fallen)] if fallen else [])]) + "\n"


def _commit() -> str:
    command = ["git", "-C", str(REPOSITORY), "describe", "--always", "--dirty"]
    return subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip() or "unknown"


def _machine() -> str:
    cores = len(os.sched_getaffinity(0))
    return f"{cores} cores of {platform.machine()}, {platform.system()}, Python {platform.python_version()}"
