"""The state of a training on disk, so that a run interrupted anywhere continues to the same weights."""

import logging
from io import BytesIO
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import torch
from torch import nn

from sim.errors import DamagedError, InputError, one_line
from sim.files.atomic import write_bytes
from sim.files.checksums import damaged

log = logging.getLogger(__name__)
NAME = "checkpoint.pt"


def save_checkpoint(
    folder: Path,
    step: int,
    network: nn.Module,
    optimiser: torch.optim.Optimizer,
    generator: torch.Generator,
    history: dict[str, list],
    seconds: float,
) -> None:
    """Write all that the next step depends on: weights, optimiser, generator (the position in the data), history."""
    state = {
        "step": step,
        "network": network.state_dict(),
        "optimiser": optimiser.state_dict(),
        "generator": generator.get_state(),
        "history": history,
        "seconds": seconds,
    }
    buffer = BytesIO()
    torch.save(state, buffer)
    write_bytes(folder / NAME, buffer.getvalue())


def load_checkpoint(
    folder: Path,
    network: nn.Module,
    optimiser: torch.optim.Optimizer,
    generator: torch.Generator,
    history: dict[str, list],
) -> tuple[int, float]:
    """Restore a training in place and return the steps done and their seconds, zeros if there is no checkpoint.

    A damaged checkpoint is removed, and training starts from its first step. Raises InputError if it is that of another
    network, or was made on another kind of device.
    """
    path = folder / NAME
    if not path.is_file():
        return 0, 0.0
    try:
        state = _read(path)
    except DamagedError as error:
        log.warning("%s; training starts from its first step", error)
        path.unlink()
        return 0, 0.0
    try:
        network.load_state_dict(state["network"])
        optimiser.load_state_dict(state["optimiser"])
        generator.set_state(state["generator"])
    except (RuntimeError, KeyError, ValueError):
        raise InputError(
            f"{path} belongs to another training, or to one on another kind of device; without it this one starts from "
            "its first step"
        ) from None
    for name, values in state["history"].items():
        history[name][:] = values
    return int(state["step"]), float(state["seconds"])


def _read(path: Path) -> dict[str, Any]:
    """Contents of a checkpoint, on the CPU; raises DamagedError. It is a zip file, whose CRC torch does not check."""
    data = path.read_bytes()
    try:
        with ZipFile(BytesIO(data)) as archive:
            wrong = archive.testzip()
        state = torch.load(BytesIO(data), map_location="cpu", weights_only=True)
    except MemoryError:
        raise
    except Exception as error:  # zipfile, pickle and torch raise a dozen types
        raise damaged(path, one_line(error)) from None
    if wrong is not None:
        raise damaged(path)
    return state
