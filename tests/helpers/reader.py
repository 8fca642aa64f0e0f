"""Someone who types everything that the documentation says into one folder, small; nothing is done twice."""

import os
import shlex
import shutil
import signal
import sys
from collections.abc import Sequence
from contextlib import chdir
from dataclasses import dataclass, field
from pathlib import Path
from unittest.mock import patch

import yaml

from deepgps.config.plain_yaml import read_yaml
from tests.helpers.command import MINI, deepgps_here, read_line, started
from tests.helpers.live_server import serve_grpc
from tests.helpers.pages import IMPORTED_RECORDING, ROOT, STAGES, Block, check_block, is_folder

SMALL_SCENARIO = "mini.yaml"
"""The scenario that every long run becomes."""
SMALL_OVERRIDES = ("--drive.samples", "60", "--learn.train.steps", "20", "--learn.fold.restarts", "0")
"""Settings of runs with settings of their own, which cannot be copies of the finished run."""
DEPLOYMENT_OPTION = "--deployment.drive-samples"
"""The length of a deployment drive, which becomes a small one."""
SMALL_STUDY = {"carpet": ("carpet", "--tiny"), "noise_w": ("noise_w", "--tiny"), "my_study.yaml": ("small_study.yaml",)}
"""The study that a long one becomes."""
TESTED_ELSEWHERE = {
    "deepgps locate runs/mine drive.mcap --config robot.yaml --track": ("tests/deepgps/robot_io/test_log_source.py"),
    "deepgps study change": "tests/deepgps/studies/reports/test_change.py",
    "deepgps study carpet --engine ray": "tests/deepgps/studies/engine/test_ray_cluster.py",
    "deepgps view runs/first --screenshot first.png": "tests/deepgps/viewer/test_show.py",
}
MADE_EARLIER: dict[str, tuple[str, ...]] = {
    "runs/first": ("run", "tiny", "--out", "runs/first"),
    "runs/living_room/good": ("run", "living_room", "--out", "runs/living_room/good"),
    "runs/living_room/poor": ("run", "living_room", "--out", "runs/living_room/poor", "--encoder.ticks-per-rev", "16"),
    "runs/studies/noise_w": ("study", "noise_w"),
}
"""The commands of earlier pages that make what a page shows."""


def take(words: list[str], option: str) -> str | None:
    """Take an option with its value out of a command's words; returns the value."""
    if option not in words:
        return None
    at = words.index(option)
    value = words[at + 1 : at + 2]
    has_value = bool(value) and not value[0].startswith("--")
    del words[at : at + 1 + has_value]
    return value[0] if has_value else ""


