"""The command that draws generated rooms."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, get_args

import tyro

from deepgps.commands.parse import File, parse
from deepgps.terminal.console import errors, say
from deepgps.terminal.progress import show_progress
from sim.errors import InputError
from sim.files.atomic import check_overwrite
from sim.settings import RoomKind

MOST_SEEDS = 100


@dataclass(frozen=True)
class RoomsArguments:
    kinds: Annotated[str, tyro.conf.arg(metavar="KIND,KIND")] = "all"
    """Kinds of room, separated by commas, or all."""
    seeds: Annotated[str, tyro.conf.arg(metavar="FIRST-LAST")] = "0-3"
    """Seeds, such as 0-3 or 0,2,5."""
    out: File = Path("rooms.png")
    """The picture to write."""


def rooms_command(words: Sequence[str]) -> None:
    """Draw a contact sheet of generated rooms."""
    arguments = parse(RoomsArguments, "rooms", words, rooms_command.__doc__)
    kinds, seeds = _parse_kinds(arguments.kinds), _parse_seeds(arguments.seeds)
    from deepgps.runs.collect import choose_renderer

    choose_renderer()
    from sim.tools.gallery import draw_gallery, is_gallery

    check_overwrite(arguments.out, is_gallery)
    with show_progress(errors) as progress:
        draw_gallery(kinds, seeds, arguments.out, progress)
    say(f"wrote {arguments.out}")


def _parse_kinds(text: str) -> list[Any]:
    """Kinds of room from ``all`` or ``office,kitchen``."""
    kinds = list(get_args(RoomKind)) if text == "all" else text.split(",")
    for kind in kinds:
        if kind not in get_args(RoomKind):
            raise InputError(f"--kinds {kind!r} does not exist; there are all, {', '.join(get_args(RoomKind))}")
    return kinds


def _parse_seeds(text: str) -> list[int]:
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
