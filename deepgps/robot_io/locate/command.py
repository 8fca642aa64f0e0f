"""What ``deepgps locate`` does: opens the source, finds poses, and hands them on as they come."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from deepgps.api.run import Frame, Run
from deepgps.data.field_of_view import find_view
from deepgps.learning.trainer import use_threads
from deepgps.positioner.pose import Poses
from deepgps.positioner.positioner import headings_of
from deepgps.robot_io.locate.locate import Located, Step, find_shape, locate
from deepgps.robot_io.locate.log_source import Odometry, check_images, open_source
from deepgps.robot_io.locate.pictures import open_pictures
from deepgps.robot_io.locate.tracker import Tracker
from deepgps.robot_io.locate.unwrapping import Unwrapper
from deepgps.terminal.progress import Report
from deepgps.tracking.causes import make_monitor
from deepgps.tracking.watch import Watch
from sim.errors import InputError
from sim.sensors.camera.unwrap import RoundImage


@dataclass(frozen=True)
class Wish:
    """How images are located.

    Attributes:
        method: The method; None: the first of the run.
        frame: Frame of the poses.
        circle: Where the image circle is in raw images; None: it fills them.
        config: The robot.yaml of a log; None: the source is no log.
        track: Whether the robot is tracked, by a log's wheels.
        causes: Whether causes are named for which images are refused or suspicious.
    """

    method: str | None
    frame: Frame
    circle: RoundImage | None = None
    config: Path | None = None
    track: bool = False
    causes: bool = False


@contextmanager
def locate_source(run: Run, source: str, stdin: BinaryIO, wish: Wish, progress: Report) -> Iterator[Iterator[Located]]:
    """Locate the images of a source.

    Args:
        run: The run.
        source: An image, a folder, ``-``, or, with ``config``, a log.
        stdin: Standard input.
        wish: How.
        progress: Called with what is done before the first image.

    Yields:
        The images with their poses, each when it is asked for.

    Raises:
        InputError: The run, the source or the options cannot be used.
    """
    shape = find_shape(run)
    with use_threads(run.scenario.learn.train.threads):
        watch = open_watch(run, wish.method) if wish.causes else None
        if wish.config is None:
            if wish.track:
                raise InputError("--track needs the wheels of a log: --config robot.yaml")
            pictures = open_pictures(source, stdin)
            yield locate(run, pictures, Unwrapper(shape, wish.circle), wish.method, wish.frame, watch=watch)
            return
        if wish.circle is not None:
            raise InputError("--centre and --radius-px: a log's camera is described by --config")
        mirrored = wish.track and is_mirrored(run, wish.method)
        view_deg = find_view(run.recording)
        with open_source(Path(source), wish.config, view_deg, wish.track, progress) as log:
            check_images(log.polar, shape, view_deg)
            step = None if log.odometry is None else make_step(mirrored, log.odometry)
            yield locate(run, log.read(), log.polar.unwrap, wish.method, wish.frame, step, watch)


def open_watch(run: Run, method: str | None) -> Watch:
    """What names causes as images come; raises InputError if the method accepts all images."""
    monitor = make_monitor(run.positioner(method), run.recording)
    if monitor is None:
        raise InputError(f"--causes: method {run.choose(method)} refuses no images")
    return Watch(monitor)


def make_step(mirrored: bool, odometry: Odometry) -> Step:
    """What tracks the robot through the images of a log, by the odometry at each."""
    tracker = Tracker(mirrored)

    def step(name: str, pose: Poses) -> Poses:
        return tracker.step(pose, float(odometry.travelled_m[int(name)]), float(odometry.yaw[int(name)]))

    return step


def is_mirrored(run: Run, method: str | None) -> bool:
    """Whether turns are mirrored in a method's map; raises InputError if nothing tells, as the method gives no yaw."""
    headings = headings_of(run.positioner(method))
    if headings is None:
        raise InputError(f"--track: method {run.choose(method)} gives no yaw, so its map may be mirrored")
    return headings.chirality < 0
