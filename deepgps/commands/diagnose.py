"""The command that diagnoses the wheels of a recording."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from deepgps.commands.parse import OptionalFile, parse
from deepgps.terminal.console import console, errors, say
from deepgps.terminal.progress import show_progress
from sim.files.atomic import check_overwrite


@dataclass(frozen=True)
class DiagnoseArguments:
    recording: Annotated[Path, tyro.conf.arg(metavar="RECORDING"), tyro.conf.Positional]
    """The folder of a recording or of a run."""
    out: OptionalFile = None
    """The file to write; default: diagnosis.json in the run's folder; for a recording of no run, no file."""


def diagnose_command(words: Sequence[str]) -> None:
    """Say what is wrong with the wheels of a recording, how sure that is, and what to set; no ground truth is used."""
    arguments = parse(DiagnoseArguments, "diagnose", words, diagnose_command.__doc__)
    from deepgps.diagnosis.store import diagnose_folder, is_diagnosis
    from deepgps.reports.wheels_page import print_diagnosis

    if arguments.out is not None:
        check_overwrite(arguments.out, is_diagnosis)
    with show_progress(errors) as progress:
        diagnosis, written = diagnose_folder(arguments.recording, arguments.out, progress)
    print_diagnosis(diagnosis, console)
    if written is not None:
        say(f"\nwrote {written}")
