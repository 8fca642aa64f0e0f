"""The arguments of each command, and the parsing of a command line into them and a scenario's settings."""

import contextlib
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, make_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args, get_origin, get_type_hints

import tyro

from deepgps.command.completion import SHELLS, Words
from deepgps.command.help import write_help
from deepgps.methods.catalog import METHODS
from deepgps.plugins import load_plugins
from deepgps.scenario import Scenario, names_in
from deepgps.source import Source, find_source
from deepgps.spelling import (
    as_option,
    find_group,
    find_like,
    find_settings_like,
    find_type,
    from_option,
    list_settings,
    suggest,
)
from sim.errors import InputError
from sim.paths import SCENARIOS, STUDIES
from sim.renamed import explain_setting
from sim.settings import Group, RoomKind
from sim.user_input import shorten

if TYPE_CHECKING:
    from sim.sensors.unwrap import RoundImage

OptionalFolder = Annotated[Path | None, tyro.conf.arg(metavar="FOLDER")]
File = Annotated[Path, tyro.conf.arg(metavar="FILE")]
Plugins = Annotated[tuple[Path, ...], tyro.conf.arg(metavar="FILE [FILE ...]")]
CONFIG = (tyro.conf.FlagCreatePairsOff,)
MOST_SEEDS = 100
HELP = ("-h", "--help", "--help-all")


@dataclass(frozen=True)
class RunArguments:
    scenario: Annotated[str, tyro.conf.arg(metavar="SCENARIO"), tyro.conf.Positional]
    """A name in assets/scenarios, the path of a YAML file, or the folder of a run or of a recording."""
    out: OptionalFolder = None
    """The run folder itself; default: that of the run, or runs/<scenario>/seed<seed>-<hash>."""
    fresh: bool = False
    """Make the run again; the old one is replaced once the new one is complete."""
    live: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="[HOST:PORT]")] = None
    """Show the run while it is in progress, in a new viewer or in one that listens at HOST:PORT or a rerun+http URL."""
    log: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Also write the log that a robot would have recorded of the drive, as MCAP: raw pictures, wheels, rays, truth."""
    plugin: Plugins = ()
    """Files of plugins, with methods and encoder faults of your own."""


@dataclass(frozen=True)
class StudyArguments:
    study: Annotated[str, tyro.conf.arg(metavar="STUDY"), tyro.conf.Positional]
    """A name in assets/studies, or the path of a YAML file."""
    out: OptionalFolder = None
    """The study folder itself; default: runs/studies/<study>, with --tiny or --full <study>-tiny or <study>-full."""
    tiny: bool = False
    """Run the study's small version, which takes half a minute: it shows how a study works; its figures mean
    nothing."""
    full: bool = False
    """Run the study's long version, if it has one."""
    engine: Literal["local", "ray"] = "local"
    """local: processes of this machine; ray: tasks of a Ray cluster, which needs the extra deepgps[ray]."""
    address: Annotated[str | None, tyro.conf.arg(metavar="HOST:PORT")] = None
    """Address of the Ray cluster, as auto or host:port; none: a cluster is started here."""
    publish: OptionalFolder = None
    """Copy the table, report and figures to a subfolder of this folder named after the study, as in docs/results."""
    fresh: bool = False
    """Make the study again; the old one is replaced once the new one is complete."""
    plugin: Plugins = ()
    """Files of plugins, with methods and encoder faults of your own."""


@dataclass(frozen=True)
class ViewArguments:
    runs: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="RUN [RUN]"), tyro.conf.Positional]
    """The folder of a run or of a study, or those of two runs to compare."""
    web: bool = False
    """Serve the viewer and the recording to a browser on this machine, until Ctrl-C."""
    port: Annotated[int | None, tyro.conf.arg(metavar="PORT")] = None
    """Port of the page that --web serves; its data comes from the next port. None: free ports."""
    plugin: Plugins = ()
    """Files of plugins, whose methods then have their titles and colours."""
    screenshot: Path | None = None
    """Write a picture of the first tab as PNG instead of opening a window; needs Chromium, or a display."""


