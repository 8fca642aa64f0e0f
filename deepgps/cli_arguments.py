"""The arguments of each command, and the parsing of a command line into them and a scenario's settings."""

import contextlib
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import tyro

from deepgps.plugins import load_plugins
from deepgps.scenario import Scenario, load_scenario, names_in
from sim.errors import InputError
from sim.paths import SCENARIOS
from sim.settings import RoomKind


@dataclass(frozen=True)
class RunArguments:
    scenario: Annotated[str, tyro.conf.Positional]
    """A name in assets/scenarios, or the path of a YAML file."""
    out: Path | None = None
    """The run folder itself; default: runs/<scenario>/seed<seed>-<hash>."""
    fresh: bool = False
    """Discard what is in the run folder and start again."""
    live: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="[HOST:PORT]")] = None
    """Show the run while it is in progress, in a new viewer or in one that listens at HOST:PORT or a rerun+http URL."""
    plugin: tuple[Path, ...] = ()
    """Files of plugins, with methods and encoder faults of your own."""


@dataclass(frozen=True)
class StudyArguments:
    study: Annotated[str, tyro.conf.Positional]
    """A name in assets/studies, or the path of a YAML file."""
    out: Path | None = None
    """The study folder itself; default: runs/studies/<study>, with --tiny or --full <study>-tiny or <study>-full."""
    tiny: bool = False
    """Run the study's small version, which takes half a minute: it shows how a study works; its figures mean
    nothing."""
    full: bool = False
    """Run the study's long version, if it has one."""
    engine: Literal["local", "ray"] = "local"
    """local: processes of this machine; ray: tasks of a Ray cluster, which needs the extra deepgps[ray]."""
    address: str | None = None
    """Address of the Ray cluster, as auto or host:port; none: a cluster is started here."""
    publish: Path | None = None
    """Copy the table, report and figures to a subfolder of this folder named after the study, as in docs/results."""
    fresh: bool = False
    """Discard what is in the study folder and start again."""
    plugin: tuple[Path, ...] = ()
    """Files of plugins, with methods and encoder faults of your own."""


@dataclass(frozen=True)
class ViewArguments:
    runs: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """The folder of a run or of a study, or those of two runs to compare."""
    web: bool = False
    """Serve the viewer and the recording to a browser on this machine, until Ctrl-C."""
    port: int | None = None
    """Port of the page that --web serves; its data comes from the next port. None: free ports."""
    plugin: tuple[Path, ...] = ()
    """Files of plugins, whose methods then have their titles and colours."""


@dataclass(frozen=True)
class RoomsArguments:
    kinds: str = "all"
    """Kinds of room, separated by commas, or all."""
    seeds: str = "0-3"
    """Seeds, such as 0-3 or 0,2,5."""
    out: Path = Path("rooms.png")
    """The picture to write."""


@dataclass(frozen=True)
class BenchArguments:
    out: Path = Path("bench.json")
    """The file to write; a copy is kept in runs/bench."""
    against: str | None = None
    """Show an earlier bench next to this one: last, or its file."""
    tiny: bool = False
    """Measure everything at a small size, in under a minute: the figures mean nothing and are not kept."""
    memory_samples: int | None = None
    """Number of observations in the long recording, 12 kB each on disk; none: a million."""


@dataclass(frozen=True)
class NoArguments:
    pass


def parse_scenario(command: str, words: Sequence[str], about: str | None) -> tuple[RunArguments, Scenario]:
    """Parse a command's own arguments and its scenario with overrides; ``--help`` shows every setting and exits."""
    if {"-h", "--help"} & set(words):
        _show_settings(command, about)
    own, overrides = _split(words, {"--out", "--fresh", "--live", "--plugin"})
    if not own or own[0].startswith("-"):
        raise InputError(f"deepgps {command} needs a scenario first: {', '.join(names_in(SCENARIOS))}, or a path")
    arguments = parse(RunArguments, command, own, about)
    load_plugins(arguments.plugin)
    return arguments, load_scenario(arguments.scenario, overrides)


def parse(kind: Any, command: str, words: Sequence[str], about: str | None) -> Any:
    """Parse a command's arguments; ``--help`` shows them below the description ``about`` and exits."""
    if {"-h", "--help"} & set(words):
        tyro.cli(kind, args=["--help"], prog=f"deepgps {command}", description=about)
    said = io.StringIO()
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            return tyro.cli(kind, args=list(words), prog=f"deepgps {command}")
    except SystemExit:
        raise InputError(f"deepgps {command}: {_first_sentence(said.getvalue())}") from None


def parse_kinds(text: str) -> list[Any]:
    """Kinds of room from ``all`` or ``office,kitchen``."""
    kinds = list(get_args(RoomKind)) if text == "all" else text.split(",")
    for kind in kinds:
        if kind not in get_args(RoomKind):
            raise InputError(f"--kinds {kind!r} does not exist; there are all, {', '.join(get_args(RoomKind))}")
    return kinds


def parse_seeds(text: str) -> list[int]:
    """Seeds from ``0-3`` or ``0,2,5``."""
    try:
        first, dash, last = text.partition("-")
        seeds = list(range(int(first), int(last) + 1)) if dash else [int(part) for part in text.split(",")]
    except ValueError:
        seeds = []
    if not seeds or min(seeds) < 0 or len(seeds) > 100:
        raise InputError(f"--seeds {text!r}: one to a hundred whole numbers, as 0-3 or 0,2,5")
    return seeds


def _split(words: Sequence[str], own_flags: set[str]) -> tuple[list[str], dict[str, Any]]:
    """Separate the command's own words from overrides such as ``--room.seed 3``, which the scenario itself checks."""
    own, overrides = [], {}
    flag, values = None, []
    for word in [*words, "--"]:
        if not word.startswith("--"):
            values.append(word)
            continue
        if flag is None or flag in own_flags:
            own += [*([flag] if flag else []), *values]
        elif not values:
            raise InputError(f"{flag} needs a value")
        else:
            plain = [None if value.lower() in {"none", "null"} else value for value in values]
            overrides[flag[2:].replace("-", "_")] = plain if flag == "--methods" else plain[0]
            if len(plain) > 1 and flag != "--methods":
                raise InputError(f"{flag} takes one value, not {' '.join(values)}")
        flag, _, value = word.partition("=")
        values = [value] if value else []
    return own, overrides


def _show_settings(command: str, about: str | None) -> None:
    @dataclass(frozen=True)
    class Everything(RunArguments):
        settings: Annotated[Scenario, tyro.conf.arg(name="")] = Scenario()  # noqa: RUF009 (frozen)

    tyro.cli(Everything, args=["--help"], prog=f"deepgps {command}", description=about)


def _first_sentence(box: str) -> str:
    """The message inside the frame that tyro draws."""
    lines = [line.strip("│ ") for line in box.splitlines() if line.startswith("│")]
    message = [line for line in lines if line]
    end = next((index for index, line in enumerate(message) if set(line) == {"─"}), len(message))
    return " ".join(message[:end]) or box.strip()
