"""The command that tracks the robot through a drive."""

from collections.abc import Sequence
from dataclasses import dataclass

from deepgps.commands.parse import OptionalFolder, OptionalMethod, Plugins, RunFolder, parse
from deepgps.config.plugins import load_plugins
from deepgps.terminal.console import console, errors, say
from deepgps.terminal.progress import show_progress


@dataclass(frozen=True)
class TrackArguments:
    run: RunFolder
    """The folder of a run."""
    method: OptionalMethod = None
    """A method that is trained in it; none: its first."""
    drive: OptionalFolder = None
    """The folder of another recording of the same robot and room; none: the drive in use."""
    tum: OptionalFolder = None
    """Write the paths as TUM files, which evo reads, to this folder; also the truth, if it is known."""
    plugin: Plugins = ()
    """Files of plugins, with methods of your own."""


def track_command(words: Sequence[str]) -> None:
    """Track the robot through the drive in use, or another recording, by single images and odometry together."""
    arguments = parse(TrackArguments, "track", words, track_command.__doc__)
    load_plugins(arguments.plugin)
    from deepgps.evaluation.track_run import track_run, write_tums
    from deepgps.reports.track_page import draw_track, print_track

    with show_progress(errors) as progress:
        tracked = track_run(arguments.run, arguments.method, arguments.drive, progress)
    print_track(tracked, console)
    written = [tracked.path.with_suffix(".npz"), tracked.path.with_suffix(".json"), draw_track(tracked)]
    if arguments.tum is not None:
        written += write_tums(arguments.tum, tracked)
    say(f"\nwrote {', '.join(str(path) for path in written if path)}")