@dataclass(frozen=True)
class DiagnoseArguments:
    recording: Annotated[Path, tyro.conf.arg(metavar="RECORDING"), tyro.conf.Positional]
    """The folder of a recording or of a run."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """The file to write; default: diagnosis.json in the folder of the run, none for a recording without one."""


@dataclass(frozen=True)
class TrackArguments:
    run: Annotated[Path, tyro.conf.arg(metavar="RUN"), tyro.conf.Positional]
    """The folder of a run."""
    method: Annotated[str | None, tyro.conf.arg(metavar="METHOD")] = None
    """A method that is trained in it; none: its first."""
    drive: OptionalFolder = None
    """The folder of another recording of the same robot and room; none: the drive in use."""
    tum: OptionalFolder = None
    """Write the paths as TUM files, which evo reads, to this folder; also the truth, if it is known."""
    plugin: Plugins = ()
    """Files of plugins, with methods of your own."""


@dataclass(frozen=True)
class ImportArguments:
    log: Annotated[Path, tyro.conf.arg(metavar="LOG"), tyro.conf.Positional]
    """A .bag, .mcap or .db3 file, a folder of them, or a folder with images and wheels.csv."""
    config: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """What the log does not say of its robot: robot.yaml, which --look proposes."""
    out: OptionalFolder = None
    """Folder of the recording; must be empty or not exist, and be no link."""
    look: bool = False
    """Only print what the log holds, and propose a robot.yaml."""


@dataclass(frozen=True)
class ExportArguments:
    run: Annotated[Path, tyro.conf.arg(metavar="RUN"), tyro.conf.Positional]
    """The folder of a run."""
    out: OptionalFolder = None
    """The folder to write, with a subfolder for each format; default: export/<name of the run's folder>. It must
    not hold an export of another run."""
    tum: bool = False
    """Write trajectories as TUM files, which evo reads: each method's and the true one, of both drives."""
    csv: bool = False
    """Write the same trajectories as CSV, with everything that a method tells of a pose."""
    mcap: bool = False
    """Write each drive as MCAP with ROS 2 messages: images, wheels, and every method's poses with covariance."""
    onnx: bool = False
    """Write one method as a model in ONNX with an example; needs the extra deepgps[onnx]."""
    method: Annotated[str | None, tyro.conf.arg(metavar="METHOD")] = None
    """The method; none: the run's first as ONNX, all as trajectories."""
    frame: Literal["world", "map"] | None = None
    """Frame of the poses: the world's, or the map's own; none: the world's where evaluation has placed the map."""
    centre: Annotated[tuple[float, float] | None, tyro.conf.arg(metavar="COLUMN ROW")] = None
    """Optical axis in raw images [px], from which the exported model then takes raw images too."""
    radius_px: Annotated[float | None, tyro.conf.arg(metavar="PX")] = None
    """Radius of the image circle in raw images [px]."""
    forward_deg: Annotated[float, tyro.conf.arg(metavar="DEG")] = 0.0
    """Direction of the robot's forward axis in raw images, clockwise from the top [deg]."""
    plugin: Plugins = ()
    """Files of plugins that define methods of the run."""

    def list_formats(self) -> "list[Literal['tum', 'csv']]":
        """The formats of trajectories that are asked for."""
        chosen = {"tum": self.tum, "csv": self.csv}
        return [name for name in ("tum", "csv") if chosen[name]]


@dataclass(frozen=True)
class LocateArguments:
    run: Annotated[Path, tyro.conf.arg(metavar="RUN"), tyro.conf.Positional]
    """The folder of a run."""
    source: Annotated[str, tyro.conf.arg(metavar="SOURCE"), tyro.conf.Positional]
    """An image, a folder of images, - for standard input (each image after its length in four bytes, the most
    significant first), or, with --config, a log. Images of the recording's rings and sectors are polar, others raw."""
    config: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """The robot.yaml with which a log would be imported."""
    track: bool = False
    """Track the robot by the images so far and the wheels of a log."""
    causes: bool = False
    """Name the cause for which an image is refused or suspicious, by it and the images before."""
    live: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="[HOST:PORT]")] = None
    """Show poses as they come, in a new viewer or in one that listens at HOST:PORT or a rerun+http URL."""
    method: Annotated[str | None, tyro.conf.arg(metavar="METHOD")] = None
    """The method; none: the run's first."""
    frame: Literal["world", "map"] | None = None
    """Frame of the poses: the world's, or the map's own; none: the world's where evaluation has placed the map."""
    centre: Annotated[tuple[float, float] | None, tyro.conf.arg(metavar="COLUMN ROW")] = None
    """Optical axis in raw images [px]; none: raw images are square, and the image circle fills them."""
    radius_px: Annotated[float | None, tyro.conf.arg(metavar="PX")] = None
    """Radius of the image circle in raw images [px]."""
    forward_deg: Annotated[float, tyro.conf.arg(metavar="DEG")] = 0.0
    """Direction of the robot's forward axis in raw images, clockwise from the top [deg]; needs --centre."""
    plugin: Plugins = ()
    """Files of plugins that define methods of the run."""


