"""Bombs: small hostile files are refused in one line before they cost time or memory; large honest ones are taken."""

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.faults import bombs_honest
from tests.faults.attack import Case, Test, Verdict
from tests.faults.bombs_honest import SMALL
from tests.faults.bombs_mjcf import ROOMS, room, save
from tests.faults.bombs_yaml import SCENARIOS, STUDIES, Make
from tests.faults.command import Ended, deepgps

TIME_S = 12.0
MEMORY_MB = 2_200.0
GIVEN_UP_S = 90.0
"""A command that takes so long is ended: it fell."""
LONGEST = 2_000
"""Characters of one line that one still reads."""


def list_tests() -> list[Test]:
    """Every hostile file once, each drawn anew; then what must not be refused."""
    return [
        Test("bombs", "hostile scenarios", len(SCENARIOS), _attack_yaml("collect", SCENARIOS), of=len(SCENARIOS)),
        Test("bombs", "hostile studies", len(STUDIES), _attack_yaml("study", STUDIES), of=len(STUDIES)),
        Test("bombs", "hostile rooms", len(ROOMS), _attack_room(), of=len(ROOMS)),
        Test("bombs", "a study of 9,999 wrong runs", 1, _attack_long_study),
        *bombs_honest.list_tests(),
    ]


def _attack_yaml(command: str, files: Mapping[str, Make]) -> Callable[[Case], Verdict]:
    start = _start(command, "nosuch.yaml")

    def attempt(case: Case) -> Verdict:
        name = list(files)[case.number % len(files)]
        made = files[name](case.rng)
        (case.folder / "bomb.yaml").write_bytes(
            made if isinstance(made, bytes) else made.encode("utf-8", "surrogatepass")
        )
        return judge(name, _give(command, "bomb.yaml", "--out", "out", cwd=case.folder), start, case.folder)

    return attempt


def _attack_room() -> Callable[[Case], Verdict]:
    words = ["collect", "small.yaml", "--out", "out", "--room.mjcf"]
    refused, taken = _start(*words, "nosuch.xml"), _start(*words, "room.xml")

    def attempt(case: Case) -> Verdict:
        name = list(ROOMS)[case.number % len(ROOMS)]
        ROOMS[name](case.folder, case.rng)
        (case.folder / "small.yaml").write_text(SMALL)
        ended = _give(*words, "room.xml", cwd=case.folder)
        return judge(name, ended, refused if ended.code else taken, case.folder)

    return attempt


def _start(*words: str) -> Ended:
    """The same command on a file that is missing, or on a plain room: what it costs to start."""
    with TemporaryDirectory() as folder:
        (Path(folder) / "small.yaml").write_text(SMALL)
        save(Path(folder), room())
        return deepgps(*words, cwd=Path(folder))


def _attack_long_study(case: Case) -> Verdict:
    """All are wrong, and each could be named: how long until the line, and how long is it?"""
    values = ", ".join(f"w{n}" for n in range(9_999))
    (case.folder / "long.yaml").write_text(f"scenario: tiny\naxes: {{drive.samples: [{values}]}}\n")
    ended = _give("study", "long.yaml", "--out", "out", cwd=case.folder, time_s=60.0)
    return judge("9,999 wrong runs", ended, None, case.folder)


def judge(name: str, ended: Ended, start: Ended | None, folder: Path) -> Verdict:
    """Tell what a hostile file did.

    Args:
        name: What it is.
        ended: The command that read it.
        start: What it costs to start; none: time and memory are not asked.
        folder: Where it ran.
    """
    more_s, more_mb = (0.0, 0.0) if start is None else (ended.cpu_s - start.cpu_s, ended.peak_mb - start.peak_mb)
    detail = f"{name}: {more_s:+.1f} s, {more_mb:+.0f} MB, {ended.said} characters: {ended.show()}"
    lines = ended.complaints
    litter = [name for name in ("MUJOCO_LOG.TXT", "out") if ended.code and os.path.lexists(folder / name)]
    faults = {
        ended.fell: ended.fell,
        "ran code": os.path.lexists(folder / "fallen"),
        f"more than {TIME_S:.0f} s": more_s > TIME_S,
        f"more than {MEMORY_MB:.0f} MB": more_mb > MEMORY_MB,
        f"{len(lines)} lines": ended.code and len(lines) != 1,
        "a line of thousands of characters": ended.said > LONGEST,
        "left litter": litter,
        "one line, but exit 1": ended.code == 1,
    }
    for kind, found in faults.items():
        if found:
            return Verdict(kind, False, detail)
    return Verdict("refused in a line" if ended.code else "taken, at no cost", True)


def _give(*words: str, cwd: Path, time_s: float = GIVEN_UP_S) -> Ended:
    return deepgps(*words, cwd=cwd, time_s=time_s, memory_mb=3000.0)
