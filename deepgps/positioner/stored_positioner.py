"""Trained methods in their folders: saved as weights and JSON, and loaded from there alone."""

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from pydantic import ValidationError
from safetensors import SafetensorError
from safetensors.torch import load_file, save

from deepgps.positioner.appearance import Packed
from deepgps.positioner.positioner import (
    CPU,
    FeaturePositioner,
    LinearPositioner,
    NeighbourPositioner,
    NetworkPositioner,
    Positioner,
    RegistrationPositioner,
)
from deepgps.positioner.without_features import ArrayPositioner, LandmarkPositioner, ScanPositioner
from sim.errors import DamagedError, InputError, WorkError, one_line
from sim.files.atomic import write_bytes
from sim.files.checksums import FORMAT, check_sha256, damaged, read_json, refuse_format, write_json

INDEX, WEIGHTS = "positioner.json", "weights.safetensors"
KINDS = {
    one.kind: one
    for one in (
        RegistrationPositioner,
        NetworkPositioner,
        NeighbourPositioner,
        LinearPositioner,
        ScanPositioner,
        LandmarkPositioner,
        ArrayPositioner,
    )
}


def is_finished(folder: Path) -> bool:
    """Whether a method's folder holds a complete positioner."""
    return (folder / INDEX).is_file()


def save_positioner(folder: Path, positioner: Any, training: Mapping[str, Any]) -> None:
    """Write ``weights.safetensors``, ``training.json`` (the record of the training) and, last, ``positioner.json``.

    Raises WorkError if it is none of deepgps's own positioners: only a plugin's method can return anything else.
    """
    if not isinstance(positioner, Positioner):
        raise WorkError(
            f"method {folder.name}: fit must return one of deepgps's own positioners, or arrays by name if the method "
            f"has predict, and not a {type(positioner).__name__}"
        )
    tensors, numbers = positioner.pack()
    if isinstance(positioner, FeaturePositioner):
        shared = positioner.pack_shared()
        tensors, numbers = tensors | shared.tensors, numbers | shared.numbers
    description = {"kind": positioner.kind, **numbers}
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
        packed = Packed(load_file(folder / WEIGHTS), description)
        positioner = KINDS[description["kind"]].unpack(packed)
        if isinstance(positioner, FeaturePositioner):
            positioner = positioner.unpack_shared(packed)
        if isinstance(positioner, NetworkPositioner):
            positioner.network.to(device)
        return positioner
    except DamagedError as error:
        raise DamagedError(f"{error}; delete {folder} and train the method again") from None
    except InputError:
        raise
    except (ValidationError, KeyError, TypeError, ValueError, AttributeError) as error:
        raise damaged(path, one_line(error)) from None
    except (SafetensorError, OSError, RuntimeError) as error:
        raise damaged(folder / WEIGHTS, one_line(error)) from None


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