@dataclass(frozen=True)
class RoomsArguments:
    kinds: Annotated[str, tyro.conf.arg(metavar="KIND,KIND")] = "all"
    """Kinds of room, separated by commas, or all."""
    seeds: Annotated[str, tyro.conf.arg(metavar="FIRST-LAST")] = "0-3"
    """Seeds, such as 0-3 or 0,2,5."""
    out: File = Path("rooms.png")
    """The picture to write."""


@dataclass(frozen=True)
class BenchArguments:
    out: File = Path("bench.json")
    """The file to write; a copy is kept in runs/bench."""
    against: Annotated[str | None, tyro.conf.arg(metavar="last|FILE")] = None
    """Show an earlier bench next to this one: last, or its file."""
    tiny: bool = False
    """Measure everything at a small size, in under a minute: the figures mean nothing and are not kept."""
    memory_samples: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    """Number of observations in the long recording, 12 kB each on disk; none: a million."""


@dataclass(frozen=True)
class RunsArguments:
    folder: Annotated[Path, tyro.conf.arg(metavar="FOLDER"), tyro.conf.Positional] = Path("runs")
    """The folder whose runs are listed, with those one level further down; a study's folder, too."""


@dataclass(frozen=True)
class CompletionArguments:
    shell: Annotated[Literal["bash", "zsh", "fish"], tyro.conf.arg(metavar="bash|zsh|fish"), tyro.conf.Positional]
    """The shell that reads the script."""


@dataclass(frozen=True)
class NoArguments:
    pass


ARGUMENTS: dict[str, Any] = {
    **dict.fromkeys(("run", "collect", "train", "evaluate"), RunArguments),
    "study": StudyArguments,
    "view": ViewArguments,
    "diagnose": DiagnoseArguments,
    "track": TrackArguments,
    "import": ImportArguments,
    "export": ExportArguments,
    "locate": LocateArguments,
    "runs": RunsArguments,
    "rooms": RoomsArguments,
    "bench": BenchArguments,
    "completion": CompletionArguments,
}
"""Arguments of each command that takes some."""


def parse_scenario(command: str, words: Sequence[str], about: str | None) -> tuple[RunArguments, Source]:
    """Parse a command's own arguments and its scenario with overrides; ``--help`` shows a short help and exits,
    ``--help GROUP`` the settings of a group, ``--help-all`` every setting."""
    if set(HELP) & set(words):
        _help_with_scenario(command, words, about)
    own, overrides = _split(words, list_options(RunArguments))
    if not own or own[0].startswith("-"):
        what = f"{', '.join(names_in(SCENARIOS))}, a path, or the folder of a run or a recording"
        raise InputError(f"deepgps {command} needs a scenario first: {what}")
    arguments = parse(RunArguments, command, own, about)
    load_plugins(arguments.plugin)
    return arguments, find_source(arguments.scenario, overrides, arguments.out, arguments.fresh)


def parse(kind: Any, command: str, words: Sequence[str], about: str | None) -> Any:
    """Parse a command's arguments; ``--help`` shows them below the description ``about`` and exits."""
    if set(HELP) & set(words):
        _show_arguments(kind, command, about)
    options = list_options(kind)
    for word in words:
        name = word.partition("=")[0]
        if name.startswith("--") and name not in options:
            hint = suggest([find_like(name, options)]) or _list_options(options)
            raise InputError(f"deepgps {command}: there is no option {shorten(name)}{hint}")
    said = io.StringIO()
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            return tyro.cli(kind, args=list(words), prog=f"deepgps {command}", config=CONFIG)
    except SystemExit:
        raise InputError(f"deepgps {command}: {_first_sentence(said.getvalue())}") from None


