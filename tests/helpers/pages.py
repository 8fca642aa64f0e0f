"""Code blocks of the documentation, and the small forms in which tests run their commands."""

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import chdir
from dataclasses import dataclass, field
from pathlib import Path
from textwrap import dedent
from unittest.mock import patch

import yaml

from deepgps.commands.parse import parse
from deepgps.commands.scenario import parse_scenario
from deepgps.commands.study import StudyArguments
from deepgps.config.plain_yaml import read_yaml
from deepgps.config.scenario import load_scenario
from deepgps.robot_io.logs.robot_config import load_config
from deepgps.studies.plan import plan_runs
from deepgps.studies.study import load_study
from deepgps.terminal.progress import ignore
from tests.helpers.command import MINI, deepgps_here
from tests.helpers.live_server import serve_grpc

ROOT = Path(__file__).parents[2]
GENERATED = ("docs/results", "docs/examples", "docs/faults.md", "docs/tables.md")
PAGES = [
    ROOT / "README.md",
    *(page for page in sorted((ROOT / "docs").rglob("*.md")) if not str(page.relative_to(ROOT)).startswith(GENERATED)),
]
BLOCK = re.compile(r"^( *)```(\S+)\n(.*?)^\1```$", re.MULTILINE | re.DOTALL)
NAMED = re.compile(r"(?:#|<!--) (\S+\.(?:yaml|xml|py))(?: -->)?\n")

SMALL = "mini.yaml"
"""The scenario that every long run becomes."""
SMALLER = ("--drive.samples", "60", "--learn.train.steps", "20", "--learn.fold.restarts", "0")
"""Settings of runs with settings of their own, which cannot be copies of the finished run."""
IMPORTED = "runs/my_drive"
"""A recording that a page imports, on which a run is trained briefly."""
IN_USE = "--deployment.drive-samples"
"""The length of a drive in use, which becomes a small one."""
SMALL_STUDY = {"noise_w": ("noise_w", "--tiny"), "my_study.yaml": ("small_study.yaml",)}
"""The study that a long one becomes."""
TESTED_ELSEWHERE = {
    "deepgps locate runs/mine drive.mcap --config robot.yaml --track": (
        "tests/deepgps/robot_io/locate/test_log_source.py"
    ),
    "deepgps study change": "tests/deepgps/studies/reports/test_change.py",
    "deepgps study seeds --engine ray": "tests/deepgps/studies/engine/test_ray_cluster.py",
    "deepgps bench": "tests/deepgps/bench/test_bench.py",
    "deepgps view runs/first --screenshot first.png": "tests/deepgps/viewer/window/test_web.py",
}
MADE_EARLIER: dict[str, tuple[str, ...]] = {
    "runs/first": ("run", "tiny", "--out", "runs/first"),
    "runs/living_room/good": ("run", "living_room", "--out", "runs/living_room/good"),
    "runs/living_room/poor": ("run", "living_room", "--out", "runs/living_room/poor", "--encoder.ticks-per-rev", "16"),
    "runs/studies/noise_w": ("study", "noise_w"),
}
"""The commands of earlier pages that make what a page shows."""


@dataclass(frozen=True)
class Block:
    """A fenced block of a page: where it is, its language and its text."""

    page: Path
    line: int
    language: str
    text: str

    @property
    def place(self) -> str:
        """Page and line, for messages."""
        return f"{self.page.relative_to(ROOT)}:{self.line}"


def find_blocks(page: Path) -> Iterator[Block]:
    """The fenced blocks of a page, without Sphinx's directives."""
    text = page.read_text(encoding="utf-8")
    for found in BLOCK.finditer(text):
        if not found[2].startswith("{"):
            yield Block(page, text.count("\n", 0, found.start()) + 1, found[2], dedent(found[3]))


def is_folder(words: Sequence[str]) -> bool:
    """Whether a command takes a folder that an earlier one made in place of a scenario."""
    return bool(words) and words[0].startswith("runs/")


