"""``python -m tests.faults``: attack, print what fell, and write the table."""

import argparse
import random
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from tests.faults import bits, bombs, disk, fresh, kills, users
from tests.faults.attack import Result, Test, carry_out, write_page
from tests.faults.command import end_all
from tests.faults.material import Material, make_material

SCALES = {"quick": 0.2, "full": 5.0}
ON_RUNS: dict[str, Callable[[Material], Sequence[Test | Result]]] = {
    "users": users.list_tests,
    "fresh": fresh.list_tests,
    "bits": bits.list_tests,
    "disk": disk.list_tests,
    "kills": kills.list_tests,
}
"""Families that break runs which are made first."""
FAMILIES = (*ON_RUNS, "bombs")


def main() -> int:
    """Attack; returns 1 where something fell."""
    arguments = parse(sys.argv[1:])
    seed = random.SystemRandom().randrange(10**6) if arguments.seed is None else arguments.seed
    say(f"seed {seed}: the same tries come again with --seed {seed}")
    for ending in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(ending, stop)
    place = Path(tempfile.mkdtemp(prefix="faults-"))
    tempfile.tempdir = str(place)
    start = time.monotonic()
    try:
        results = list(attack(arguments, seed, place))
    finally:
        shutil.rmtree(place, ignore_errors=True)
    page = write_page(results, seed, time.monotonic() - start)
    if arguments.out:
        arguments.out.write_text(page, encoding="utf-8")
    print(page)
    return int(any(one.held < one.tries for one in results))


def stop(number: int, frame: object) -> None:
    """End this attack and all that it started."""
    for ending in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(ending, signal.SIG_IGN)  # what is under way tidies up
    end_all()
    sys.exit(128 + number)


def attack(arguments: argparse.Namespace, seed: int, place: Path) -> Iterator[Result]:
    """Every test of the families asked for, one family after another."""
    material = make_material(place / "material", say) if set(ON_RUNS) & set(arguments.only) else None
    scale = SCALES["quick"] if arguments.quick else SCALES["full"] if arguments.full else 1.0
    for family in arguments.only:
        start = time.monotonic()
        listed = ON_RUNS[family](material) if material and family in ON_RUNS else bombs.list_tests()
        skipped = [one for one in listed if isinstance(one, Result)]
        tests = [one for one in listed if isinstance(one, Test) and arguments.test in one.name]
        yield from carry_out(tests, seed, scale, place / family, arguments.number, say)
        yield from skipped
        say(f"{family} took {time.monotonic() - start:.0f} s")


def parse(words: Sequence[str]) -> argparse.Namespace:
    """The arguments."""
    parser = argparse.ArgumentParser(prog="python -m tests.faults", description=__doc__)
    parser.add_argument("--seed", type=int, help="of every draw; none: a new one each time, which is printed")
    parser.add_argument("--only", type=names, default=list(FAMILIES), help=f"of {','.join(FAMILIES)}")
    parser.add_argument("--test", default="", help="only tests with this in their name")
    parser.add_argument("--number", type=int, help="only this try of each test, to see a failure again")
    parser.add_argument("--quick", action="store_true", help="a fifth of the tries")
    parser.add_argument("--full", action="store_true", help="five times as many tries")
    parser.add_argument("--out", type=Path, help="file for the table")
    return parser.parse_args(words)


def names(text: str) -> list[str]:
    """Names of families; argparse tells of one that does not exist."""
    found = text.split(",")
    if wrong := [name for name in found if name not in FAMILIES]:
        raise argparse.ArgumentTypeError(f"{wrong[0]!r} does not exist; there are {', '.join(FAMILIES)}")
    return found


def say(text: str) -> None:
    """One line of progress."""
    print(text, flush=True)


if __name__ == "__main__":
    sys.exit(main())
