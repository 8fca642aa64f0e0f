"""The command ``deepgps``: arguments in, exit code out; 0: done, 1: the work failed, 2: the input is wrong.

After a signal the exit code is 128 plus the signal's number. Output that nobody reads any more is dropped and does not
change the exit code: the work in progress is worth more than the pipe.
"""

import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from deepgps.commands.begin import IS_WORKER
from deepgps.commands.bench import BenchArguments, bench_command
from deepgps.commands.command import Command
from deepgps.commands.completion import CompletionArguments, completion_command
from deepgps.commands.diagnose import DiagnoseArguments, diagnose_command
from deepgps.commands.doctor import doctor_command
from deepgps.commands.export import ExportArguments, export_command
from deepgps.commands.import_log import ImportArguments, import_command
from deepgps.commands.locate import LocateArguments, locate_command
from deepgps.commands.parse import HELP
from deepgps.commands.rooms import RoomsArguments, rooms_command
from deepgps.commands.run import run_command, stage_command
from deepgps.commands.runs import RunsArguments, runs_command
from deepgps.commands.scenario import RunArguments
from deepgps.commands.study import StudyArguments, study_command
from deepgps.commands.track import TrackArguments, track_command
from deepgps.commands.view import ViewArguments, view_command
from deepgps.config.scenario import names_in
from deepgps.config.spelling import find_like, suggest
from deepgps.terminal.console import console, print_error, say, show_warnings, warn_plainly
from deepgps.terminal.failures import explain, find_version
from deepgps.terminal.signals import ignore_signals, stop_at_signals
from deepgps.terminal.streams import flush_streams
from sim.errors import InputError
from sim.paths import SCENARIOS
from sim.user_input import quote, shorten

if IS_WORKER:
    warn_plainly()  # a worker has no progress bars


def _stage(name: str, summary: str) -> Command:
    return Command(stage_command(name, f"{summary.capitalize()}."), summary, RunArguments)


COMMANDS = {
    "run": Command(run_command, "run a scenario: drive, see, learn, measure, show", RunArguments),
    "collect": _stage("collect", "only drive and look: make the recording"),
    "train": _stage("train", "collect, and train the methods"),
    "evaluate": _stage("evaluate", "collect, train, and measure the methods"),
    "study": Command(study_command, "run a study: many scenarios, one table", StudyArguments),
    "view": Command(view_command, "open a run or a study in Rerun, or two runs with their difference", ViewArguments),
    "import": Command(import_command, "make a recording from the log of a robot", ImportArguments),
    "diagnose": Command(diagnose_command, "say what is wrong with the wheels, and what to set", DiagnoseArguments),
    "track": Command(track_command, "track the robot through a drive, by images and odometry", TrackArguments),
    "export": Command(export_command, "write trajectories for other tools, or a method for a robot", ExportArguments),
    "locate": Command(locate_command, "say where images were taken, as they come", LocateArguments),
    "runs": Command(runs_command, "list runs by what they change, with their errors", RunsArguments),
    "rooms": Command(rooms_command, "draw a contact sheet of generated rooms", RoomsArguments),
    "bench": Command(bench_command, "measure speed, latency and memory beside naive baselines", BenchArguments),
    "completion": Command(
        lambda words: completion_command(words, COMMANDS),
        "print the completion script for bash, zsh or fish",
        CompletionArguments,
    ),
    "doctor": Command(doctor_command, "check this machine and say how to fix what is missing"),
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
        COMMANDS[first].carry_out(words[1:])
    elif first == "help" and words[1:]:
        _dispatch([*words[1:], "--help"])
    elif first in {"help", *HELP}:
        _print_help()
    elif first in {"-V", "--version"}:
        console.print(f"deepgps {find_version()}")
    elif first.startswith("-"):
        raise InputError(f"deepgps has no option {shorten(first)}; deepgps --help lists the commands")
    elif first in names_in(SCENARIOS) or Path(first).suffix in {".yaml", ".yml"}:
        raise InputError(f"command {quote(first)} does not exist, did you mean deepgps run {shorten(first)}?")
    else:
        hint = suggest([find_like(first, COMMANDS)]) or f"; there are {', '.join(COMMANDS)}"
        raise InputError(f"command {quote(first)} does not exist{hint}")


def _print_help() -> None:
    console.print("usage: deepgps COMMAND ...\nexample: deepgps run tiny\n")
    for name, command in COMMANDS.items():
        say(f"  {name:<11} {command.summary}")
    console.print("\ndeepgps COMMAND --help shows the options of a command.")


if __name__ == "__main__":
    main()
