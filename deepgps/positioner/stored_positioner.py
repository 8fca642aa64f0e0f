"""Trained methods in their folders: saved as weights and JSON, and loaded from there alone."""

import hashlib
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from pydantic import ValidationError
from safetensors import SafetensorError
from safetensors.torch import load_file, save

from deepgps.config.learning import FeatureSettings, NetworkSettings
from deepgps.data.features import Features
from deepgps.learning.networks import make_network
from deepgps.positioner import confidence
from deepgps.positioner.headings import unpack
from deepgps.positioner.nearest_scan import NAMES, ScanPositioner
from deepgps.positioner.positioner import (
    CPU,
    ArrayPositioner,
    FeaturePositioner,
    NeighbourPositioner,
    NetworkPositioner,
    Positioner,
    confidence_of,
    headings_of,
)
from deepgps.positioner.trilateration import LandmarkPositioner
from sim.errors import DamagedError, InputError, WorkError, one_line
from sim.files.atomic import write_bytes
from sim.files.checksums import FORMAT, check_sha256, damaged, read_json, refuse_format, write_json
from sim.sensors.camera.lens import Lens
from sim.sensors.camera.mount import Upright

INDEX, WEIGHTS = "positioner.json", "weights.safetensors"
HEADINGS, CONFIDENCE = "headings.", "confidence."
"""Prefixes of the arrays of these tables among the weights."""


def is_finished(folder: Path) -> bool:
    """Whether a method's folder holds a complete positioner."""
    return (folder / INDEX).is_file()


def save_positioner(folder: Path, positioner: Any, training: Mapping[str, Any]) -> None:
    """Write ``weights.safetensors``, ``training.json`` (the record of the training) and, last, ``positioner.json``.

    Raises:
        WorkError: It is none of deepgps's own positioners; only a plugin's method can return anything else.
    """
    if not isinstance(positioner, Positioner):
        raise WorkError(
            f"method {folder.name}: fit must return one of deepgps's own positioners, or arrays by name if the method "
            f"has predict, and not a {type(positioner).__name__}"
        )
    tensors, description = _take_apart(positioner)
    if (headings := headings_of(positioner)) is not None:
        arrays, description["yaw"] = headings.pack()
        tensors |= {f"{HEADINGS}{name}": torch.from_numpy(array) for name, array in arrays.items()}
    if (table := confidence_of(positioner)) is not None:
        arrays, description["confidence"] = table.pack()
        tensors |= {f"{CONFIDENCE}{name}": torch.from_numpy(array) for name, array in arrays.items()}
    weights = save({name: t.contiguous() for name, t in tensors.items()})
    write_bytes(folder / WEIGHTS, weights)
    write_json(folder / "training.json", training)
    write_json(folder / INDEX, {"format": FORMAT, **description, "sha256": hashlib.sha256(weights).hexdigest()})


def load_positioner(folder: Path, device: torch.device = CPU) -> Positioner:
    """Load what ``save_positioner`` wrote, its network to ``device``; raises InputError if it is missing or damaged."""
    path = folder / INDEX
    if not path.is_file():
        raise InputError(f"{folder} holds no trained method: it has no {INDEX}")
    try:
        description = check_positioner(folder)
        tensors = load_file(folder / WEIGHTS)
        positioner = _put_together(description, tensors, device)
        if isinstance(positioner, FeaturePositioner) and description.get("yaw") is not None:
            positioner = replace(positioner, headings=unpack(_take(tensors, HEADINGS), description["yaw"]))
        if isinstance(positioner, FeaturePositioner) and description.get("confidence") is not None:
            table = confidence.unpack(_take(tensors, CONFIDENCE), description["confidence"])
            positioner = replace(positioner, confidence=table)
        return positioner
    except DamagedError as error:
        raise DamagedError(f"{error}; delete {folder} and train the method again") from None
    except InputError:
        raise
    except (ValidationError, KeyError, TypeError, ValueError, AttributeError) as error:
        raise damaged(path, one_line(error)) from None
    except (SafetensorError, OSError, RuntimeError) as error:
        raise damaged(folder / WEIGHTS, one_line(error)) from None


def _take(tensors: Mapping[str, torch.Tensor], prefix: str) -> dict[str, np.ndarray]:
    return {name.removeprefix(prefix): t.numpy() for name, t in tensors.items() if name.startswith(prefix)}


def check_positioner(folder: Path) -> dict[str, Any]:
    """Return the description of a trained method after checking its weights' checksum; raises DamagedError."""
    description = read_json(folder / INDEX)
    if description.get("format") != FORMAT:
        raise refuse_format(folder / INDEX, description.get("format"))
    check_sha256(folder / WEIGHTS, str(description.pop("sha256", "")))
    return description


