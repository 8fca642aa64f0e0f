"""Bits: one bit, twenty, or an end of a file is lost between two stages: noticed, healed, without effect, or silent?"""

import os
import random
from pathlib import Path

from tests.faults.attack import Case, Test, Verdict
from tests.faults.command import Ended, deepgps
from tests.faults.fingerprint import Print, differences, figures_printed, take
from tests.faults.material import STAGES, Material, Run, Study, copy

TRIES = {"collecting": 5, "collected": 5, "training": 5, "trained": 9, "evaluated": 4, "finished": 8}
READ = """
import sys
import deepgps
from sim.errors import InputError, WorkError
try:
    run = deepgps.load(sys.argv[1])
    print([run.errors(method).to_pydict() for method in run.methods], run.report())
except (InputError, WorkError, OSError) as error:
    sys.exit(f"failed: {error}")
"""
"""What a script reads of a run, its error fields among them."""


def list_tests(material: Material) -> list[Test]:
    """Every kind of run at every stage, what a script reads of it, and a finished study."""
    tests = []
    for kind, run in material.runs.items():
        for stage in run.stages:
            tests.append(Test("bits", f"{kind}, {stage}, then {STAGES[stage]}", TRIES[stage], _attack_run(run, stage)))
        read = _read(run.stages["finished"]).out
        tests.append(Test("bits", f"{kind}, finished, then read by a script", 4, _attack_reader(run, read)))
    return [*tests, Test("bits", "study, finished, then study", 6, _attack_study(material.study))]


def damage(folder: Path, rng: random.Random) -> tuple[str, str, bytes]:
    """Flip one bit or twenty, or cut, in a file drawn by chance; returns its name, what was done, what it holds now."""
    files = sorted(
        path for path in folder.rglob("*") if path.is_file() and not path.is_symlink() and path.stat().st_size
    )
    path = rng.choice(files)
    data, before = bytearray(path.read_bytes()), path.stat()
    how = rng.choices(["1 bit", "20 bits", "cut to nothing", "cut in half", "last byte cut"], [60, 15, 8, 8, 9])[0]
    if how.endswith(("bit", "bits")):
        places = sorted(rng.randrange(8 * len(data)) for _ in range(int(how.split()[0])))
        for place in places:
            data[place // 8] ^= 1 << place % 8
        how = f"{how} flipped at {places}"
    else:
        del data[{"cut to nothing": 0, "cut in half": len(data) // 2, "last byte cut": len(data) - 1}[how] :]
    path.write_bytes(data)
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))  # what rots does not tell when
    return path.relative_to(folder).as_posix(), how, bytes(data)


def judge(ended: Ended, name: str, how: str, wrong: list[str]) -> Verdict:
    """Tell what became of a damage.

    Args:
        ended: The command after it.
        name: The damaged file.
        how: What was done to it.
        wrong: Names at which the result differs from a clean one, the damaged file itself left out.
    """
    detail = f"{name}, {how}; {ended.show()}"
    if ended.fell:
        return Verdict(ended.fell, False, detail)
    if ended.code:
        if len(ended.problems) != 1:
            return Verdict(f"refused in {len(ended.problems)} lines", False, detail)
        named = names(ended.problems[0], name)
        return Verdict("refused", True) if named else Verdict("refused without its name", False, detail)
    noticed = any(names(line, name) for line in ended.err.splitlines())
    if wrong:
        kind = "said, but the result differs" if noticed else "silent"
        return Verdict(kind, False, f"{detail}; differs at {', '.join(wrong[:6])}")
    return Verdict("healed" if noticed else "without effect", True)


def names(line: str, name: str) -> bool:
    """Whether a line names the file, or at least the folder that it lies in."""
    path = Path(name)
    return path.name in line or (path.parent != Path() and f"/{path.parent.as_posix()}" in line)


def left_out(folder: Path, name: str, damaged: bytes) -> frozenset[str]:
    """The damaged file, where nothing has replaced it: that it differs is the damage, not its effect."""
    path = folder / name
    return frozenset({name}) if path.is_file() and path.read_bytes() == damaged else frozenset()


def _attack_run(run: Run, stage: str):
    def attempt(case: Case) -> Verdict:
        folder = copy(run.stages[stage], case.folder / "run")
        name, how, damaged = damage(folder, case.rng)
        ended = deepgps(STAGES[stage], run.source, "--out", "run", cwd=case.folder)
        wrong = _compare(folder, run.after(STAGES[stage]), name, damaged)
        if STAGES[stage] == "run" and ended.code == 0 and figures_printed(ended.out) != run.printed:
            wrong.append("what is printed")
        return judge(ended, name, how, wrong)

    return attempt


def _attack_reader(run: Run, read: str):
    def attempt(case: Case) -> Verdict:
        folder = copy(run.stages["finished"], case.folder / "run")
        name, how, damaged = damage(folder, case.rng)
        ended = _read(folder)
        wrong = _compare(folder, run.clean, name, damaged)
        return judge(ended, name, how, wrong if ended.out == read else [*wrong, "what is read"])

    return attempt


def _attack_study(study: Study):
    def attempt(case: Case) -> Verdict:
        folder = copy(study.folder, case.folder / "study")
        name, how, damaged = damage(folder, case.rng)
        ended = deepgps("study", str(study.source), "--out", "study", cwd=case.folder)
        return judge(ended, name, how, _compare(folder, study.clean, name, damaged))

    return attempt


def _compare(folder: Path, expected: Print, name: str, damaged: bytes) -> list[str]:
    return differences(expected, take(folder), left_out(folder, name, damaged))


def _read(folder: Path) -> Ended:
    return deepgps("-c", READ, str(folder), cwd=folder.parent)