def list_options(kind: Any) -> list[str]:
    """Options of a command's arguments, as they are spelled on the command line."""
    positional = tyro.conf.Positional
    hints = get_type_hints(kind, include_extras=True)
    return [as_option(field.name) for field in fields(kind) if positional not in get_args(hints[field.name])]


def list_words(summaries: Mapping[str, str]) -> dict[str, Words]:
    """What can follow each command, for completion; ``summaries`` says what the commands do."""
    settings = {as_option(name): _list_values(annotation) for name, annotation in list_settings(Scenario)}
    settings["--methods"] = tuple(METHODS)
    plain = {RunArguments: tuple(names_in(SCENARIOS)), StudyArguments: tuple(names_in(STUDIES))}
    words = {}
    for name, summary in summaries.items():
        kind = ARGUMENTS.get(name, NoArguments)
        hints = get_type_hints(kind)
        options = {option: _list_values(hints[from_option(option)]) for option in list_options(kind)}
        more = {"--help-all": None, **settings} if kind is RunArguments else {}
        shells = tuple(SHELLS) if kind is CompletionArguments else ()
        words[name] = Words(summary, plain.get(kind, shells), {**options, "--help": None, **more})
    return words


def _list_values(annotation: Any) -> tuple[str, ...] | None:
    """Values of an option of this type; () if they cannot be listed, None if it takes no value."""
    parts = (annotation, *get_args(annotation))
    if bool in parts:
        return None
    return next((tuple(map(str, get_args(part))) for part in parts if get_origin(part) is Literal), ())


def parse_round_image(arguments: ExportArguments | LocateArguments) -> "RoundImage | None":
    """Where the image circle is in raw images; None: it is not given."""
    if arguments.centre is None and arguments.radius_px is None:
        if arguments.forward_deg:
            raise InputError("--forward-deg needs --centre and --radius-px")
        return None
    if arguments.centre is None or arguments.radius_px is None:
        raise InputError("--centre and --radius-px: give both, or neither")
    from sim.sensors.unwrap import LARGEST_PX, MOST_DEG, RoundImage

    if not all(0 <= place <= LARGEST_PX for place in arguments.centre):
        written = " ".join(f"{place:g}" for place in arguments.centre)
        raise InputError(f"--centre {written}: must be column and row, each from 0 to {LARGEST_PX} px")
    if not 1 <= arguments.radius_px <= LARGEST_PX:
        raise InputError(f"--radius-px {arguments.radius_px:g}: must be from 1 to {LARGEST_PX} px")
    if not abs(arguments.forward_deg) <= MOST_DEG:  # also refuses NaN
        raise InputError(f"--forward-deg {arguments.forward_deg:g}: must be from -{MOST_DEG} to {MOST_DEG}")
    return RoundImage(arguments.centre, arguments.radius_px, arguments.forward_deg)


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
        if dash:
            seeds = list(range(int(first), min(int(last), int(first) + MOST_SEEDS) + 1))
        else:
            seeds = [int(part) for part in text.split(",")]
    except ValueError:
        seeds = []
    if not seeds or min(seeds) < 0 or len(seeds) > MOST_SEEDS:
        raise InputError(f"--seeds {text!r}: one to a hundred whole numbers, as 0-3 or 0,2,5")
    return seeds


def _split(words: Sequence[str], own_options: Sequence[str]) -> tuple[list[str], dict[str, Any]]:
    """Separate the command's own words from overrides such as ``--room.seed 3``, which the scenario itself checks."""
    own, overrides = [], {}
    flag, values = None, []
    for word in [*words, "--"]:
        if not word.startswith("--"):
            values.append(word)
            continue
        if flag is None or flag in own_options:
            own += [*([flag] if flag else []), *values]
        elif (kind := find_type(name := from_option(flag), Scenario)) is None:
            raise InputError(f"{shorten(flag)}: {_explain_unknown(name, own_options)}")
        elif not values and kind is bool:
            overrides[name] = True
        elif not values:
            raise InputError(f"{flag} needs a value")
        else:
            plain = [None if value.lower() in {"none", "null"} else value for value in values]
            overrides[name] = plain if name == "methods" else plain[0]
            if len(plain) > 1 and name != "methods":
                raise InputError(f"{flag} takes one value, not {' '.join(values)}")
        flag, _, value = word.partition("=")
        values = [value] if value else []
    return own, overrides


