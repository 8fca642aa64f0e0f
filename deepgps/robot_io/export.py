"""What is exported of a run: its folder, and a trained method as a model in ONNX that needs no torch."""

import logging
import re
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch

from deepgps.api.run import Frame, Run
from deepgps.learning.trainer import load_triton
from deepgps.positioner.positioner import NetworkPositioner, Positioner
from deepgps.robot_io.deployed import Deployed
from deepgps.robot_io.trajectories import WRITERS, Format, find_trajectories, write_drives, write_trajectories
from deepgps.runs.owned_folder import Kind, hold
from deepgps.terminal.progress import Report
from sim.alignment import Alignment
from sim.errors import InputError, WorkError
from sim.files.atomic import sweep, write_atomic, write_size, write_text
from sim.files.checksums import read_json, write_arrays, write_json
from sim.sensors.camera.mount import map_pixels, pad
from sim.sensors.camera.unwrap import RoundImage

FILES = re.compile(
    rf"({'|'.join(WRITERS)})/(training|use)/\w+\.({'|'.join(WRITERS)})|mcap/(training|use)\.mcap|onnx/(model\.onnx|meta\.json|tables\.npz|example\.py)|export\.json"
)
EXPORT = Kind("export", "onnx/model.onnx", lambda: FILES)
ABOUT_FILE = "export.json"  # The file that says which run is exported


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
    """Write trajectories in these formats, and drives as MCAP files if asked, into a folder; return its subfolders.

    They are of one method, or of all, in a frame, or in the world's where the map has a place in it.
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
    """Write a method, or the first, as a model in ONNX into a folder; return its subfolder.

    The frame is the world's, if none is given, where the map has a place in it. Without the image circle of raw images,
    the model takes polar images alone.
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
        path, own = folder / ABOUT_FILE, str(run.folder.resolve())
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


MODEL, META, TABLES, EXAMPLE = "model.onnx", "meta.json", "tables.npz", "example.py"
MAX_BYTES = 20_000_000  # Largest folder that is written
OUTPUTS = {
    "position": "x, y of the robot [m]",
    "position_std": "standard deviation of the position along one axis by the map alone [m]",
    "yaw": "counter-clockwise from x [rad]; NaN: the image shows no direction",
    "yaw_std": "standard deviation of the yaw if it is right [rad]",
    "yaw_weight": "share of the stored images that agree on the yaw",
    "other_yaw": "second hypothesis of the yaw [rad]; NaN: there is none",
    "other_weight": "its share",
    "novelty": "how unlike the training images near by the image is, as a distance on the map [m]",
    "radius_68": "radius that holds the true position with a probability of 68 % [m]",
    "radius_95": "the same for 95 % [m]",
    "accepted": "whether the novelty is one that images of the drive have; do not use other positions",
}


def write_onnx(
    folder: Path,
    method: str,
    positioner: Positioner,
    alignment: Alignment | None,
    raw: RoundImage | None,
) -> None:
    """Write the folder of a method; the alignment is from its map to the frame of the poses.

    Without ``raw``, the folder takes polar images alone. Raises InputError if the method is no network on polar images
    or a package is missing, WorkError if the folder would have more than 20 MB.
    """
    if not isinstance(positioner, NetworkPositioner) or len(positioner.shape) != 3:
        raise InputError(f"--onnx: method {method} is no network on polar images, and only these are written as ONNX")
    model, names = build_model(positioner, alignment)
    tables = make_tables(positioner, raw)
    size = len(model) + sum(table.nbytes for table in tables.values())
    if size > MAX_BYTES:
        raise WorkError(f"--onnx: the folder would have {write_size(size)}, and at most {write_size(MAX_BYTES)} fit")
    write_atomic(folder / MODEL, lambda part: part.write_bytes(model), len(model))
    write_arrays(folder / TABLES, tables)
    write_text(folder / EXAMPLE, Path(__file__).with_name(EXAMPLE).read_text(encoding="utf-8"))
    write_json(folder / META, describe_folder(method, positioner, names, alignment, raw))


def build_model(positioner: NetworkPositioner, alignment: Alignment | None) -> tuple[bytes, list[str]]:
    """The model, which takes images (B, rings, sectors, 3) uint8 of an upright camera, and the names of its outputs."""
    try:
        import onnxscript  # noqa: F401  torch imports it too, with a longer message
    except ModuleNotFoundError:
        raise InputError(
            "--onnx needs pip install onnx onnxscript onnxruntime (in a checkout: make setup-dev)"
        ) from None
    load_triton()
    module = Deployed(positioner, alignment).eval()
    some = torch.zeros((2, *positioner.shape), dtype=torch.uint8)
    with _quiet(), torch.inference_mode():
        names = list(module(some))
        program = torch.onnx.export(
            module,
            (some,),
            dynamo=True,
            input_names=["image"],
            output_names=names,
            dynamic_shapes=({0: torch.export.Dim("batch")},),
            verbose=False,
        )
    assert program is not None
    return program.model_proto.SerializeToString(), names


def make_tables(positioner: NetworkPositioner, raw: RoundImage | None) -> dict[str, np.ndarray]:
    """What ``cv2.remap`` needs to make the model's images of raw ones, and of those of a leaning camera."""
    rings, sectors, _ = positioner.shape
    tables = {}
    if raw is not None:
        column, row = raw.find_points(rings, sectors)
        tables |= {"raw_column": column, "raw_row": row}
    if positioner.upright is not None and any(positioner.upright.lean):
        pixel = pad(np.arange(rings * sectors, dtype=np.int32).reshape(rings, sectors, 1))[..., 0]
        column, row = map_pixels(positioner.upright, rings, sectors)
        tables |= {"lean_pixel": pixel, "lean_column": column, "lean_row": row}
    return tables


def describe_folder(
    method: str,
    positioner: NetworkPositioner,
    outputs: list[str],
    alignment: Alignment | None,
    raw: RoundImage | None,
) -> dict[str, Any]:
    """Contents of ``meta.json``."""
    lean = positioner.upright.lean if positioner.upright else (0.0, 0.0)
    return {
        "method": method,
        "frame": "map" if alignment is None else "world",
        "image": list(positioner.shape),
        "mirrored": is_mirrored(positioner, alignment),
        "outputs": {name: OUTPUTS[name] for name in outputs},
        "raw": raw and {"centre_px": list(raw.centre), "radius_px": raw.radius_px, "forward_deg": raw.forward_deg},
        "lean_deg": np.degrees(lean).round(4).tolist(),
        "mount_m": list(positioner.mount),
    }


def is_mirrored(positioner: NetworkPositioner, alignment: Alignment | None) -> bool | None:
    """Whether a turn to the left is one to the right in the frame of the poses; None: the method gives no yaw."""
    if positioner.headings is None:
        return None
    turn = 1.0 if alignment is None else float(np.linalg.det(alignment.rotation))
    return positioner.headings.chirality * turn < 0


@contextmanager
def _quiet() -> Iterator[None]:
    """Without what torch's exporter says of itself and of packages that are not needed."""
    logger = logging.getLogger("torch.onnx")
    before = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.setLevel(before)