@dataclass
class Reader:
    """The reader.

    Attributes:
        folder: Where everything is typed.
        finished: A finished run of the small scenario.
        done: What each command made, if others can use it.
    """

    folder: Path
    finished: Path
    done: dict[tuple[str, ...], Path | None] = field(default_factory=dict)

    def __post_init__(self) -> None:
        (self.folder / SMALL_SCENARIO).write_text(MINI)
        self.done["run", SMALL_SCENARIO] = self.finished

    def follow(self, block: Block) -> None:
        """Do what a block says; raises AssertionError, or what its code raises."""
        if block.language == "bash":
            for program, *words in block.commands:
                if program == "deepgps" and shlex.join([program, *words]) not in TESTED_ELSEWHERE:
                    self.deepgps(words, block.place)
        elif block.language == "python":
            block.write(self.folder)
            self.make_earlier([path for path in MADE_EARLIER if path in block.text], block.place)
            with chdir(self.folder), patch.dict(os.environ):
                exec(compile(block.text, block.place, "exec"), {"__name__": "__main__"})
        else:
            check_block(block, self.folder, self.finished)

    def deepgps(self, words: Sequence[str], place: str) -> None:
        """Run the small form of a command unless that is done."""
        name, *words = words
        if any(word.startswith("--help") for word in words):
            return self.call([name, *words], place)
        if name == "view" or is_folder(words):
            self.make_earlier(words, place)
        if name in STAGES:
            return self.run(name, words, place)
        if name == "study":
            return self.study(words, place)
        if name == "view":
            return self.view(words, place)
        return self.call([name, *words, *(("--kinds", "studio", "--seeds", "0") if name == "rooms" else ())], place)

    def run(self, stage: str, words: list[str], place: str) -> None:
        """Run a scenario small; a run with the same settings is copied.

        Where no page looks at the run, only its recording is made, which is where faults and sensors act.
        """
        if words[0] == "flat":
            words[1:1] = ("--drive.headings", "map")  # as a flat is driven
        if not is_folder(words):
            words[0] = SMALL_SCENARIO
        if take(words, "--live") is not None:
            with serve_grpc("--serve-grpc") as (address, _):  # a viewer without a window
                out = f"runs/live-{len(self.done)}"
                return self.call([stage, *words, *SMALL_OVERRIDES, "--live", address, "--out", out], place)
        out = take(words, "--out")
        if out is None and is_folder(words):
            return self.call([stage, *words], place)  # the folder itself is changed
        if out is None and "--methods" not in words:
            stage = "collect"
        if words[0] == IMPORTED_RECORDING:
            words += SMALL_OVERRIDES[2:]
        elif words != [SMALL_SCENARIO] and not is_folder(words):
            words += SMALL_OVERRIDES
        if DEPLOYMENT_OPTION in words:
            words += (DEPLOYMENT_OPTION, "30")
        key = (stage, *words)
        made = self.folder / (out or Path("runs") / f"small-{len(self.done)}")
        if (before := self.done.get(key)) and before != made:
            shutil.copytree(before, made, dirs_exist_ok=True)
        elif before is None:
            self.call([stage, *words, "--out", str(made.relative_to(self.folder))], place)
        self.done[key] = made

    def study(self, words: list[str], place: str) -> None:
        """Run a small study into the folder of the long one."""
        with chdir(self.folder):
            self.write_small_study(words[0])
        small = SMALL_STUDY[words[0]]
        folder = self.folder / "runs" / "studies" / Path(words[0]).stem
        if self.done.setdefault(("study", *small), folder) == folder and not folder.exists():
            self.call(["study", *small, "--out", str(folder.relative_to(self.folder))], place)

    def write_small_study(self, path: str) -> None:
        """A study of one's own, of the small scenario, with one case and seed, and two values of its last axis."""
        if path.endswith(".yaml"):
            values = dict(read_yaml(Path(path)))
            axes = {name: list(some)[:2] for name, some in values.get("axes", {}).items()}
            small = {
                "scenario": SMALL_SCENARIO,
                "methods": values["methods"][:1],
                "axes": axes,
                "report": values["report"],
            }
            Path("small_study.yaml").write_text(yaml.safe_dump(small))

    def view(self, words: Sequence[str], place: str) -> None:
        """Serve what is to be viewed until it is interrupted."""
        folders = tuple(word for word in words if word.startswith("runs/"))
        kind = ("view", *(self.content_of(folder) for folder in folders))
        if kind in self.done:
            return
        self.done[kind] = None
        command = [sys.executable, "-m", "deepgps.commands.main", "view", *folders, "--web"]
        with started(*command, cwd=self.folder, PYTHONPATH=str(ROOT)) as process:
            said = read_line(process, f"{place}: the address of the page")
            assert said.startswith("open http://127.0.0.1:"), f"{place}: {said}"
            process.send_signal(signal.SIGINT)
            assert process.wait(60) == 128 + signal.SIGINT, place

    def content_of(self, folder: str) -> str:
        """The command that made a folder, as runs with the same settings are copies."""
        return next((shlex.join(key) for key, made in self.done.items() if made == self.folder / folder), folder)

    def call(self, words: Sequence[str], place: str) -> None:
        """Run ``deepgps`` in this process; the exit code must be 0."""
        with patch.dict(os.environ):
            ended = deepgps_here(*words, cwd=self.folder)
        assert ended.returncode == 0, f"{place}: deepgps {shlex.join(words)}: {ended.stderr}{ended.stdout}"

    def make_earlier(self, paths: Sequence[str], place: str) -> None:
        """Make those of these paths that earlier pages make, and that are missing because those pages were not read."""
        for path in paths:
            if path in MADE_EARLIER and not (self.folder / path).exists():
                self.deepgps(MADE_EARLIER[path], place)
