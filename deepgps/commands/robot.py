"""The commands between deepgps and a robot: import its logs, locate its images, export what was learned."""

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from deepgps.commands.parse import Live, OptionalFile, OptionalFolder, OptionalMethod, Plugins, RunFolder, watch
from deepgps.terminal.console import console, errors, quote_path, say
from deepgps.terminal.failures import working_in
from deepgps.terminal.progress import show_progress
from sim.errors import InputError, WorkError

if TYPE_CHECKING:
    from sim.sensors.camera.unwrap import RoundImage


Centre = Annotated[tuple[float, float] | None, tyro.conf.arg(metavar="COLUMN ROW")]
Radius = Annotated[float | None, tyro.conf.arg(metavar="PX")]
Forward = Annotated[float, tyro.conf.arg(metavar="DEG")]


def parse_round_image(centre: Centre, radius_px: Radius, forward_deg: Forward) -> "RoundImage | None":
    """Where the image circle is in raw images; None: it is not given."""
    if centre is None and radius_px is None:
        if forward_deg:
            raise InputError("--forward-deg needs --centre and --radius-px")
        return None
    if centre is None or radius_px is None:
        raise InputError("--centre and --radius-px: give both, or neither")
    from sim.sensors.camera.unwrap import MAX_SIDE_PX, MAX_YAW_DEG, RoundImage

    if not all(0 <= place <= MAX_SIDE_PX for place in centre):
        written = " ".join(f"{place:g}" for place in centre)
        raise InputError(f"--centre {written}: must be column and row, each from 0 to {MAX_SIDE_PX} px")
    if not 1 <= radius_px <= MAX_SIDE_PX:
        raise InputError(f"--radius-px {radius_px:g}: must be from 1 to {MAX_SIDE_PX} px")
    if not abs(forward_deg) <= MAX_YAW_DEG:  # also refuses NaN
        raise InputError(f"--forward-deg {forward_deg:g}: must be from -{MAX_YAW_DEG} to {MAX_YAW_DEG}")
    return RoundImage(centre, radius_px, forward_deg)


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


def import_command(arguments: ImportArguments) -> None:
    """Make a recording from the log of a robot: ROS 1 bags, ROS 2 db3 or MCAP files, or a folder of plain files."""
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
    from deepgps.robot_io.logs.matching import write_summary
    from deepgps.robot_io.logs.robot_config import load_config
    from sim.files.checksums import sha256

    config = load_config(arguments.config)
    with show_progress(errors) as progress:
        about = import_log(arguments.log, config, arguments.out, progress, sha256(arguments.config))
    say(write_summary(about))
    method = "registration" if about["turns_seen"] else "registration_distances"
    say(f"\nimported: {arguments.out}; train on it: deepgps run {quote_path(arguments.out)} --methods {method}")


@dataclass(frozen=True)
class WheelsArguments:
    files: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="FILE ..."), tyro.conf.Positional]
    """A CSV file for each run: time_s, x_m, y_m, yaw_rad by a tracker, and left_ticks, right_ticks (counts so far) or
    left_increment, right_increment (ticks since the row before). Without a header: time, x, y, yaw, right, left."""
    wheel_diameter_m: Annotated[float, tyro.conf.arg(metavar="M")]
    """Diameter of the wheels, as assumed [m]."""
    track_m: Annotated[float, tyro.conf.arg(metavar="M")]
    """Distance between the wheels, as assumed [m]."""
    ticks_per_rev: Annotated[float, tyro.conf.arg(metavar="N")]
    """Ticks of a wheel's turn, with its gear."""
    same_day: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    """Files whose names begin with the same N characters are left out together; none: each file alone."""


