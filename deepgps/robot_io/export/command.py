"""What ``deepgps export`` does: writes the chosen formats into one folder of its own."""

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from deepgps.api.run import Frame, Run
from deepgps.robot_io.export.onnx_folder import write_onnx
from deepgps.robot_io.export.trajectories import WRITE, Format, find_trajectories, write_drives, write_trajectories
from deepgps.runs.owned_folder import Kind, hold
from deepgps.terminal.progress import Report
from sim.errors import InputError
from sim.files.atomic import sweep
from sim.files.checksums import read_json, write_json
from sim.sensors.camera.unwrap import RoundImage

FILES = re.compile(
    rf"({'|'.join(WRITE)})/(training|use)/\w+\.({'|'.join(WRITE)})|mcap/(training|use)\.mcap|onnx/(model\.onnx|meta\.json|tables\.npz|example\.py)|export\.json"
)
EXPORT = Kind("export", "onnx/model.onnx", lambda: FILES)
ABOUT = "export.json"
"""The file that says which run is exported."""


def default_folder(run: Path) -> Path:
    """Folder of a run's export if the user names none: export/<name of the run's folder>."""
    return Path("export") / run.resolve().name


def export_drives(
    run: Run,
    folder: Path,
    method: str | None,
    frame: Frame | None,
    formats: Sequence[Format],
    mcap: bool,
    progress: Report,
) -> list[Path]:
    """Write trajectories in these formats, and drives as MCAP files, into a folder; return its subfolders.

    Args:
        run: The run.
        folder: The export's folder.
        method: The only method; None: all.
        frame: Frame of the poses; None: the world's where the map has a place in it.
        formats: Formats of trajectories.
        mcap: Whether to write MCAP files.
        progress: Called with the trajectories, or messages, done and their number.
    """
    with _claim(run, folder):
        found = find_trajectories(run, method, frame, progress)  # once for all formats: every image is located
        write_trajectories(folder, found, formats)
        if mcap:
            write_drives(folder, run, found, progress)
    return [folder / name for name in (*formats, *(["mcap"] if mcap else []))]


def export_onnx(
    run: Run, folder: Path, method: str | None, frame: Frame | None, raw: RoundImage | None, progress: Report
) -> list[Path]:
    """Write a method as a model in ONNX into a folder; return its subfolder.

    Args:
        run: The run.
        folder: The export's folder.
        method: The method; None: the first of the run.
        frame: Frame of the poses; None: the world's where the map has a place in it.
        raw: Where the image circle is in raw images; None: the model takes polar images alone.
        progress: Called with the steps done and their number.
    """
    name = run.choose(method)
    alignment = run.alignment(name, frame or run.choose_frame(name))
    with _claim(run, folder):
        progress("onnx", 0, 1)
        write_onnx(folder / "onnx", name, run.positioner(name), alignment, raw)
        progress("onnx", 1, 1)
    return [folder / "onnx"]


@contextmanager
def _claim(run: Run, folder: Path) -> Iterator[None]:
    """Hold an export folder for this run; raise InputError if it holds files of another run, which would be mixed."""
    with hold(folder, EXPORT):
        sweep(folder, FILES)
        path, own = folder / ABOUT, str(run.folder.resolve())
        begun = path.is_file()
        if begun and (held := read_json(path).get("run")) != own:
            raise InputError(f"--out {folder} holds an export of the run {held}, not of {own}; choose another folder")
        write_json(path, {"run": own})
        try:
            yield
        except InputError:
            if not begun:  # wrong input leaves nothing behind
                path.unlink()
            raise
