"""Scripts with which a shell completes the command's words; they hold all words, so a tab starts no process."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

Options = Mapping[str, tuple[str, ...] | None]
"""The values of each option: () for a number, a text or a path, None for an option without a value."""


@dataclass(frozen=True)
class Words:
    """What can follow a command.

    Attributes:
        summary: What the command does.
        plain: Words that are no options, such as names of scenarios; files are completed in any case.
        options: Its options, with their values.
    """

    summary: str
    plain: tuple[str, ...] = ()
    options: Options = field(default_factory=dict)


def write_bash(commands: Mapping[str, Words]) -> str:
    """A script for bash."""
    return f"""_deepgps() {{
    local current=${{COMP_WORDS[COMP_CWORD]}} previous=${{COMP_WORDS[COMP_CWORD-1]}} reply=
    if ((COMP_CWORD == 1)); then
        reply="{" ".join(commands)}"
    else
        case ${{COMP_WORDS[1]}} in
{_write_cases(commands)}
        esac
    fi
    COMPREPLY=($(compgen -W "$reply" -- "$current"))
}}
complete -o default -F _deepgps deepgps"""


def write_zsh(commands: Mapping[str, Words]) -> str:
    """A script for zsh."""
    return f"""#compdef deepgps
_deepgps() {{
    local current=$words[CURRENT] previous=$words[CURRENT-1] reply=
    if ((CURRENT == 2)); then
        reply="{" ".join(commands)}"
    else
        case $words[2] in
{_write_cases(commands)}
        esac
    fi
    compadd -- ${{=reply}}
    [[ $current == -* ]] || _files
}}
compdef _deepgps deepgps"""


def write_fish(commands: Mapping[str, Words]) -> str:
    """A script for fish."""
    lines = [
        f"complete -c deepgps -n __fish_use_subcommand -a {name} -d '{words.summary}'"
        for name, words in commands.items()
    ]
    for names, words in _group(commands).items():
        rule = f"complete -c deepgps -n '__fish_seen_subcommand_from {' '.join(names)}'"
        lines += [f"{rule} -a '{' '.join(words.plain)}'"] if words.plain else []
        for option, values in words.options.items():
            choice = "" if values is None else f" -x -a '{' '.join(values)}'" if values else " -r"
            lines.append(f"{rule} -l {option.removeprefix('--')}{choice}")
    return "\n".join(lines)


SHELLS: dict[str, Callable[[Mapping[str, Words]], str]] = {"bash": write_bash, "zsh": write_zsh, "fish": write_fish}


def _group(commands: Mapping[str, Words]) -> dict[tuple[str, ...], Words]:
    """The words of each group of commands with the same options and plain words."""
    groups: list[tuple[list[str], Words]] = []
    for name, words in commands.items():
        for names, same in groups:
            if (same.plain, same.options) == (words.plain, words.options):
                names.append(name)
                break
        else:
            groups.append(([name], words))
    return {tuple(names): words for names, words in groups}


def _write_cases(commands: Mapping[str, Words]) -> str:
    """The part that bash and zsh share: it sets ``reply`` from the words ``previous`` and ``current``."""
    cases = []
    for names, words in _group(commands).items():
        cases += [f"        {'|'.join(names)})", "            case $previous in"]
        cases += [
            f'                {option}) reply="{" ".join(values)}";;'
            for option, values in words.options.items()
            if values
        ]
        free = "|".join(option for option, values in words.options.items() if values == ())
        cases += [f"                {free}) ;;"] if free else []
        options, plain = " ".join(words.options), " ".join(words.plain)
        choice = f'if [[ $current == -* ]]; then reply="{options}"; else reply="{plain}"; fi'
        cases += [f"                *) {choice};;", "            esac;;"]
    return "\n".join(cases)
