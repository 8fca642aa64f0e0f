"""What an attack is: tests of many tries each, every try drawn from its own random numbers, and what became of them."""

import random
import shutil
import traceback
import uuid
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
        of: How many kinds of try there are, by their number; none: each is drawn alike.
        alone: Whether nothing else may run beside a try, because it takes times.
    """

    family: str
    name: str
    tries: int
    attempt: Callable[[Case], Verdict]
    of: int = 0
    alone: bool = False


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
    """Make all tries of some tests, two at once but for those that want to be alone.

    Args:
        tests: What to try.
        seed: Of all random numbers.
        scale: How many times the default number of tries.
        place: Where the tries' folders are made.
        only: Make this try alone; none: all.
        say: Told each failure, and each test that is done.
    """
    results = {test: Result(test.family, test.name) for test in tests}
    for lanes in (LANES, 1):
        jobs = [(test, n) for test in tests if test.alone == (lanes == 1) for n in _choose(test, seed, scale, only)]
        waiting = Counter(test for test, _ in jobs)
        with ThreadPoolExecutor(lanes) as pool:
            for (test, number), verdict in zip(
                jobs, pool.map(lambda job: _try(job[0], job[1], seed, place), jobs), strict=True
            ):
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
