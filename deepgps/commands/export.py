"""The command that writes trajectories and models for other tools."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from deepgps.commands.parse import OptionalFolder, OptionalMethod, Plugins, RunFolder, parse
from deepgps.commands.round_image import Centre, Forward, Radius, parse_round_image
from deepgps.terminal.console import errors, say
from deepgps.terminal.failures import working_in
from deepgps.terminal.progress import show_progress
from sim.errors import InputError


@dataclass(frozen=True)
class ExportArguments:
    run: RunFolder
    """The folder of a run."""
    out: OptionalFolder = None
    """The folder to write, with a subfolder for each format; default: export/<name of the run's folder>. It must
    not hold an export of another run."""
    tum: bool = False
    """Write trajectories as TUM files, which evo reads: each method's and the true one, of both drives."""
    csv: bool = False
    """Write the same trajectories as CSV, with everything that a method tells of a pose."""
    mcap: bool = False
    """Write each drive as MCAP with ROS 2 messages: images, wheels, and every method's poses with covariance."""
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

    def list_formats(self) -> "list[Literal['tum', 'csv']]":
        """The formats of trajectories that are asked for."""
        chosen = {"tum": self.tum, "csv": self.csv}
        return [name for name in ("tum", "csv") if chosen[name]]


def export_command(words: Sequence[str]) -> None:
    """Write trajectories for other tools, or a trained method as a folder for a robot."""
    arguments = parse(ExportArguments, "export", words, export_command.__doc__)
    raw = parse_round_image(arguments.centre, arguments.radius_px, arguments.forward_deg)
    if not (arguments.onnx or arguments.mcap or arguments.list_formats()):
        raise InputError("deepgps export needs at least one of --tum, --csv, --mcap, --onnx")
    if raw is not None and not arguments.onnx:
        raise InputError("--centre and --radius-px are for --onnx")
    from deepgps.api.run import load
    from deepgps.robot_io.export.command import default_folder, export_drives, export_onnx

    run, method, frame = load(arguments.run, arguments.plugin), arguments.method, arguments.frame
    folder, written = arguments.out or default_folder(arguments.run), []
    with working_in(folder), show_progress(errors) as progress:
        formats = arguments.list_formats()
        if formats or arguments.mcap:
            written += export_drives(run, folder, method, frame, formats, arguments.mcap, progress)
        if arguments.onnx:
            written += export_onnx(run, folder, method, frame, raw, progress)
    for path in written:
        say(f"wrote {path}")