def wheels_command(arguments: WheelsArguments) -> None:
    """Calibrate a real robot's wheels by runs with true poses, and say which settings of the simulator do the same."""
    from deepgps.evaluation.wheels import measure_wheels, read_run
    from deepgps.reports.wheels_page import print_wheels

    assumed, per_rev = (*[arguments.wheel_diameter_m / 2.0] * 2, arguments.track_m), arguments.ticks_per_rev
    if not (min(assumed) > 0.0 and 4.0 <= per_rev <= 65536.0):
        raise InputError("--wheel-diameter-m and --track-m must be greater than 0, --ticks-per-rev from 4 to 65536")
    runs = [read_run(path, per_rev, assumed) for path in arguments.files]
    wheels = measure_wheels(runs, [path.name[: arguments.same_day] for path in arguments.files], assumed)
    print_wheels(wheels, assumed, wheels.model.make_settings(assumed, per_rev), console)


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


def locate_command(arguments: LocateArguments) -> None:
    """Say where images were taken: one line of JSON for each, as they come; exit code 1 if one could not be read."""
    circle = parse_round_image(arguments.centre, arguments.radius_px, arguments.forward_deg)
    from deepgps.api.run import load
    from deepgps.robot_io.locate import describe, locate_source

    run, wrong, total = load(arguments.run), 0, 0
    frame = arguments.frame or run.choose_frame(arguments.method)
    room, hide = (run.folder / "recording", frame == "world"), lambda *_: None
    with (
        show_progress(errors, quiet_s=2.0) as progress,
        locate_source(
            run,
            arguments.source,
            sys.stdin.buffer,
            progress,
            method=arguments.method,
            frame=frame,
            circle=circle,
            config=arguments.config,
            track=arguments.track,
            causes=arguments.causes,
        ) as found,
        watch(arguments.live, "located:show_located", hide, *room) as show,
    ):
        for one in found:
            print(json.dumps(describe(one, frame)), flush=True)
            if one.pose is not None and one.image is not None:
                pose = one.pose
                show(one.time_s, one.image, pose.position, pose.yaw, pose.radius_95, pose.accepted)
            wrong, total = wrong + (one.pose is None), total + 1
    if wrong:
        raise WorkError(f"{wrong} of {total} images could not be located; their lines say why")


@dataclass(frozen=True)
class ExportArguments:
    run: RunFolder
    """The folder of a run."""
    out: OptionalFolder = None
    """The folder to write, with a subfolder for each format; default: export/<name of the run's folder>. It must
    not hold an export of another run."""
    tum: bool = False
    """Write trajectories as TUM files, which evo reads: each method's and the true one, of both drives."""
    onnx: bool = False
    """Write one method as a model in ONNX with an example; needs the extra deepgps[onnx]."""
    method: OptionalMethod = None
    """The method; none: the run's first as ONNX, all as trajectories."""
    frame: Literal["world", "map"] | None = None
    """Frame of the poses: the world's, or the map's own; none: the world's where evaluation has placed the map."""
    centre: Centre = None
    """Optical axis in raw images [px]; with it and --radius-px, the exported folder positions raw images too."""
    radius_px: Radius = None
    """Radius of the image circle in raw images [px]."""
    forward_deg: Forward = 0.0
    """Direction of the robot's forward axis in raw images, clockwise from the top [deg]."""
    plugin: Plugins = ()
    """Files of plugins that define methods of the run."""


def export_command(arguments: ExportArguments) -> None:
    """Write trajectories for other tools, or a trained method as a folder for a robot."""
    raw = parse_round_image(arguments.centre, arguments.radius_px, arguments.forward_deg)
    if not (arguments.onnx or arguments.tum):
        raise InputError("deepgps export needs --tum, --onnx or both")
    if raw is not None and not arguments.onnx:
        raise InputError("--centre and --radius-px are for --onnx")
    from deepgps.api.run import load
    from deepgps.robot_io.export import export_onnx, export_tum

    run, method, frame = load(arguments.run), arguments.method, arguments.frame
    folder, written = arguments.out or Path("export") / arguments.run.resolve().name, []
    with working_in(folder), show_progress(errors) as progress:
        if arguments.tum:
            written += export_tum(run, folder, method, frame, progress)
        if arguments.onnx:
            written += export_onnx(run, folder, method, frame, raw, progress)
    for path in written:
        say(f"wrote {path}")
