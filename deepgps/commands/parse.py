"""Parsing the words of a command into its arguments, and its full help."""

import contextlib
import io
import os
import re
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import fields
from functools import partial
from pathlib import Path
from pkgutil import resolve_name
from typing import Annotated, Any, get_args, get_type_hints

import tyro

from deepgps.config.spelling import as_option, find_like, suggest
from deepgps.terminal.console import print_error
from sim.errors import InputError, shorten

OptionalFolder = Annotated[Path | None, tyro.conf.arg(metavar="FOLDER")]
File = Annotated[Path, tyro.conf.arg(metavar="FILE")]
OptionalFile = Annotated[Path | None, tyro.conf.arg(metavar="FILE")]
RunFolder = Annotated[Path, tyro.conf.arg(metavar="RUN"), tyro.conf.Positional]
OptionalMethod = Annotated[str | None, tyro.conf.arg(metavar="METHOD")]
Live = Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="[HOST:PORT]")]
Plugins = Annotated[tuple[Path, ...], tyro.conf.arg(metavar="FILE [FILE ...]")]
CONFIG = (tyro.conf.FlagCreatePairsOff,)
HELP = ("-h", "--help", "--help-all")


def parse(kind: Any, command: str, words: Sequence[str], about: str | None) -> Any:
    """Parse a command's arguments; ``--help`` shows them below the description ``about`` and exits."""
    if set(HELP) & set(words):
        show_arguments(kind, command, about)
    options = list_options(kind)
    for word in words:
        name = word.partition("=")[0]
        if name.startswith("--") and name not in options:
            hint = suggest([find_like(name, options)]) or f"; there are {', '.join(options) or 'none'}"
            raise InputError(f"deepgps {command}: there is no option {shorten(name)}{hint}")
    _refuse_empty(command, words)
    said = io.StringIO()
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            return tyro.cli(kind, args=list(words), prog=f"deepgps {command}", config=CONFIG)
    except SystemExit:
        raise InputError(f"deepgps {command}: {_first_sentence(said.getvalue())}") from None


def watch(live: tuple[str, ...] | None, view: str, otherwise: Any, *arguments: Any) -> AbstractContextManager[Any]:
    """The live view "module:function" of deepgps.viewer if one is asked for, else what it would have yielded."""
    if live is None:
        return nullcontext(otherwise)
    # Rerun reads this when it is imported. It also raises what it would log, and a lost viewer deserves only one line.
    os.environ.setdefault("RUST_LOG", "off")
    warn = partial(print_error, "warning")
    return resolve_name(f"deepgps.viewer.{view}")(" ".join(live), *arguments, warn)


def list_options(kind: Any) -> list[str]:
    """Options of a command's arguments, as they are spelled on the command line."""
    positional = tyro.conf.Positional
    hints = get_type_hints(kind, include_extras=True)
    return [as_option(field.name) for field in fields(kind) if positional not in get_args(hints[field.name])]


def show_arguments(kind: Any, command: str, about: str | None) -> None:
    """Print a command's arguments below the description ``about``, and exit."""
    tyro.cli(kind, args=["--help"], prog=f"deepgps {command}", description=about, config=CONFIG)


def _refuse_empty(command: str, words: Sequence[str]) -> None:
    """Raise InputError at an empty word, as of a shell's unset variable: as a path it is the current folder."""
    for before, word in zip(("", *words), words, strict=False):
        option = word.removesuffix("=") if word.startswith("--") else before if before.startswith("--") else ""
        if not word or (word.startswith("--") and word.endswith("=")):
            raise InputError(f"deepgps {command}: {shorten(option) or 'an argument'} is empty")


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
