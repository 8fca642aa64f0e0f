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


def runs_command(words: Sequence[str]) -> None:
    """List runs: what each changes in its scenario, its errors, and its age."""
    arguments = parse(RunsArguments, "runs", words, runs_command.__doc__)
    from deepgps.runs.run_table import tabulate_runs

    print(tabulate_runs(arguments.folder))
