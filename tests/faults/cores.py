"""Cores: the same bytes on one core and on two, under any seed of Python's hashes, from any folder."""

import os
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path

from tests.faults.attack import Case, Result, Test, Verdict, skip
from tests.faults.command import deepgps
from tests.faults.fingerprint import differences, take
from tests.faults.material import Material, Run, Study


def list_tests(material: Material) -> list[Test | Result]:
    """Whole runs under other circumstances, compared with those of the material, which may use all cores."""
    runs, study = material.runs, material.study
    one = ("taskset", "-c", str(min(os.sched_getaffinity(0))))
    tests: list[Test | Result] = []
    if len(os.sched_getaffinity(0)) < 2 or not shutil.which("taskset"):
        tests = [skip("cores", "one core against all", "needs taskset and two cores")]
    else:
        tests = [Test("cores", f"{kind}: one core", 1, _run(run, before=one)) for kind, run in runs.items()]
        tests.append(Test("cores", "study: one core", 1, _run_study(study, one)))
    threads = {"OMP_NUM_THREADS": "1"}
    many = {"OMP_NUM_THREADS": "3", "OPENBLAS_NUM_THREADS": "2", "MKL_NUM_THREADS": "4"}
    return [
        *tests,
        *(Test("cores", f"{kind}: OMP_NUM_THREADS=1", 1, _run(run, env=threads)) for kind, run in runs.items()),
        Test("cores", "room: more threads than cores", 1, _run(runs["room"], env=many)),
        Test("cores", "landmarks: other hash seed, folder and cwd", 2, _run(runs["landmarks"], elsewhere=True)),
    ]


def _run(
    run: Run, before: tuple[str, ...] = (), env: Mapping[str, str] | None = None, elsewhere: bool = False
) -> Callable[[Case], Verdict]:
    def attempt(case: Case) -> Verdict:
        cwd, out, own = case.folder, "out", dict(env or {})
        if elsewhere:
            cwd, out = case.folder / "an other", "../é 空/out"
            cwd.mkdir()
            own["PYTHONHASHSEED"] = str(case.rng.randint(1, 10**6))
        return _compare(run.clean, cwd / out, deepgps("run", run.source, "--out", out, cwd=cwd, env=own, before=before))

    return attempt


def _run_study(study: Study, before: tuple[str, ...]) -> Callable[[Case], Verdict]:
    def attempt(case: Case) -> Verdict:
        ended = deepgps("study", str(study.source), "--out", "out", cwd=case.folder, before=before)
        return _compare(study.clean, case.folder / "out", ended)

    return attempt


def _compare(clean, folder: Path, ended) -> Verdict:
    if ended.fell or ended.code:
        return Verdict(ended.fell or f"refused with {ended.code}", False, ended.show())
    if wrong := differences(clean, take(folder)):
        return Verdict("other bytes", False, f"{len(wrong)} differ, as {', '.join(wrong[:5])}: {ended.show()}")
    return Verdict("the same bytes", True)
