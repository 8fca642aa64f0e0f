"""The command that says where images were taken."""

import json
import os
import sys
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from deepgps.commands.parse import Live, OptionalFile, OptionalMethod, Plugins, RunFolder, parse
from deepgps.commands.round_image import Centre, Forward, Radius, parse_round_image
from deepgps.terminal.console import errors, print_error
from deepgps.terminal.progress import show_progress
from sim.errors import WorkError


@dataclass(frozen=True)
class LocateArguments:
    run: RunFolder
    """The folder of a run."""
    source: Annotated[str, tyro.conf.arg(metavar="SOURCE"), tyro.conf.Positional]
    """An image, a folder of images, - for standard input (each image after its length in four bytes, the most
    significant first), or, with --config, a log. Images of the recording's rings and sectors are polar, others raw."""
    config: OptionalFile = None
    """The robot.yaml with which a log would be imported."""
    track: bool = False
    """Track the robot by the images so far and the wheels of a log."""
    causes: bool = False
    """Name the cause for which an image is refused or suspicious, by it and the images before."""
    live: Live = None
    """Show poses as they come, in a new viewer or in one that listens at HOST:PORT or a rerun+http URL."""
    method: OptionalMethod = None
    """The method; none: the run's first."""
    frame: Literal["world", "map"] | None = None
    """Frame of the poses: the world's, or the map's own; none: the world's where evaluation has placed the map."""
    centre: Centre = None
    """Optical axis in raw images [px]; none: raw images are square, and the image circle fills them."""
    radius_px: Radius = None
    """Radius of the image circle in raw images [px]."""
    forward_deg: Forward = 0.0
    """Direction of the robot's forward axis in raw images, clockwise from the top [deg]; needs --centre."""
    plugin: Plugins = ()
    """Files of plugins that define methods of the run."""


def locate_command(words: Sequence[str]) -> None:
    """Say where images were taken: one line of JSON for each, as they come; exit code 1 if one could not be read."""
    arguments = parse(LocateArguments, "locate", words, locate_command.__doc__)
    circle = parse_round_image(arguments.centre, arguments.radius_px, arguments.forward_deg)
    from deepgps.api.run import load
    from deepgps.robot_io.locate.locate import Wish, describe, locate_source

    run, wrong, total = load(arguments.run, arguments.plugin), 0, 0
    frame = arguments.frame or run.choose_frame(arguments.method)
    wish = Wish(arguments.method, frame, circle, arguments.config, arguments.track, arguments.causes)
    with (
        show_progress(errors, quiet_s=2.0) as progress,
        locate_source(run, arguments.source, sys.stdin.buffer, wish, progress) as found,
        _watch_located(arguments.live, run.folder / "recording", frame == "world") as show,
    ):
        for one in found:
            print(json.dumps(describe(one, frame)), flush=True)
            if one.pose is not None and one.polar is not None:
                pose = one.pose
                show(one.picture.time_s, one.polar, pose.position, pose.yaw, pose.radius_95, pose.accepted)
            wrong, total = wrong + (one.pose is None), total + 1
    if wrong:
        raise WorkError(f"{wrong} of {total} images could not be located; their lines say why")


def _watch_located(live: tuple[str, ...] | None, recording: Path, in_world: bool) -> AbstractContextManager[Any]:
    """What is called with each pose: it shows them in a viewer if that is asked for."""
    if live is None:
        return nullcontext(lambda *_: None)
    os.environ.setdefault("RUST_LOG", "off")  # as for the live view of a run
    from deepgps.viewer.located import show_located

    return show_located(" ".join(live), recording, in_world, lambda text: print_error("warning", text))