def read_training(folder: Path) -> dict[str, Any]:
    """Read the record of a method's training from its folder; raises DamagedError."""
    try:
        return read_json(folder / "training.json")
    except DamagedError as error:
        raise DamagedError(f"{error}; delete {folder} and train the method again") from None


def _take_apart(positioner: Positioner) -> tuple[dict[str, torch.Tensor], dict[str, Any]]:
    if isinstance(positioner, ArrayPositioner):
        arrays = {name: torch.from_numpy(np.ascontiguousarray(array)) for name, array in positioner.arrays.items()}
        return arrays, {"kind": "arrays", "method": positioner.method}
    if isinstance(positioner, LandmarkPositioner):
        reach_m = None if np.isinf(positioner.reach_m) else positioner.reach_m
        return {"landmark": torch.from_numpy(positioner.landmark)}, {"kind": "landmarks", "reach_m": reach_m}
    if isinstance(positioner, ScanPositioner):
        return positioner.tensors(), {"kind": "scans", "headings": positioner.headings}
    features = positioner.features
    tensors = {} if features is None else {"features.mean": features.mean, "features.basis": features.basis}
    if features is not None and features.edges is not None:
        tensors["features.edges"] = features.edges
    values = {} if features is None else {"values": features.values}
    frequencies = None if features is None else features.frequencies
    if isinstance(positioner, NeighbourPositioner):
        assert features is not None
        tensors |= {"known": positioner.known, "places": positioner.places}
        kind = {"kind": "neighbours", "neighbours": positioner.neighbours, "shape": list(features.shape)}
    else:
        tensors |= {f"network.{name}": tensor for name, tensor in positioner.network.state_dict().items()}
        tensors |= {"centre": positioner.centre, "axes": positioner.axes}
        network = positioner.settings.model_dump(mode="json")
        kind = {"kind": "network", "network": network, "shape": list(positioner.shape)}
        if positioner.upright is not None:
            kind["upright"] = asdict(positioner.upright)
        if (likeness := positioner.likeness) is not None:
            tensors |= {"likeness.mean": likeness.mean, "likeness.basis": likeness.basis}
            kind["likeness"] = {"frequencies": likeness.frequencies, "values": likeness.values}
        if any(positioner.mount):
            kind["mount_m"] = list(positioner.mount)
    return tensors, {**kind, "frequencies": frequencies, **values}


def _put_together(
    description: Mapping[str, Any], tensors: Mapping[str, torch.Tensor], device: torch.device
) -> Positioner:
    if description.get("kind") == "landmarks":
        reach_m = description["reach_m"]
        return LandmarkPositioner(tensors["landmark"].numpy(), np.inf if reach_m is None else float(reach_m))
    if description.get("kind") == "arrays":
        return ArrayPositioner(description["method"], {name: tensor.numpy() for name, tensor in tensors.items()})
    if description.get("kind") == "scans":
        mean, axes, known, places = (tensors[name].numpy() for name in NAMES)
        return ScanPositioner(mean, axes, known, places, description["headings"])
    shape = tuple(description["shape"])
    features = None
    if description["frequencies"] is not None:
        mean, basis = tensors["features.mean"], tensors["features.basis"]
        values = FeatureSettings(values=description["values"]).values
        features = Features(shape, description["frequencies"], mean, basis, tensors.get("features.edges"), values)
    if description["kind"] == "neighbours" and features is not None:
        return NeighbourPositioner(features, tensors["known"], tensors["places"], description["neighbours"])
    settings = NetworkSettings.model_validate(description["network"])
    inputs = 0 if features is None else features.basis.shape[1]
    network = make_network(settings, inputs, len(tensors["centre"]), torch.Generator())
    own = {name.removeprefix("network."): t for name, t in tensors.items() if name.startswith("network.")}
    network.load_state_dict(own)
    upright = _read_upright(description.get("upright"))
    ahead, left = description.get("mount_m", (0.0, 0.0))
    centre, axes, likeness = tensors["centre"], tensors["axes"], None
    if (stored := description.get("likeness")) is not None:
        mean, basis = tensors["likeness.mean"], tensors["likeness.basis"]
        likeness = Features(shape, stored["frequencies"], mean, basis, values=stored["values"])
    mount = (float(ahead), float(left))
    return NetworkPositioner(
        shape, features, settings, network.to(device).eval(), centre, axes, upright, mount=mount, likeness=likeness
    )


def _read_upright(stored: Mapping[str, Any] | None) -> Upright | None:
    if stored is None:
        return None
    (roll, pitch), (right, ahead), (k1, k2, k3, k4) = stored["lean"], stored["parallax"], stored["lens"]["k"]
    return Upright(Lens(stored["lens"]["half_angle"], (k1, k2, k3, k4)), (roll, pitch), (right, ahead))