@dataclass
class Reader:
    """Someone who types everything that the documentation says into one folder, small; nothing is done twice.

    Attributes:
        folder: Where everything is typed.
        finished: A finished run of the small scenario.
        done: What each command made, if others can use it.
    """

    folder: Path
    finished: Path
    done: dict[tuple[str, ...], Path | None] = field(default_factory=dict)

    def __post_init__(self) -> None:
        (self.folder / SMALL).write_text(MINI)
        self.done["run", SMALL] = self.finished

    def follow(self, block: Block) -> None:
        """Do what a block says; raises AssertionError, or what its code raises."""
        if named := NAMED.match(block.text):
            (self.folder / named[1]).write_text(block.text)
        {"bash": self.type_all, "yaml": self.check_settings, "python": self.execute}.get(
            block.language, lambda _: None
        )(block)

    def type_all(self, block: Block) -> None:
        """Run the commands of a block."""
        for line in block.text.replace("\\\n", " ").splitlines():
            for command in line.split("&&"):
                if words := shlex.split(command, comments=True):
                    self.type(words, block.place)

    def type(self, words: Sequence[str], place: str) -> None:
        """Run one command in its small form."""
        program, *rest = words
        if program == "make":
            subprocess.run(["make", "-n", *rest], cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
        elif program == "deepgps":
            self.deepgps(rest, place)
        else:
            assert words == ["source", ".venv/bin/activate"], f"{place}: no small form of {shlex.join(words)}"

    def deepgps(self, words: Sequence[str], place: str) -> None:
        """Check a command's arguments as they are written, then run its small form unless that is done."""
        name = next(iter(words), "")
        if shlex.join(["deepgps", *words]) in TESTED_ELSEWHERE:
            return
        if ">" in words:
            words = words[: words.index(">")]
        if not any(word.startswith("--help") for word in words):
            if name == "view" or is_folder(words[1:]):
                self.make_earlier(words, place)
            if name in {"run", "collect", "train", "evaluate"}:
                return self.run(name, list(words[1:]), place)
            if name == "study":
                return self.study(list(words[1:]), place)
            if name == "view":
                return self.view(words[1:], place)
            if name == "rooms":
                words = [*words, "--kinds", "studio", "--seeds", "0"]
        self.call(words, place)

    def run(self, stage: str, words: list[str], place: str) -> None:
        """Check the settings of a run, and run it small; a run with the same settings is copied.

        Where no page looks at the run, only its recording is made, which is where faults and sensors act.
        """
        with chdir(self.folder):
            arguments, _ = parse_scenario(stage, words, None)
        if not is_folder(words):
            words[0] = SMALL
        if arguments.live is not None:
            at = words.index("--live")
            del words[at : at + 1 + len(arguments.live)]
            with serve_grpc("--serve-grpc") as (address, _):  # a viewer without a window
                folder = f"runs/live-{len(self.done)}"
                return self.call([stage, *words, *SMALLER, "--live", address, "--out", folder], place)
        out = arguments.out
        if out is None and is_folder(words):
            return self.call([stage, *words], place)  # the folder itself is changed
        if out is not None:
            at = words.index("--out")
            del words[at : at + 2]
        elif "--methods" not in words:
            stage = "collect"
        if words != [SMALL] and not is_folder(words):
            words += SMALLER
        elif words[:1] == [IMPORTED]:
            words += SMALLER[2:]
        if IN_USE in words:
            words += (IN_USE, "30")
        key = (stage, *words)
        made = self.folder / (out or Path("runs") / f"small-{len(self.done)}")
        if (before := self.done.get(key)) and before != made:
            shutil.copytree(before, made, dirs_exist_ok=True)
        elif before is None:
            self.call([stage, *words, "--out", str(made.relative_to(self.folder))], place)
        self.done[key] = made

    def study(self, words: list[str], place: str) -> None:
        """Check all runs of a study, and run a small study into the folder of the long one."""
        with chdir(self.folder):
            arguments = parse(StudyArguments, "study", words, None)
            study = load_study(arguments.study, arguments.tiny, arguments.full)
            plan_runs(study, ignore)
            self.write_small_study(arguments.study)
        small = SMALL_STUDY[arguments.study]
        folder = self.folder / "runs" / "studies" / Path(arguments.study).stem
        if self.done.setdefault(("study", *small), folder) == folder and not folder.exists():
            self.call(["study", *small, "--out", str(folder.relative_to(self.folder))], place)

    def write_small_study(self, path: str) -> None:
        """A study of one's own, of the small scenario, with one case and seed, and two values of its last axis."""
        if path.endswith(".yaml"):
            values = dict(read_yaml(Path(path), 1000))
            axes = {name: list(some)[:2] for name, some in values.get("axes", {}).items()}
            small = {"scenario": SMALL, "methods": values["methods"][:1], "axes": axes, "report": values["report"]}
            Path("small_study.yaml").write_text(yaml.safe_dump(small))

    def view(self, words: Sequence[str], place: str) -> None:
        """Serve what is to be viewed until it is interrupted."""
        folders = tuple(word for word in words if word.startswith("runs/"))
        kind = ("view", *(self.content_of(folder) for folder in folders))
        if kind in self.done:
            return
        self.done[kind] = None
        command = [sys.executable, "-m", "deepgps.commands.main", "view", *folders, "--web"]
        with subprocess.Popen(
            command, cwd=self.folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=self.environment()
        ) as process:
            assert process.stdout and process.stderr
            said = process.stdout.readline()
            process.send_signal(signal.SIGINT)
            assert said.startswith("open http://127.0.0.1:"), f"{place}: {process.stderr.read()}"
            assert process.wait(60) == 128 + signal.SIGINT, place

    def content_of(self, folder: str) -> str:
        """The command that made a folder, as runs with the same settings are copies."""
        return next((shlex.join(key) for key, made in self.done.items() if made == self.folder / folder), folder)

    def call(self, words: Sequence[str], place: str) -> None:
        """Run ``deepgps`` in this process; the exit code must be 0."""
        with patch.dict(os.environ):
            ended = deepgps_here(*words, cwd=self.folder)
        assert ended.returncode == 0, f"{place}: deepgps {shlex.join(words)}: {ended.stderr}{ended.stdout}"

    def check_settings(self, block: Block) -> None:
        """Check a settings file as the command does: a study with all its runs, or a scenario."""
        path = self.folder / "block.yaml"
        path.write_text(block.text)
        with chdir(self.folder):
            if "wheels" in read_yaml(path, 1000):
                load_config(path)
            elif "scenario" in read_yaml(path, 1000):
                plan_runs(load_study(str(path), tiny=False, full=False), ignore)
            else:
                load_scenario(str(path), {})

    def execute(self, block: Block) -> None:
        """Execute Python code; what it reads has been made before."""
        self.make_earlier([path for path in MADE_EARLIER if path in block.text], block.place)
        with chdir(self.folder), patch.dict(os.environ):
            exec(compile(block.text, block.place, "exec"), {"__name__": "__main__"})

    def make_earlier(self, paths: Sequence[str], place: str) -> None:
        """Make those of these paths that earlier pages make, and that are missing because those pages were not read."""
        for path in paths:
            if path in MADE_EARLIER and not (self.folder / path).exists():
                self.deepgps(MADE_EARLIER[path], place)

    def environment(self) -> dict[str, str]:
        """This process's environment, in which the project is found from any folder."""
        return {**os.environ, "PYTHONPATH": str(ROOT)}
