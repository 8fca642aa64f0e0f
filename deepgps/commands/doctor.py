"""The command that checks this machine."""

from collections.abc import Sequence

from deepgps.commands.command import NoArguments
from deepgps.commands.parse import parse
from deepgps.terminal.console import console
from sim.errors import WorkError


def doctor_command(words: Sequence[str]) -> None:
    """Check this machine's renderer, packages, processor and device, and say how to fix what is missing."""
    parse(NoArguments, "doctor", words, doctor_command.__doc__)
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
