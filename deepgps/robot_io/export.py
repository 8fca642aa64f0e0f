"""What is exported of a run: its folder, and a trained method as a model in ONNX that needs no torch."""

import logging
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from deepgps.api.run import Frame, Run
from deepgps.data.features import PRODUCT_FLOOR, Features, describe_rings, make_waves, rank_values
from deepgps.learning.trainer import load_triton
from deepgps.positioner import appearance
from deepgps.positioner.positioner import FeaturePositioner, NetworkPositioner, Positioner, RegistrationPositioner
from deepgps.robot_io.trajectories import write_trajectories
from deepgps.runs.owned_folder import Kind, hold
from deepgps.terminal.progress import Report
from sim.alignment import Alignment
from sim.errors import InputError
from sim.files.atomic import sweep, write_atomic, write_text
from sim.files.checksums import read_json, write_arrays, write_json
from sim.sensors.camera.mount import map_pixels, pad
from sim.sensors.camera.unwrap import RoundImage

FILES = re.compile(r"tum/(training|use)/\w+\.tum|onnx/(model\.onnx|meta\.json|tables\.npz|\w+\.py)|export\.json")
EXPORT = Kind("export", "onnx/model.onnx", lambda: FILES)
ABOUT_FILE = "export.json"  # The file that says which run is exported


def export_tum(run: Run, folder: Path, method: str | None, frame: Frame | None, progress: Report) -> list[Path]:
    """Write the drives as TUM files into a folder; return its subfolder. Arguments as of ``write_trajectories``."""
    with _claim(run, folder):
        write_trajectories(folder / "tum", run, method, frame, progress)
    return [folder / "tum"]


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
Exported = NetworkPositioner | RegistrationPositioner
MODULES = ("kriging", "pixels", "registration")  # Those of deepgps's own that the example needs, by name
OUTPUTS = {
    "position": "x, y of the robot [m]",
    "yaw": "counter-clockwise from x [rad]; NaN: the image shows no direction",
    "yaw_std": "standard deviation of the yaw [rad]",
    "radius_68": "radius that holds the true position with a probability of 68 % [m]",
    "radius_95": "the same for 95 % [m]",
    "covariance": "of the position, by the image alone [m^2]",
    "accepted": "whether to use the position",
    "reason": "why not: unlike all images near its place, ambiguous, contradicting",
}


def write_onnx(
    folder: Path, method: str, positioner: Positioner, alignment: Alignment | None, raw: RoundImage | None
) -> None:
    """Write the folder of a method; the alignment is from its map to the frame of the poses.

    Without ``raw``, the folder takes polar images alone. Raises InputError if the method is neither a network nor
    registration on polar images, or a package is missing.
    """
    if not isinstance(positioner, Exported) or len(positioner.shape) != 3:
        raise InputError(
            f"--onnx: method {method} is neither a network nor registration on polar images, and only these are written"
        )
    model = build_model(positioner)
    write_atomic(folder / MODEL, lambda part: part.write_bytes(model), len(model))
    write_arrays(folder / TABLES, make_tables(positioner, raw))
    write_text(folder / EXAMPLE, Path(__file__).with_name(EXAMPLE).read_text(encoding="utf-8"))
    for name in MODULES:
        source = (Path(appearance.__file__).parent / f"{name}.py").read_text(encoding="utf-8")
        write_text(folder / f"{name}.py", source.replace("from deepgps.positioner.", "from "))
    write_json(folder / META, describe_folder(method, positioner, alignment, raw))


def build_model(positioner: Exported) -> bytes:
    """The model, which takes images (B, rings, sectors, 3) uint8 of an upright camera."""
    try:
        import onnxscript  # noqa: F401  torch imports it too, with a longer message
    except ModuleNotFoundError:
        raise InputError(
            "--onnx needs pip install onnx onnxscript onnxruntime (in a checkout: make setup-dev)"
        ) from None
    load_triton()
    module = Deployed(positioner).eval()
    some = torch.zeros((2, *positioner.shape), dtype=torch.uint8)
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)  # it warns of packages that are not needed
    with warnings.catch_warnings(action="ignore"), torch.inference_mode():
        program = torch.onnx.export(
            module,
            (some,),
            dynamo=True,
            input_names=["image"],
            output_names=list(module(some)),
            dynamic_shapes=({0: torch.export.Dim("batch")},),
            verbose=False,
        )
    assert program is not None
    return program.model_proto.SerializeToString()


