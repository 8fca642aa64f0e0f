"""The commands about this machine and the rooms that it can draw: doctor, rooms."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, get_args

import tyro

from deepgps.commands.parse import File
from deepgps.terminal.console import console, errors, say
from deepgps.terminal.progress import show_progress
from sim.errors import InputError, WorkError
from sim.files.atomic import check_overwrite
from sim.settings import RoomKind


@dataclass(frozen=True)
class DoctorArguments:
    pass


def doctor_command(arguments: DoctorArguments) -> None:
    """Check this machine's renderer, packages, processor and device, and say how to fix what is missing."""
    from rich.markup import escape

    from deepgps.learning.trainer import describe_device
    from sim.tools.doctor import check_all

    checks = check_all()
    for check in checks:
        mark = "[green]ok[/green]  " if check.ok else "[red]fail[/red]"
        console.print(f"{mark} {check.name:<12} {escape(check.text)}", soft_wrap=True)
        if not check.ok:
            console.print(f"     {'':<12} fix: {escape(check.fix)}", soft_wrap=True)
    console.print(f"[green]ok[/green]   {'device':<12} {describe_device()}")
    if not all(check.ok for check in checks):
        raise WorkError("something is missing; the remedies are listed above")


MAX_SEEDS = 100


@dataclass(frozen=True)
class RoomsArguments:
    kinds: Annotated[str, tyro.conf.arg(metavar="KIND,KIND")] = "living_room,office,kitchen,flat"
    """Kinds of room, separated by commas, or all."""
    seeds: Annotated[str, tyro.conf.arg(metavar="FIRST-LAST")] = "0"
    """Seeds, such as 0-3 or 0,2,5."""
    out: File = Path("rooms.png")
    """The picture to write."""


def rooms_command(arguments: RoomsArguments) -> None:
    """Draw a contact sheet of generated rooms."""
    kinds, seeds = _parse_kinds(arguments.kinds), _parse_seeds(arguments.seeds)
    from deepgps.runs.collect import choose_renderer

    choose_renderer()
    from sim.tools.gallery import draw_gallery, is_gallery

    check_overwrite(arguments.out, is_gallery)
    with show_progress(errors) as progress:
        draw_gallery(kinds, seeds, arguments.out, progress)
    say(f"wrote {arguments.out}")


def _parse_kinds(text: str) -> list[Any]:
    kinds = list(get_args(RoomKind)) if text == "all" else text.split(",")
    for kind in kinds:
        if kind not in get_args(RoomKind):
            raise InputError(f"--kinds {kind!r} does not exist; there are all, {', '.join(get_args(RoomKind))}")
    return kinds


def _parse_seeds(text: str) -> list[int]:
    try:
        first, dash, last = text.partition("-")
        if dash:
            seeds = list(range(int(first), min(int(last), int(first) + MAX_SEEDS) + 1))
        else:
            seeds = [int(part) for part in text.split(",")]
    except ValueError:
        seeds = []
    if not seeds or min(seeds) < 0 or len(seeds) > MAX_SEEDS:
        raise InputError(f"--seeds {text!r}: one to a hundred whole numbers, as 0-3 or 0,2,5")
    return seeds