def _explain_unknown(name: str, own_options: Sequence[str]) -> str:
    """What to say of an option that is no setting."""
    if renamed := explain_setting(name, as_option):
        return renamed
    like = [find_like(as_option(name), own_options)] if "." not in name else []
    found = [*like, *map(as_option, find_settings_like(name, Scenario))]
    group = next((field for key, field in _list_groups() if key == name.rpartition(".")[0]), None)
    if not any(found) and group:
        settings = (as_option(f"{name.rpartition('.')[0]}.{key}") for key in group.model_fields)
        return f"there is no such setting; there are {', '.join(settings)}"
    return f"there is no such setting{suggest(found) or '; deepgps run --help-all lists them'}"


def _list_groups() -> list[tuple[str, type[Group]]]:
    """Groups of a scenario's settings by name, then those inside them."""
    groups = _list_inner_groups("", Scenario)
    return [*groups, *(inner for name, group in groups for inner in _list_inner_groups(f"{name}.", group))]


def _list_inner_groups(before: str, kind: type[Group]) -> list[tuple[str, type[Group]]]:
    found = ((before + name, find_group(field.annotation)) for name, field in kind.model_fields.items())
    return [(name, group) for name, group in found if group]


def _list_options(options: Sequence[str]) -> str:
    return f"; there are {', '.join(options)}" if options else "; there are none"


def _help_with_scenario(command: str, words: Sequence[str], about: str | None) -> None:
    """Print the help that the words ask for, and exit."""
    asked = next(place for place, word in enumerate(words) if word in HELP)
    topic = from_option(next(iter(words[asked + 1 :]), ""))
    if words[asked] == "--help-all" or topic == "all":
        _show_settings(command, about)
    if not topic or words[asked + 1].startswith("-"):
        print(write_help(command, about))
        raise SystemExit(0)
    groups = dict(_list_groups())
    if topic not in groups:
        hint = suggest([find_like(topic, groups)]) or f"; there are {', '.join(groups)}, all"
        raise InputError(f"deepgps {command} --help {shorten(topic)}: there is no such group of settings{hint}")
    shown = Annotated[groups[topic], tyro.conf.arg(name=topic), tyro.conf.FlagConversionOff]
    settings = make_dataclass("Settings", [("group", shown, groups[topic]())])
    _show_arguments(settings, command, f"Settings of the group {topic}.")


def _show_settings(command: str, about: str | None) -> None:
    @dataclass(frozen=True)
    class Everything(RunArguments):
        settings: Annotated[Scenario, tyro.conf.arg(name=""), tyro.conf.FlagConversionOff] = Scenario()  # noqa: RUF009 (frozen)

    _show_arguments(Everything, command, about)


def _show_arguments(kind: Any, command: str, about: str | None) -> None:
    tyro.cli(kind, args=["--help"], prog=f"deepgps {command}", description=about, config=CONFIG)


def _first_sentence(said: str) -> str:
    """What tyro says is wrong, without its title, its rules and what follows the second of these."""
    lines = [line.strip("│ ") for line in said.splitlines() if line.strip("│ ") and line[:1] not in "╭╰"]
    rules = [number for number, line in enumerate(lines) if not line.strip("-─├┤")]
    if len(rules) > 1:
        lines = lines[rules[0] + 1 : rules[1]]
    elif rules:
        lines = lines[: rules[0]]
    sentence = " ".join(lines).partition(" Got errors:")[0] or said.strip()
    wrong = re.match(r"Error parsing (\S+): no type matching (.*) could be instantiated from \['(.*)'\]", sentence)
    return f"{wrong[1]} {wrong[3]}: must be {wrong[2].replace('{None}|', '')}" if wrong else sentence
