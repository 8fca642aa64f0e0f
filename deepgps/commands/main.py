"""The command ``deepgps``: arguments in, exit code out; 0: done, 1: the work failed, 2: the input is wrong.

After a signal the exit code is 128 plus the signal's number. Output that nobody reads any more is dropped and does not
change the exit code: the work in progress is worth more than the pipe.
"""

import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

from deepgps.commands.begin import WORKER_PROCESS
from deepgps.terminal.console import console, print_error, say, show_warnings, warn_plainly
from deepgps.terminal.failures import explain, find_version
from deepgps.terminal.signals import ignore_signals, stop_at_signals
from deepgps.terminal.streams import flush_streams
from sim.errors import InputError, quote, shorten
from sim.files import SCENARIOS

if WORKER_PROCESS:
    warn_plainly()  # a worker has no progress bars


@dataclass(frozen=True)
class Command:
    """A command; its module is imported when it is carried out, so that the help and an error come at once."""

    module: str  # Module of ``deepgps.commands`` with the function ``<name>_command``, which takes the arguments
    arguments: str  # Name of the type of its arguments there
    summary: str  # What the command does, in a few words

    def find(self, name: str) -> Any:
        """What has this name in the command's module."""
        return resolve_name(f"deepgps.commands.{self.module}:{name}")


COMMANDS = {
    "run": Command("run", "RunArguments", "run a scenario: drive, see, learn, measure, show"),
    "collect": Command("run", "RunArguments", "only drive and look: make the recording"),
    "train": Command("run", "RunArguments", "collect, and train the methods"),
    "evaluate": Command("run", "RunArguments", "collect, train, and measure the methods"),
    "study": Command("study", "StudyArguments", "run a study: many scenarios, one table"),
    "view": Command("results", "ViewArguments", "open a run or a study in Rerun, or two runs with their difference"),
    "import": Command("robot", "ImportArguments", "make a recording from the log of a robot"),
    "diagnose": Command("results", "DiagnoseArguments", "say what is wrong with the wheels, and what to set"),
    "wheels": Command("robot", "WheelsArguments", "calibrate a real robot's wheels, and imitate their noise"),
    "track": Command("results", "TrackArguments", "track the robot through a drive, by images and odometry"),
    "navigate": Command("results", "NavigateArguments", "drive a simulated robot to goals by its own positions"),
    "export": Command("robot", "ExportArguments", "write trajectories for other tools, or a method for a robot"),
    "locate": Command("robot", "LocateArguments", "say where images were taken, as they come"),
    "runs": Command("results", "RunsArguments", "list runs by what they change, with their errors"),
    "rooms": Command("machine", "RoomsArguments", "draw a contact sheet of generated rooms"),
    "doctor": Command("machine", "DoctorArguments", "check this machine and say how to fix what is missing"),
}


def main(words: Sequence[str] | None = None) -> None:
    """Run the command line ``words`` (default: the process's own) and exit."""
    words = sys.argv[1:] if words is None else words
    # torch reads this when it is imported: threads that spin while they wait make a busy machine five times slower.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    os.environ["MPLBACKEND"] = "agg"  # figures are drawn off-screen; importing matplotlib fails with a backend it lacks
    stop_at_signals()
    code = 0
    try:
        try:
            with show_warnings():
                _dispatch(words)
        except SystemExit as ended:  # after --help
            code = ended.code if isinstance(ended.code, int) else 0
        flush_streams()
    except (Exception, KeyboardInterrupt) as error:
        number = ignore_signals()
        code, kind, text = explain(error, words, number)
        print_error(kind, text)
        with suppress(OSError):
            flush_streams()
        if number is not None:  # every file is intact, and a package stopped in mid-work may never end
            os._exit(code)
    ignore_signals()
    if code:
        sys.exit(code)


def _dispatch(words: Sequence[str]) -> None:
    first = words[0] if words else "help"
    if first in COMMANDS:
        _carry_out(first, COMMANDS[first], words[1:])
    elif first == "help" and words[1:]:
        _dispatch([*words[1:], "--help"])
    elif first in {"help", "-h", "--help", "--help-all"}:
        _print_help()
    elif first in {"-V", "--version"}:
        console.print(f"deepgps {find_version()}")
    elif first.startswith("-"):
        raise InputError(f"deepgps has no option {shorten(first)}; deepgps --help lists the commands")
    else:
        _refuse_command(first)


def _carry_out(name: str, command: Command, words: Sequence[str]) -> None:
    """Do a command with its words; it parses these itself where they hold a scenario or a study."""
    do = command.find(f"{name}_command")
    if command.module in {"run", "study"}:
        return do(words)
    from deepgps.commands.parse import parse
    from deepgps.config.plugins import load_plugins

    arguments = parse(command.find(command.arguments), name, words, do.__doc__)
    load_plugins(getattr(arguments, "plugin", ()))
    do(arguments)


def _refuse_command(first: str) -> None:
    from deepgps.config.scenario import names_in
    from deepgps.config.spelling import find_like, suggest

    if first in names_in(SCENARIOS) or Path(first).suffix in {".yaml", ".yml"}:
        raise InputError(f"command {quote(first)} does not exist, did you mean deepgps run {shorten(first)}?")
    hint = suggest([find_like(first, COMMANDS)]) or f"; there are {', '.join(COMMANDS)}"
    raise InputError(f"command {quote(first)} does not exist{hint}")


def _print_help() -> None:
    console.print("usage: deepgps COMMAND ...\nexample: deepgps run tiny\n")
    for name, command in COMMANDS.items():
        say(f"  {name:<11} {command.summary}")
    console.print("\ndeepgps COMMAND --help shows the options of a command.")


if __name__ == "__main__":
    main()
