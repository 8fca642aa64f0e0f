"""The arguments of the commands that take a scenario: their own, and its settings."""

from collections.abc import Sequence
from dataclasses import dataclass, make_dataclass
from typing import Annotated, Any, get_origin

import tyro

from deepgps.commands.parse import (
    HELP,
    Live,
    OptionalFile,
    OptionalFolder,
    Plugins,
    list_options,
    parse,
    show_arguments,
)
from deepgps.commands.short_help import write_help
from deepgps.config.plugins import load_plugins
from deepgps.config.scenario import Scenario, names_in
from deepgps.config.spelling import (
    as_option,
    find_like,
    find_settings_like,
    find_type,
    from_option,
    list_groups,
    suggest,
)
from deepgps.runs.source import Source, find_source
from sim.errors import InputError, shorten
from sim.files import SCENARIOS


@dataclass(frozen=True)
class RunArguments:
    scenario: Annotated[str, tyro.conf.arg(metavar="SCENARIO"), tyro.conf.Positional]
    """A name in assets/scenarios, the path of a YAML file, or the folder of a run or of a recording."""
    out: OptionalFolder = None
    """The run folder itself; default: that of the run, or runs/<scenario>/seed<seed>-<hash>."""
    fresh: bool = False
    """Make the run again; the old one is replaced once the new one is complete."""
    live: Live = None
    """Show the run while it is in progress, in a new viewer or in one that listens at HOST:PORT or a rerun+http URL."""
    log: OptionalFile = None
    """Also write the log that a robot would have recorded of the drive, as MCAP: raw pictures, wheels, rays, truth."""
    plugin: Plugins = ()
    """Files of plugins, with methods and encoder faults of your own."""


@dataclass(frozen=True)
class ScenarioArguments(RunArguments):
    """The same with every setting."""

    settings: Annotated[Scenario, tyro.conf.arg(name=""), tyro.conf.FlagConversionOff] = Scenario()  # noqa: RUF009 (frozen)


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
        elif values in ([], [""]):
            raise InputError(f"{flag} needs a value")
        else:
            plain = [None if value.lower() in {"none", "null"} else value for value in values]
            several = get_origin(kind) is tuple
            overrides[name] = plain if several else plain[0]
            if len(plain) > 1 and not several:
                raise InputError(f"{flag} takes one value, not {' '.join(values)}")
        flag, equals, value = word.partition("=")
        values = [value] if equals else []
    return own, overrides


def _explain_unknown(name: str, own_options: Sequence[str]) -> str:
    like = [find_like(as_option(name), own_options)] if "." not in name else []
    found = [*like, *map(as_option, find_settings_like(name, Scenario))]
    group = dict(list_groups(Scenario)).get(name.rpartition(".")[0])
    if not any(found) and group:
        settings = (as_option(f"{name.rpartition('.')[0]}.{key}") for key in group.model_fields)
        return f"there is no such setting; there are {', '.join(settings)}"
    return f"there is no such setting{suggest(found) or '; deepgps run --help-all lists them'}"


def _help_with_scenario(command: str, words: Sequence[str], about: str | None) -> None:
    asked = next(place for place, word in enumerate(words) if word in HELP)
    topic = from_option(next(iter(words[asked + 1 :]), ""))
    if words[asked] == "--help-all" or topic == "all":
        show_arguments(ScenarioArguments, command, about)
    if not topic or words[asked + 1].startswith("-"):
        print(write_help(command, about))
        raise SystemExit(0)
    groups = dict(list_groups(Scenario))
    if topic not in groups:
        hint = suggest([find_like(topic, groups)]) or f"; there are {', '.join(groups)}, all"
        raise InputError(f"deepgps {command} --help {shorten(topic)}: there is no such group of settings{hint}")
    shown = Annotated[groups[topic], tyro.conf.arg(name=topic), tyro.conf.FlagConversionOff]
    settings = make_dataclass("Settings", [("group", shown, groups[topic]())])
    show_arguments(settings, command, f"Settings of the group {topic}.")
