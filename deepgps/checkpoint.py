"""The state of a training on disk, so that a run cut off anywhere continues to the same weights."""

from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import torch
from torch import nn

from sim.errors import InputError
from sim.files import write_atomic

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
    """Write everything the next step depends on: weights, optimiser, generator (the position in the data), history."""
    state = {
        "step": step,
        "network": network.state_dict(),
        "optimiser": optimiser.state_dict(),
        "generator": generator.get_state(),
        "history": history,
        "seconds": seconds,
    }
    write_atomic(folder / NAME, lambda part: torch.save(state, part))


def load_checkpoint(
    folder: Path,
    network: nn.Module,
    optimiser: torch.optim.Optimizer,
    generator: torch.Generator,
    history: dict[str, list],
) -> tuple[int, float]:
    """Restore a training in place; returns steps done and seconds they took, zeros where there is no checkpoint.

    Raises:
        InputError: when the checkpoint is broken or was made by a training of another network.
    """
    path = folder / NAME
    if not path.is_file():
        return 0, 0.0
    device = next(network.parameters()).device
    try:
        state: dict[str, Any] = torch.load(path, map_location=device, weights_only=True)
        network.load_state_dict(state["network"])
        optimiser.load_state_dict(state["optimiser"])
    except (RuntimeError, KeyError, ValueError, EOFError, UnpicklingError):
        raise InputError(f"{path} is broken or of another training; without it training begins anew") from None
    generator.set_state(state["generator"].cpu())
    for name, values in state["history"].items():
        history[name][:] = [value.cpu() if isinstance(value, torch.Tensor) else value for value in values]
    return int(state["step"]), float(state["seconds"])
