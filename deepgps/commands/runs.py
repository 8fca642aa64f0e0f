"""The command that lists runs."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from deepgps.commands.parse import parse


@dataclass(frozen=True)
class RunsArguments:
    folder: Annotated[Path, tyro.conf.arg(metavar="FOLDER"), tyro.conf.Positional] = Path("runs")
    """The folder whose runs are listed, with those one level further down; a study's folder, too."""
    empty_drives: bool = False
    """Remove the drives that are kept for later runs to share; the runs that exist keep theirs."""


def runs_command(words: Sequence[str]) -> None:
    """List runs: what each changes in its scenario, its errors, and its age."""
    arguments = parse(RunsArguments, "runs", words, runs_command.__doc__)
    from deepgps.runs.run_table import tabulate_runs
    from deepgps.runs.shared_drive import STORE, empty_store, measure_store
    from sim.files.atomic import write_size

    if arguments.empty_drives:
        return empty_store(arguments.folder)
    print(tabulate_runs(arguments.folder))
    if size := measure_store(arguments.folder):
        print(f"{write_size(size)} in {arguments.folder / STORE}: drives that later runs share, as these runs do")
        print("deepgps runs --empty-drives removes them; the runs keep theirs")
