"""What an attack is: tests of many tries each, every try drawn from its own random numbers, and what became of them."""

import os
import platform
import random
import shutil
import subprocess
import traceback
import uuid
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
LANES = 2
EXAMPLES = 3
"""Failures of a test that are kept with all their details."""
HEAD = """# Attempts to break it

`make faults` attacks the testbed from outside, through its commands alone: it plants files of a user's, flips bits,
fills disks, kills processes, feeds hostile files, and counts how often what should hold did hold. Every draw follows
from a seed; without `--seed` each run draws new cases. `.venv/bin/python -m tests.faults --help` shows how to run a
part of it, how to make it longer, and how to see one failure again.
"""


@dataclass(frozen=True)
class Case:
    """One try of a test.

    Attributes:
        number: Which try it is.
        rng: Its own random numbers, which depend on the seed, the test and the number alone.
        folder: An empty folder of its own, removed afterwards.
    """

    number: int
    rng: random.Random
    folder: Path


@dataclass(frozen=True)
class Verdict:
    """What became of one try.

    Attributes:
        kind: In a word or two, as ``refused`` or ``silent``; the table counts these.
        held: Whether the product did what it should.
        detail: All that it takes to see a failure again: command, file, bit, what was said.
    """

    kind: str
    held: bool
    detail: str = ""


@dataclass(frozen=True)
class Test:
    """One test of a family.

    Attributes:
        family: The family's name, as ``--only`` takes it.
        name: What is tried, in the words of the table.
        tries: How often, at the default size.
        attempt: Makes one try.
        of: How many kinds of try there are, by their number; none: each is drawn alike.
    """

    family: str
    name: str
    tries: int
    attempt: Callable[[Case], Verdict]
    of: int = 0


@dataclass
class Result:
    """What became of all tries of a test; ``skipped`` says why there are none."""

    family: str
    test: str
    tries: int = 0
    held: int = 0
    kinds: Counter[str] = field(default_factory=Counter)
    examples: list[str] = field(default_factory=list)
    skipped: str = ""

    def add(self, number: int, verdict: Verdict) -> None:
        """Count one try."""
        self.tries += 1
        self.held += verdict.held
        self.kinds[verdict.kind] += 1
        if not verdict.held and len(self.examples) < EXAMPLES:
            self.examples.append(f"try {number}, {verdict.kind}: {verdict.detail}")


def skip(family: str, test: str, why: str) -> Result:
    """The result of a test that this machine cannot make."""
    return Result(family, test, skipped=f"not tried: {why}")


def carry_out(
    tests: Sequence[Test], seed: int, scale: float, place: Path, only: int | None, say: Callable[[str], None]
) -> list[Result]:
    """Make all tries of some tests, two at once.

    Args:
        tests: What to try.
        seed: Of all random numbers.
        scale: How many times the default number of tries.
        place: Where the tries' folders are made.
        only: Make this try alone; none: all.
        say: Told each failure, and each test that is done.
    """
    results = {test: Result(test.family, test.name) for test in tests}
    jobs = [(test, number) for test in tests for number in _choose(test, seed, scale, only)]
    waiting = Counter(test for test, _ in jobs)
    with ThreadPoolExecutor(LANES) as pool:
        verdicts = pool.map(lambda job: _try(job[0], job[1], seed, place), jobs)
        for (test, number), verdict in zip(jobs, verdicts, strict=True):
            results[test].add(number, verdict)
            waiting[test] -= 1
            if not verdict.held:
                say(f"  {test.family}, {test.name}, try {number}: {verdict.kind}: {verdict.detail}")
            if not waiting[test]:
                say(f"{test.family}, {test.name}: {describe(results[test])}")
    return list(results.values())


def _choose(test: Test, seed: int, scale: float, only: int | None) -> list[int]:
    """Numbers of the tries to make; of kinds that are more than the tries, some drawn by chance."""
    if only is not None:
        return [only]
    count = max(1, round(test.tries * scale))
    if count >= test.of:
        return list(range(count))
    return sorted(random.Random(f"{seed} {test.family} {test.name}").sample(range(test.of), count))


def _try(test: Test, number: int, seed: int, place: Path) -> Verdict:
    folder = place / f"{test.family}-{uuid.uuid4().hex[:8]}"
    folder.mkdir(parents=True)
    try:
        return test.attempt(Case(number, random.Random(f"{seed} {test.family} {test.name} {number}"), folder))
    except Exception:  # one broken try must not end the attack
        return Verdict("the attack itself failed", False, traceback.format_exc())
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def describe(result: Result) -> str:
    """One result in a few words."""
    kinds = ", ".join(f"{count} {kind}" for kind, count in result.kinds.most_common())
    return result.skipped or f"{result.held} of {result.tries} held: {kinds}"


def write_page(results: Sequence[Result], seed: int, seconds: float) -> str:
    """The page of the documentation, in Markdown.

    Args:
        results: Of all tests.
        seed: Of all draws.
        seconds: How long it took.
    """
    commit = subprocess.run(
        ["git", "-C", str(REPOSITORY), "describe", "--always", "--dirty"], capture_output=True, text=True, check=False
    ).stdout.strip()
    machine = f"{len(os.sched_getaffinity(0))} cores of {platform.machine()}, {platform.system()}"
    made = f"Made on {datetime.now(UTC):%Y-%m-%d}, commit {commit or 'unknown'}, seed {seed}"
    made += f", in {seconds / 60:.0f} minutes on {machine}, Python {platform.python_version()}."
    lines = ["| family | what was tried | tries | held | what happened |", "|---|---|--:|--:|---|"]
    for one in results:
        what = one.skipped or ", ".join(f"{count} {kind}" for kind, count in one.kinds.most_common())
        lines.append(f"| {one.family} | {one.test} | {one.tries} | {one.held} | {what} |")
    lines.append(f"| | in all | {sum(one.tries for one in results)} | {sum(one.held for one in results)} | |")
    fallen = [f"- {one.family}, {one.test}: {example[:700]}" for one in results for example in one.examples]
    return (
        "\n\n".join([HEAD.strip(), made, "\n".join(lines), *(["## What failed", "\n".join(fallen)] if fallen else [])])
        + "\n"
    )
