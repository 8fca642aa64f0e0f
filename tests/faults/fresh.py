"""Fresh: a run made anew over an old one keeps the user's files, and the old run is whole until the new one is."""

import os
import random
from pathlib import Path

from tests.faults.attack import Case, Test, Verdict
from tests.faults.command import Ended, Running, deepgps, finish, kill, kill_all, start
from tests.faults.fingerprint import Print, differences, take
from tests.faults.material import Material, Run, copy
from tests.faults.moments import wait_for_moment
from tests.faults.tree import Looks, find_lost, look

DATA = (
    *("thesis.txt", "recording/mine.npy", "deepgps/notes.md", "figures/mine.png", "notes.123.part", "movie.part"),
    *("own/deeper/data.bin", "recording/truth/remark.txt", "leer zeichen 空.txt", "metrics.json.bak"),
)


def list_tests(material: Material) -> list[Test]:
    """What a run made anew may do to what was there."""
    old, new = material.runs["landmarks"], material.other
    return [
        Test("fresh", "killed at any moment, looked at, given again", 7, _attack_killed(old, new)),
    ]


def plant_in_run(folder: Path, rng: random.Random) -> Looks:
    """Put files of a user's own into a run, among its files; returns how they look."""
    for name in rng.sample(DATA, rng.randint(1, 6)):
        path = folder / name
        if not os.path.lexists(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(rng.randbytes(rng.randint(0, 3000)))
    if rng.random() < 0.4:
        (folder / "link").symlink_to(rng.choice(["thesis.txt", "..", "nowhere"]))
    return {name: how for name, how in look(folder).items() if name in DATA or name in {"link", "own", "own/deeper"}}


def _attack_killed(old: Run, new: Run):
    def attempt(case: Case) -> Verdict:
        folder = copy(old.stages["finished"], case.folder / "run")
        mine = plant_in_run(folder, case.rng)
        running = start(["run", new.source, "--out", "run", "--fresh"], cwd=case.folder)
        moment = wait_for_moment(running, case.folder, new.clean, case.rng)
        _end(running)
        state = _tell_state(folder, old, new)
        if state == "between":  # healed by the next command, if it is
            deepgps("evaluate", old.source, "--out", "run", cwd=case.folder)
            state = _tell_state(folder, old, new)
        if lost := find_lost(mine, folder):
            return Verdict("lost a file", False, f"killed {moment}: {'; '.join(lost[:5])}")
        if state == "between":
            wrong = differences(old.clean, take(folder))
            told = f"killed {moment}, of {len(old.clean)} differ {len(wrong)}, as {', '.join(wrong[:4])}"
            return Verdict("old run lost before the new one was whole", False, told)
        ended = deepgps("run", new.source, "--out", "run", "--fresh", cwd=case.folder)
        verdict = _judge_done(ended, folder, mine, new.clean)
        return Verdict(f"{state} run whole, then {verdict.kind}", verdict.held, f"killed {moment}; {verdict.detail}")

    return attempt


def _end(running: Running) -> Ended:
    kill(running)
    kill_all(running)
    return finish(running)


def _tell_state(folder: Path, old: Run, new: Run) -> str:
    """Which run the folder holds whole: the old one, the new one, or neither."""
    found = take(folder)
    for name, run in (("old", old), ("new", new)):
        if not differences(run.clean, found):
            return name
    return "between"


def _judge_done(ended: Ended, folder: Path, mine: Looks, expected: Print) -> Verdict:
    if lost := find_lost(mine, folder):
        return Verdict("lost a file", False, f"{'; '.join(lost[:5])}: {ended.show()}")
    if ended.fell or ended.code:
        return Verdict(ended.fell or f"refused with {ended.code}", False, ended.show())
    if wrong := differences(expected, take(folder)):
        return Verdict("another result", False, f"{', '.join(wrong[:6])}: {ended.show()}")
    if parts := [path for path in folder.rglob("*.part") if path.name not in DATA]:
        return Verdict("left a .part file", False, f"{parts[0]}: {ended.show()}")
    return Verdict("done, same as a clean run", True)
