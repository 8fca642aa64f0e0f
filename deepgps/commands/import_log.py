"""The command that makes a recording from the log of a robot."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from deepgps.commands.parse import OptionalFile, OptionalFolder, parse
from deepgps.terminal.console import errors, quote_path, say
from deepgps.terminal.progress import show_progress
from sim.errors import InputError


@dataclass(frozen=True)
class ImportArguments:
    log: Annotated[Path, tyro.conf.arg(metavar="LOG"), tyro.conf.Positional]
    """A .bag, .mcap or .db3 file, a folder of them, or a folder with images and wheels.csv."""
    config: OptionalFile = None
    """What the log does not say of its robot: robot.yaml, which --look proposes."""
    out: OptionalFolder = None
    """Folder for the recording: new or empty, and no symbolic link."""
    look: bool = False
    """Only print what the log holds, and propose a robot.yaml."""


def import_command(words: Sequence[str]) -> None:
    """Make a recording from the log of a robot: ROS 1 bags, ROS 2 db3 or MCAP files, or a folder of plain files."""
    arguments = parse(ImportArguments, "import", words, import_command.__doc__)
    if arguments.look == (arguments.config is not None or arguments.out is not None):
        raise InputError("deepgps import takes --look, or --config FILE and --out FOLDER")
    from deepgps.robot_io.logs.look import look

    if arguments.look:
        with show_progress(errors) as progress:
            text = look(arguments.log, progress)
        print(text)
        return
    if arguments.config is None or arguments.out is None:
        raise InputError("deepgps import needs both --config FILE and --out FOLDER; --look proposes the file")
    from deepgps.robot_io.logs.importing import import_log
    from deepgps.robot_io.logs.robot_config import load_config
    from deepgps.robot_io.logs.summary import write_summary
    from sim.files.checksums import sha256

    config = load_config(arguments.config)
    with show_progress(errors) as progress:
        about = import_log(arguments.log, config, arguments.out, progress, sha256(arguments.config))
    say(write_summary(about))
    method = " --methods deepgps_compass" if about["turns_seen"] else ""
    say(f"\nimported: {arguments.out}; train on it: deepgps run {quote_path(arguments.out)}{method}")
