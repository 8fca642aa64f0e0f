"""What an attack is: tests of many tries each, every try drawn from its own random numbers, and what became of them."""

import random
import shutil
import time
import traceback
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

LANES = 2
EXAMPLES = 3
"""Failures of a test that are kept with all their details."""


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
        fixed: Whether the tries are a list, each made once at least.
        lanes: How many tries may run at once.
    """

    family: str
    name: str
    tries: int
    attempt: Callable[[Case], Verdict]
    fixed: bool = False
    lanes: int = LANES


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


def carry_out(test: Test, seed: int, scale: float, place: Path, only: int | None, say: Callable[[str], None]) -> Result:
    """Make all tries of a test.

    Args:
        test: What to try.
        seed: Of all random numbers.
        scale: How many times the default number of tries.
        place: Where the tries' folders are made.
        only: Make this try alone; none: all.
        say: Told each failure and the sum.
    """
    count = test.tries * max(1, round(scale)) if test.fixed else max(1, round(test.tries * scale))
    numbers = [only] if only is not None else list(range(count))
    result, start = Result(test.family, test.name), time.monotonic()

    def attempt(number: int) -> tuple[int, Verdict]:
        folder = place / f"{test.family}-{number}-{random.SystemRandom().randrange(10**9)}"
        folder.mkdir(parents=True)
        rng = random.Random(f"{seed} {test.family} {test.name} {number}")
        try:
            return number, test.attempt(Case(number, rng, folder))
        except Exception:  # one broken try must not end the attack
            return number, Verdict("the attack itself failed", False, traceback.format_exc())
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    with ThreadPoolExecutor(test.lanes) as lanes:
        for number, verdict in lanes.map(attempt, numbers):
            result.add(number, verdict)
            if not verdict.held:
                say(f"  {test.family}, {test.name}, try {number}: {verdict.kind}: {verdict.detail}")
    say(f"{test.family}, {test.name}: {describe(result)} ({time.monotonic() - start:.0f} s)")
    return result


def describe(result: Result) -> str:
    """One result in a few words."""
    if result.skipped:
        return result.skipped
    kinds = ", ".join(f"{count} {kind}" for kind, count in result.kinds.most_common())
    return f"{result.held} of {result.tries} held: {kinds}"


def tabulate(results: Sequence[Result]) -> str:
    """The table in Markdown."""
    lines = ["| family | what was tried | tries | held | what happened |", "|---|---|--:|--:|---|"]
    for one in results:
        what = one.skipped or ", ".join(f"{count} {kind}" for kind, count in one.kinds.most_common())
        lines.append(f"| {one.family} | {one.test} | {one.tries} | {one.held} | {what} |")
    tries, held = sum(one.tries for one in results), sum(one.held for one in results)
    return "\n".join([*lines, f"| | in all | {tries} | {held} | |"])
