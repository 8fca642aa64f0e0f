"""The command that opens runs and studies in the viewer."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from deepgps.commands.parse import Plugins, parse
from deepgps.config.plugins import load_plugins
from deepgps.terminal.console import say
from sim.errors import InputError
from sim.files.atomic import check_overwrite


@dataclass(frozen=True)
class ViewArguments:
    runs: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="RUN [RUN]"), tyro.conf.Positional]
    """The folder of a run or of a study, or those of two runs to compare."""
    web: bool = False
    """Serve the viewer and the recording to a browser on this machine, until Ctrl-C."""
    port: Annotated[int | None, tyro.conf.arg(metavar="PORT")] = None
    """Port of the page that --web serves; its data comes from the next port. None: free ports."""
    plugin: Plugins = ()
    """Files of plugins, whose methods then have their titles and colours."""
    screenshot: Path | None = None
    """Write a picture of the first tab as PNG instead of opening a window; needs Chromium, a display or xvfb-run."""


def view_command(words: Sequence[str]) -> None:
    """Open a run or a study in the Rerun viewer or a browser, or two runs with the difference of their error fields."""
    from deepgps.runs.run_folder import is_study, open_run

    arguments = parse(ViewArguments, "view", words, view_command.__doc__)
    folders = arguments.runs
    if len(folders) not in {1, 2}:
        raise InputError(f"deepgps view takes one folder, or two to compare, not {len(folders)}")
    if arguments.port is not None and not arguments.web:
        raise InputError("--port needs --web")
    load_plugins(arguments.plugin)
    if arguments.screenshot is not None and arguments.web:
        raise InputError("--screenshot writes one picture and ends; leave out --web")
    for folder in folders:
        if len(folders) == 2 or not is_study(folder):
            open_run(folder)
    # These import Rerun and torch, which takes longer than checking the folders.
    from deepgps.viewer.window.show import view
    from deepgps.viewer.window.web import choose_ports, serve

    if arguments.screenshot is not None:
        from deepgps.viewer.window.screenshot import is_screenshot, write_screenshot

        check_overwrite(arguments.screenshot, is_screenshot)
        write_screenshot(folders, arguments.screenshot)
        say(f"wrote {arguments.screenshot}")
    elif arguments.web:
        serve(folders, choose_ports(arguments.port), say)
    else:
        view(folders)
