"""Users: whatever the command line, right or wrong, every byte of the user's own files is there afterwards."""

import os
import random
from pathlib import Path

from tests.faults.attack import Case, Test, Verdict
from tests.faults.command import Ended, deepgps
from tests.faults.material import Material
from tests.faults.tree import find_lost, look, plant

SCENARIOS = ("run", "collect", "train", "evaluate")
FAULTS = (
    (),
    (),
    ("--drive.samples", "many"),
    ("--drive.sample", "3"),
    ("--room.mjcf", "typo.xml"),
    ("--world", "room", "--room.mjcf", "wrong.xml"),
    ("--methods", "deepgps", "nothing"),
    ("--grid.spacing_m", "50"),
    ("--learn.train.device", "cuda:7"),
    ("--seed",),
    ("--live", "nonsense"),
)
WRONG_ROOM = "<mujoco><worldbody><geom type='box' size='1 1'/></worldbody></mujoco>"
TIME_S = 60.0


def list_tests(material: Material) -> list[Test]:
    """Any command line at any tree."""
    return [
        Test("users", "any command at a tree of a user's files", 60, _attack(material)),
    ]


def _attack(material: Material):
    own = [path.relative_to(folder).as_posix() for folder in _finished(material) for path in folder.rglob("*")]

    def attempt(case: Case) -> Verdict:
        home = case.folder / "home"
        for folder in (case.folder / "outside", home, home / "project"):
            plant(folder, case.rng, own)
        (home / "inside").symlink_to("project")
        (home / "project" / "wrong.xml").write_text(WRONG_ROOM)
        for name, source in (("scenario.yaml", material.other.source), ("study.yaml", str(material.study.source))):
            path = home / "project" / name
            if case.rng.random() < 0.5 and not os.path.lexists(path):
                path.write_bytes(Path(source).read_bytes())
        before = look(case.folder)
        cwd = case.rng.choice([home, home / "project", case.folder])
        return judge(before, case.folder, deepgps(*_draw_words(material, home, cwd, case.rng), cwd=cwd, time_s=TIME_S))

    return attempt


def judge(before: dict[str, str], home: Path, ended: Ended) -> Verdict:
    """Whether all files of the user's survived a command, and how it ended."""
    if lost := find_lost(before, home):
        return Verdict("lost a file", False, f"{'; '.join(lost[:8])}: {ended.show()}")
    if ended.fell:
        return Verdict(ended.fell, False, ended.show())
    if ended.code and len(ended.complaints) != 1:
        return Verdict(f"refused in {len(ended.complaints)} lines", False, ended.show())
    return Verdict("done, all there" if ended.code == 0 else "refused, all there", True)


def _draw_words(material: Material, home: Path, cwd: Path, rng: random.Random) -> list[str]:
    """A command line, right or wrong, that ends within seconds and has to do with the folder ``home``."""
    out = _draw_place(home, cwd, rng)
    command = rng.choice([*SCENARIOS, "collect", "collect", "study", "rooms", "view"])
    fresh = ["--fresh"] if rng.random() < 0.6 else []
    if command == "study":
        fault = rng.choice([[], ["--tiny"], ["--full"], ["--engine", "slurm"]])
        source = rng.choice(["nosuch.yaml", "scenario.yaml", str(home / "project" / "study.yaml")])
        return ["study", source, "--out", out, *fresh, *fault, "--publish", _draw_place(home, cwd, rng)]
    if command == "rooms":
        return ["rooms", "--kinds", rng.choice(["cellar", "office"]), "--seeds", "x", "--out", out]
    if command == "view":
        return ["view", out, *rng.choice([[], ["--web", "--port", "0"], [_draw_place(home, cwd, rng)]])]
    right = material.runs["landmarks"].source
    source = rng.choice([right, right, right, "scenario.yaml", str(home / "project" / "scenario.yaml"), "nosuch"])
    return [command, source, "--out", out, *fresh, *rng.choice(FAULTS)]


def _draw_place(home: Path, cwd: Path, rng: random.Random) -> str:
    """A place at, in, beside or above the user's files, absolute or seen from ``cwd``."""
    there = [path for path in home.rglob("*")]
    fixed = [home, home / "project", home / "inside", home / "new", home / "project" / "new" / "er", home.parent]
    place = rng.choice([*fixed, *[home / "project"] * 3, rng.choice(there)])
    return str(place) if rng.random() < 0.5 else os.path.relpath(place, cwd)


def _finished(material: Material) -> list[Path]:
    return [material.runs["landmarks"].stages["finished"], material.study.folder]
