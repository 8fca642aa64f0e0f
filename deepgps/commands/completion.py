"""The command that prints the script of a shell that completes words."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

import tyro

from deepgps.commands.command import Command
from deepgps.commands.completion_scripts import SHELLS, Words
from deepgps.commands.parse import list_options, parse
from deepgps.commands.scenario import RunArguments
from deepgps.commands.study import StudyArguments
from deepgps.config.methods import METHODS
from deepgps.config.scenario import Scenario, names_in
from deepgps.config.spelling import as_option, from_option, list_settings
from sim.paths import SCENARIOS, STUDIES


@dataclass(frozen=True)
class CompletionArguments:
    shell: Annotated[Literal["bash", "zsh", "fish"], tyro.conf.arg(metavar="bash|zsh|fish"), tyro.conf.Positional]
    """The shell that reads the script."""


def completion_command(words: Sequence[str], commands: Mapping[str, Command]) -> None:
    """Print a script that completes commands, scenarios, studies and options in a shell.

    For bash, put this line into ~/.bashrc: eval "$(deepgps completion bash)"
    For zsh, put this line into ~/.zshrc, after compinit: eval "$(deepgps completion zsh)"
    For fish: deepgps completion fish > ~/.config/fish/completions/deepgps.fish
    """
    arguments = parse(CompletionArguments, "completion", words, completion_command.__doc__)
    print(SHELLS[arguments.shell](_list_words(commands)))


def _list_words(commands: Mapping[str, Command]) -> dict[str, Words]:
    """What can follow each command."""
    settings = {as_option(name): _list_values(annotation) for name, annotation in list_settings(Scenario)}
    settings["--methods"] = tuple(METHODS)
    plain = {RunArguments: tuple(names_in(SCENARIOS)), StudyArguments: tuple(names_in(STUDIES))}
    words = {}
    for name, command in commands.items():
        kind = command.arguments
        hints = get_type_hints(kind)
        options = {option: _list_values(hints[from_option(option)]) for option in list_options(kind)}
        more = {"--help-all": None, **settings} if kind is RunArguments else {}
        shells = tuple(SHELLS) if kind is CompletionArguments else ()
        words[name] = Words(command.summary, plain.get(kind, shells), {**options, "--help": None, **more})
    return words


def _list_values(annotation: Any) -> tuple[str, ...] | None:
    """Values of an option of this type; () if they cannot be listed, None if it takes no value."""
    parts = (annotation, *get_args(annotation))
    if bool in parts:
        return None
    return next((tuple(map(str, get_args(part))) for part in parts if get_origin(part) is Literal), ())