def make_tables(positioner: Exported, raw: RoundImage | None) -> dict[str, np.ndarray]:
    """What is seen where, and what ``cv2.remap`` needs to make the model's images of raw or leaning ones."""
    rings, sectors, _ = positioner.shape
    known = positioner.appearance
    tables = {} if known is None else known.list_arrays()
    if raw is not None:
        column, row = raw.find_points(rings, sectors)
        tables |= {"raw_column": column, "raw_row": row}
    if positioner.upright is not None and any(positioner.upright.lean):
        pixel = pad(np.arange(rings * sectors, dtype=np.int32).reshape(rings, sectors, 1))[..., 0]
        column, row = map_pixels(positioner.upright, rings, sectors)
        tables |= {"lean_pixel": pixel, "lean_column": column, "lean_row": row}
    return tables


def describe_folder(
    method: str, positioner: Exported, alignment: Alignment | None, raw: RoundImage | None
) -> dict[str, Any]:
    """Contents of ``meta.json``."""
    lean = positioner.upright.lean if positioner.upright else (0.0, 0.0)
    to_frame = Alignment(np.eye(2), np.zeros(2), 1.0) if alignment is None else alignment
    mirrored, known = positioner.mirrored, positioner.appearance
    return {
        "method": method,
        "frame": "map" if alignment is None else "world",
        "image": list(positioner.shape),
        # Whether a turn to the left is one to the right in the frame of the poses; None: the method gives no yaw
        "mirrored": None if mirrored is None else bool(mirrored != (np.linalg.det(to_frame.rotation) < 0.0)),
        "outputs": OUTPUTS if known is not None else {"position": OUTPUTS["position"]},
        "raw": raw and {"centre_px": list(raw.centre), "radius_px": raw.radius_px, "forward_deg": raw.forward_deg},
        "lean_deg": np.degrees(lean).round(4).tolist(),
        "mount_m": list(positioner.mount),
        "rotation": to_frame.rotation.tolist(),
        "translation": to_frame.translation.tolist(),
        "map": None if known is None else known.list_numbers(),
    }


class Deployed(nn.Module):
    """Features by which polar images of an upright camera are registered, and the camera's positions by a network."""

    def __init__(self, positioner: FeaturePositioner) -> None:
        super().__init__()
        known, self.network, inputs = positioner.appearance, None, None
        if isinstance(positioner, NetworkPositioner):
            self.network, inputs = positioner.network, positioner.features
            self.centre, self.axes = nn.Buffer(positioner.centre), nn.Buffer(positioner.axes)
        self.features = None if known is None else FeatureModule(known.features)
        self.inputs = None if inputs is None else FeatureModule(inputs)

    def forward(self, image: torch.Tensor) -> dict[str, torch.Tensor]:
        """Whitened features (B, K) and positions (B, 2) [m] of images (B, rings, sectors, 3) uint8, by name."""
        image = image.float()
        found = {} if self.features is None else {"features": self.features(image)}
        if self.network is not None:  # as ``NetworkPositioner.locate_camera``
            inputs = image.permute(0, 3, 1, 2) / 255.0 if self.inputs is None else self.inputs(image)
            found["position"] = (self.network(inputs) - self.centre) @ self.axes
        return found


class FeatureModule(nn.Module):
    """``Features.apply`` for polar images."""

    def __init__(self, features: Features) -> None:
        super().__init__()
        _, sectors, _ = features.shape
        self.by_rank = features.values == "ranks"
        count = min(features.frequencies, sectors // 2)
        self.wave = nn.Buffer(make_waves(sectors, count))
        # As a single number, the optimiser of ONNX models takes this for zero and drops it.
        self.least = nn.Buffer(torch.full((count,), PRODUCT_FLOOR))
        self.mean, self.basis = nn.Buffer(features.mean), nn.Buffer(features.basis)

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        """Features (B, components) of images (B, rings, sectors, 3) float32."""
        image = image.transpose(2, 3)
        described = describe_rings(rank_values(image) if self.by_rank else image, self.wave, self.least)
        return (described - self.mean) @ self.basis
