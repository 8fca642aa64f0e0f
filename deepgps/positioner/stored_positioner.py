"""Trained methods in their folders: saved as weights and JSON, and loaded from there alone."""

import hashlib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from pydantic import ValidationError
from safetensors import SafetensorError
from safetensors.torch import load_file, save

from deepgps.positioner.confidence import Confidence
from deepgps.positioner.headings import HeadingTable
from deepgps.positioner.positioner import (
    CPU,
    LinearPositioner,
    NeighbourPositioner,
    NetworkPositioner,
    Packed,
    Positioner,
)
from deepgps.positioner.registration import RegistrationPositioner
from deepgps.positioner.without_features import ArrayPositioner, LandmarkPositioner, ScanPositioner
from sim.errors import DamagedError, InputError, WorkError, one_line
from sim.files.atomic import write_bytes
from sim.files.checksums import FORMAT, check_sha256, damaged, read_json, refuse_format, write_json

INDEX, WEIGHTS = "positioner.json", "weights.safetensors"
TABLES = {"yaw": ("headings", HeadingTable), "confidence": ("confidence", Confidence)}
"""Entries of the description for tables, with the attributes whose names begin those of their arrays."""
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

    Raises:
        WorkError: It is none of deepgps's own positioners; only a plugin's method can return anything else.
    """
    if not isinstance(positioner, Positioner):
        raise WorkError(
            f"method {folder.name}: fit must return one of deepgps's own positioners, or arrays by name if the method "
            f"has predict, and not a {type(positioner).__name__}"
        )
    tensors, numbers = positioner.pack()
    description = {"kind": positioner.kind, **numbers}
    for key, (attribute, _) in TABLES.items():
        if (table := getattr(positioner, attribute)) is not None:
            arrays, description[key] = table.pack()
            tensors |= {f"{attribute}.{name}": torch.from_numpy(array) for name, array in arrays.items()}
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
        positioner = KINDS[description["kind"]].unpack(Packed(tensors, description))
        for key, (attribute, kind) in TABLES.items():
            if (numbers := description.get(key)) is not None:
                table = kind.unpack(_take(tensors, f"{attribute}."), numbers)
                positioner = replace(positioner, **{attribute: table})
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
