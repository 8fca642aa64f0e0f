"""What is broken: small runs of each kind at every stage of their making, and a study, each made twice to know what is
the same every time."""

import shutil
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from tests.faults.command import REPOSITORY, Ended, deepgps, finish, has_ended, kill, kill_all, start
from tests.faults.fingerprint import Print, figures_printed, same_in, take

STEPS = {"learn.train.steps": 300, "learn.train.checkpoint_steps": 50}
SMALL_SETTINGS = {
    "landmarks.segments": 60,
    "drive.samples": 400,
    "drive.spacing_m": 0.05,
    "grid.spacing_m": 0.1,
    "learn.train.segments": 16,
    "learn.train.samples": 8,
    "learn.network.width": 64,
    "learn.features.principal": 128,
    "learn.features.components": 32,
    "learn.fold.restarts": 0,
    **STEPS,
}


METHODS = ["deepgps", "posenet", "knn"]
SCENARIOS = {
    "room": ("tiny", {"drive.samples": 300, **STEPS}),
    "landmarks": ("landmarks", SMALL_SETTINGS),
}
STAGES = {
    "collecting": "evaluate",
    "collected": "evaluate",
    "training": "evaluate",
    "trained": "evaluate",
    "evaluated": "run",
    "finished": "run",
}
"""How far a run is, and the command that does the rest of it."""
STUDY = {
    "scenario": "landmarks.yaml",
    "methods": ["deepgps", "posenet"],
    "axes": {"encoder.step_noise": [0, 0.1]},
    "report": "compare",
}


@dataclass(frozen=True)
class Run:
    """One kind of run at every stage.

    Attributes:
        source: The scenario's file.
        stages: Folder of the run as it was at each stage.
        clean: What a run holds that nothing happened to, as far as it is the same every time.
        printed: What ``deepgps run`` prints of it, without times.
    """

    source: str
    stages: dict[str, Path]
    clean: Print
    printed: list[str]

    def after(self, command: str) -> Print:
        """What a run holds once this command has ended."""
        later = () if command == "run" else ("figures/",)
        return {name: value for name, value in self.clean.items() if not name.startswith(later)}


@dataclass(frozen=True)
class Study:
    """A finished study: its file, its folder, and what is the same every time."""

    source: Path
    folder: Path
    clean: Print


@dataclass(frozen=True)
class Material:
    """All that is broken: runs by their kind, the same with another seed, and a study."""

    runs: dict[str, Run]
    other: Run
    study: Study


def make_material(place: Path, say: Callable[[str], None]) -> Material:
    """Make everything, two at once."""
    start_s = time.monotonic()
    say("making the runs that are to be broken")
    with ThreadPoolExecutor(2) as lanes:
        runs = {kind: lanes.submit(_make_run, kind, place / kind) for kind in SCENARIOS}
        other = lanes.submit(_make_other, place / "other")
        study = lanes.submit(_make_study, place / "study")
        made = Material({kind: job.result() for kind, job in runs.items()}, other.result(), study.result())
    say(f"made: {', '.join(runs)} at {', '.join(STAGES)}, and a study ({time.monotonic() - start_s:.0f} s)")
    return made


def copy(source: Path, target: Path) -> Path:
    """A copy of a folder, links and times as they are."""
    shutil.copytree(source, target, symlinks=True)
    return target


def write_scenario(kind: str, folder: Path, **changes: Any) -> str:
    """Write the scenario of a kind of run to a folder; returns the path of its file."""
    base, settings = SCENARIOS[kind]
    values = yaml.safe_load((REPOSITORY / "assets" / "scenarios" / f"{base}.yaml").read_text())
    for name, value in {"methods": METHODS, **settings, **changes}.items():
        *groups, last = name.split(".")
        inner = values
        for group in groups:
            inner = inner.setdefault(group, {})
        inner[last] = value
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{kind}.yaml"
    path.write_text(yaml.safe_dump(values))
    return str(path)


def must_end(ended: Ended) -> Ended:
    """What has ended well; raises RuntimeError for anything else, as without material there is nothing to break."""
    if ended.code or ended.fell:
        raise RuntimeError(ended.show())
    return ended


def _make_run(kind: str, place: Path) -> Run:
    source = write_scenario(kind, place)
    first = must_end(deepgps("run", source, "--out", "first", cwd=place))
    work, stages = place / "work", {}
    for stage in STAGES:
        if stage == "collecting":
            if _cut_off("collect", source, work, lambda: any(work.glob("recording.collecting/image-*.npz"))) is None:
                continue  # over before it can be cut off
        elif stage == "training":
            _cut_off("train", source, work, lambda: any(work.glob("*/checkpoint.pt")))
        else:
            command = {"collected": "collect", "trained": "train", "evaluated": "evaluate", "finished": "run"}[stage]
            second = must_end(deepgps(command, source, "--out", str(work), cwd=place))
        stages[stage] = copy(work, place / stage)
    printed = figures_printed(first.out)
    if figures_printed(second.out) != printed:
        raise RuntimeError(f"two clean runs print different figures: {first.out} {second.out}")
    return Run(source, stages, same_in(take(place / "first"), take(work)), printed)


def _make_other(place: Path) -> Run:
    source = write_scenario("landmarks", place, seed=1)
    ended = [must_end(deepgps("run", source, "--out", name, cwd=place)) for name in ("first", "second")]
    clean = same_in(take(place / "first"), take(place / "second"))
    return Run(source, {"finished": place / "first"}, clean, figures_printed(ended[0].out))


def _cut_off(command: str, source: str, out: Path, reached: Callable[[], bool]) -> Path | None:
    """Kill a command and all its processes once it has come so far; none: it ended before."""
    running = start([command, source, "--out", str(out)], cwd=out.parent)
    while not reached():
        if has_ended(running):
            must_end(finish(running))
            return None
        time.sleep(0.001)
    kill(running)
    kill_all(running)
    finish(running)
    return out


def _make_study(place: Path) -> Study:
    write_scenario("landmarks", place, **{"learn.train.steps": 60})
    source = place / "study.yaml"
    source.write_text(yaml.safe_dump(STUDY))
    for name in ("first", "second"):
        must_end(deepgps("study", str(source), "--out", name, cwd=place))
    return Study(source, place / "first", same_in(take(place / "first"), take(place / "second")))
