"""Code blocks of the documentation, and checks of what they say that need not do it."""

import ast
import re
import shlex
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import chdir
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from textwrap import dedent

from deepgps.commands.main import COMMANDS
from deepgps.commands.parse import parse
from deepgps.commands.scenario import parse_scenario
from deepgps.config.plain_yaml import read_yaml
from deepgps.config.scenario import load_scenario
from deepgps.robot_io.logs.robot_config import load_config
from deepgps.studies.plan import plan_runs
from deepgps.studies.study import load_study
from deepgps.terminal.progress import ignore
from tests.helpers.command import deepgps_here

ROOT = Path(__file__).parents[2]
GENERATED = ("docs/results", "docs/examples", "docs/tables.md")
PAGES = [
    ROOT / "README.md",
    *(page for page in sorted((ROOT / "docs").rglob("*.md")) if not str(page.relative_to(ROOT)).startswith(GENERATED)),
]
BLOCK = re.compile(r"^( *)```(\S+)\n(.*?)^\1```$", re.MULTILINE | re.DOTALL)
EXAMPLE = re.compile(r"^<!-- generated: code \S+\.py .*?^<!-- end -->", re.MULTILINE | re.DOTALL)
NAMED_FILE = re.compile(r"(?:#|<!--) (\S+\.(?:yaml|xml|py))(?: -->)?\n")
STAGES = ("run", "collect", "train", "evaluate")
IMPORTED_RECORDING = "runs/my_drive"
"""A recording that a page imports."""
UNCHECKED_COMMANDS = (["source", ".venv/bin/activate"],)
"""What is not checked."""


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

    @property
    def commands(self) -> list[list[str]]:
        """The words of each command of a shell block, without where its output goes."""
        lines = self.text.replace("\\\n", " ").splitlines()
        found = [shlex.split(command, comments=True) for line in lines for command in line.split("&&")]
        return [words[: words.index(">")] if ">" in words else words for words in found if words]

    def write(self, folder: Path) -> None:
        """Write the block to the file that its first line names, if it names one."""
        if named := NAMED_FILE.match(self.text):
            (folder / named[1]).write_text(self.text)


def find_blocks(page: Path) -> Iterator[Block]:
    """The fenced blocks of a page, without examples that are files of their own, and without directives of Sphinx."""
    text = EXAMPLE.sub(lambda found: "\n" * found[0].count("\n"), page.read_text(encoding="utf-8"))
    for found in BLOCK.finditer(text):
        if not found[2].startswith("{"):
            yield Block(page, text.count("\n", 0, found.start()) + 1, found[2], dedent(found[3]))


def is_folder(words: Sequence[str]) -> bool:
    """Whether a command takes a folder that an earlier one made in place of a scenario."""
    return bool(words) and words[0].startswith("runs/")


def check_block(block: Block, folder: Path, finished: Path) -> None:
    """Check commands, settings and code, but do no work; raises AssertionError, or what the product raises.

    Args:
        block: The block.
        folder: Where the reader works.
        finished: A finished run, in place of all that earlier commands make.
    """
    block.write(folder)
    with chdir(folder):
        if block.language == "bash":
            for words in block.commands:
                check_command(words, block.place, finished)
        elif block.language == "yaml":
            check_settings(block)
        elif block.language == "python":
            check_code(block)


def check_command(words: Sequence[str], place: str, finished: Path) -> None:
    """Check the arguments of a command line, and the settings that they make."""
    program, *words = words
    if program == "make":
        subprocess.run(["make", "-n", *words], cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
    elif program == "deepgps":
        name, *words = words
        if name.startswith("--tyro-") or any(word.startswith("--help") for word in words):
            assert deepgps_here(name, *words, cwd=Path()).returncode == 0, place
        elif name in STAGES:
            if is_folder(words):
                words[0] = str(finished / "recording" if words[0] == IMPORTED_RECORDING else finished)
            parse_scenario(name, words, None)
        elif name == "study":
            arguments = parse(COMMANDS[name].find(COMMANDS[name].arguments), name, words, None)
            plan_runs(load_study(arguments.study, arguments.tiny, arguments.full, arguments.networks), ignore)
        else:
            parse(COMMANDS[name].find(COMMANDS[name].arguments), name, words, None)
    else:
        assert [program, *words] in UNCHECKED_COMMANDS, f"{place}: {program} is not known"


def check_settings(block: Block) -> None:
    """Check a settings file as the command does: a study with all its runs, a robot's file, or a scenario."""
    path = Path("block.yaml")
    path.write_text(block.text)
    if "wheels" in (values := read_yaml(path)):
        load_config(path)
    elif "scenario" in values:
        plan_runs(load_study(str(path), tiny=False, full=False), ignore)
    else:
        load_scenario(str(path), {})


def check_code(block: Block) -> None:
    """Compile code, and look up what it imports of ours."""
    compile(block.text, block.place, "exec")
    for node in ast.walk(ast.parse(block.text)):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.partition(".")[0] in {"sim", "deepgps"}:
            module = import_module(node.module)
            lost = [name.name for name in node.names if not hasattr(module, name.name)]
            assert not [name for name in lost if not find_spec(f"{node.module}.{name}")], f"{block.place}: {lost}"
