"""One plain training loop for every method that trains a network; it can be interrupted anywhere and continues exactly.

On the CPU of one machine the same seed gives the same weights to the byte, on any number of cores: each random draw
comes from a generator whose state is in the checkpoint, the schedule counts steps, and the number of threads, which
determines the order of sums, is fixed (``use_threads``). A GPU may add in another order each time. Another machine may
give other weights: BLAS and oneDNN choose their kernels by the processor, which changes the order of sums and so their
rounding, and bfloat16, which only some processors have, changes more than that. Training amplifies such differences: in
the demo, initial maps that differed by 1e-10 m ended in an RMS of 3.4 and of 4.3 cm. Half a centimetre between two
methods, or nearly one between two machines, is noise.
"""

import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from threadpoolctl import threadpool_limits
from torch import nn

from deepgps.config.learning import TrainSettings
from deepgps.learning.batches import Draw, Inputs, Loss
from deepgps.learning.checkpoint import load_checkpoint, save_checkpoint
from deepgps.terminal.progress import Report, ignore
from sim.errors import InputError, WorkError
from sim.files.checksums import write_arrays
from sim.rng import derive_seed

SNAPSHOT_SAMPLES = 2000
LOSS_POINTS = 300
WARM_UP_SHARE = 0.05


def load_triton() -> None:
    """Load Triton, which torch's CUDA builds import with the first optimiser or export, so that it uses its own LLVM.

    With Mesa's LLVM, which MuJoCo's renderer loads on a machine without a GPU, Triton ends the process.
    """
    flags = sys.getdlopenflags()
    sys.setdlopenflags(flags | os.RTLD_DEEPBIND)
    try:
        with suppress(ImportError):
            import triton  # noqa: F401  # pyright: ignore[reportMissingImports]
    finally:
        sys.setdlopenflags(flags)


def make_generator(seed: int, purpose: str, attempt: int = 0) -> torch.Generator:
    """Return the CPU generator of one purpose and attempt: its RNG stream is independent of all others."""
    return torch.Generator().manual_seed(derive_seed(seed, purpose, attempt))


def choose_device(name: str) -> torch.device:
    """Return the device of this name; auto is CUDA if there is a CUDA device, else the CPU."""
    if name == "auto":
        name = "cuda" if torch.cuda.is_available() else "cpu"
    if not name.startswith("cuda"):
        return torch.device(name)
    if not torch.cuda.is_available():
        raise InputError(f"learn.train.device {name!r}: this machine has no CUDA device; there are cpu and auto")
    device, count = torch.device(name), torch.cuda.device_count()
    if device.index is not None and device.index >= count:
        raise InputError(f"learn.train.device {name!r}: this machine's last CUDA device is cuda:{count - 1}")
    return device


def find_device(name: str) -> torch.device:
    """The device of this name, or the CPU where this machine has no such device: trained networks run on both."""
    try:
        return choose_device(name)
    except InputError:
        return torch.device("cpu")


def describe_device(name: str = "auto", bfloat16: bool = True) -> str:
    """Describe in one line the device that training would use, where it may use bfloat16 or may not."""
    device = choose_device(name)
    fast = "bfloat16" if bfloat16 and has_fast_bfloat16(device) else "float32"
    if device.type == "cuda":
        return f"{torch.cuda.get_device_name(device)}, {fast}"
    return f"CPU, {torch.get_num_threads()} threads, {fast}"


def has_fast_bfloat16(device: torch.device) -> bool:
    """Whether matrix products are faster in bfloat16 than in float32.

    A training step took 1.4 times as long in float32 on AMD's processors with AVX-512, 1.6 times on Intel's with AMX,
    and 0.7 times on Intel's without it.
    """
    if device.type == "cuda":
        return torch.cuda.is_bf16_supported()
    can = torch.cpu.get_capabilities()
    return can.get("amx_bf16", False) or (can.get("avx512_bf16", False) and "AMD" in can.get("cpu_name", ""))


def train(
    network: nn.Module,
    inputs: Inputs,
    draw: Draw,
    loss: Loss,
    settings: TrainSettings,
    seed: int,
    folder: Path,
    progress: Report = ignore,
    label: str = "train",
) -> float:
    """Train ``network`` in place, or continue from the checkpoint in ``folder``.

    Writes ``folder/history.npz``: ``step`` and ``loss`` (means between two points), ``snapshot_step`` (K,), and
    ``snapshot`` (K, n, 2) predictions of the observations ``snapshot_index`` (n,) [m]. Returns seconds of training,
    those of an interrupted one included; raises WorkError if it diverged.
    """
    with use_threads(settings.threads):
        device = choose_device(settings.device)
        network = network.to(device).train()
        load_triton()
        optimiser = torch.optim.AdamW(
            network.parameters(), lr=settings.learning_rate, weight_decay=settings.weight_decay, fused=True
        )
        generator = torch.Generator(device).manual_seed(seed)
        fast = settings.bfloat16 and has_fast_bfloat16(device)
        history = History.start(len(inputs), settings.steps, settings.snapshots)
        done, seconds = load_checkpoint(folder, network, optimiser, generator, history.arrays)
        start = time.perf_counter() - seconds
        running, fraction = torch.zeros((), device=device), torch.zeros((), device=device)
        every = max(1, settings.steps // LOSS_POINTS)
        for step in range(done, settings.steps):
            if step in history.snapshot_steps:
                history.add(snapshot_step=step, snapshot=predict(network, inputs, history.index))
            for group in optimiser.param_groups:
                group["lr"] = settings.learning_rate * schedule(step, settings.steps)
            batch = draw(generator, step / settings.steps)
            taken = inputs.take(batch.index.flatten(), generator)
            with torch.autocast(device.type, torch.bfloat16, enabled=fast):
                out = network(taken)
            value = loss(out.unflatten(0, batch.index.shape), batch, fraction.fill_(step / settings.steps))
            optimiser.zero_grad(set_to_none=True)
            value.backward()
            optimiser.step()
            running += value.detach()
            if (step + 1) % every == 0:
                _check_finite(running, step + 1, settings)
                history.add(step=step + 1, loss=running.item() / every)
                running.zero_()
                progress(label, step + 1, settings.steps, history.tables)
            # A checkpoint falls on a loss point, so that the running mean need not be saved.
            if (step + 1) % (every * max(1, settings.checkpoint_steps // every)) == 0 or step + 1 == settings.steps:
                seconds = time.perf_counter() - start
                save_checkpoint(folder, step + 1, network, optimiser, generator, history.arrays, seconds)
        last = predict(network, inputs, history.index)
        _check_finite(last, settings.steps, settings)
        history.add(snapshot_step=settings.steps, snapshot=last)
        write_arrays(folder / "history.npz", history.tables())
        network.eval()
        return seconds


@contextmanager
def use_threads(count: int) -> Iterator[None]:
    """Fix the number of threads in this context, so that sums have one order: torch uses ``count``, NumPy and SciPy 1.

    OpenBLAS divides its work by the number of cores, and with two threads it does not even repeat its own sums.
    Libraries that are loaded later, such as scikit-learn, keep their threads.
    """
    before = torch.get_num_threads()
    with threadpool_limits(1):
        torch.set_num_threads(count)
        try:
            yield
        finally:
            torch.set_num_threads(before)


def _check_finite(found: torch.Tensor, step: int, settings: TrainSettings) -> None:
    if not found.isfinite().all():
        raise WorkError(
            f"training diverged before step {step}: its loss or predictions are no finite numbers; "
            f"learn.train.learning_rate {settings.learning_rate:g} may be too large"
        )


def schedule(step: int, steps: int) -> float:
    """Learning rate at a step as a fraction of its peak: a linear rise, then a cosine to zero."""
    done = step / steps
    if done < WARM_UP_SHARE:
        return (step + 1) / (WARM_UP_SHARE * steps + 1)
    return 0.5 * (1.0 + float(np.cos(np.pi * (done - WARM_UP_SHARE) / (1.0 - WARM_UP_SHARE))))


def predict(network: nn.Module, inputs: Inputs, index: torch.Tensor, chunk: int = 1000) -> torch.Tensor:
    """Predictions in float32 (n, outputs) on the CPU, made in evaluation mode; the network's mode is restored."""
    training = network.training
    network.eval()
    with torch.no_grad():
        found = [network(inputs.take(part)).cpu() for part in index.to(inputs.table.device).split(chunk)]
    network.train(training)
    return torch.cat(found)


@dataclass
class History:
    """Losses and snapshots of a training, kept in lists of arrays so that a checkpoint can hold them."""

    index: torch.Tensor
    snapshot_steps: frozenset[int]
    arrays: dict[str, list]

    @classmethod
    def start(cls, observations: int, steps: int, snapshots: int) -> "History":
        """Create an empty history, with snapshots of observations spread evenly over the recording."""
        count = min(observations, SNAPSHOT_SAMPLES)
        index = torch.linspace(0, observations - 1, count).round().long()
        at = frozenset(round(steps * k / (snapshots - 1)) for k in range(snapshots - 1))
        return cls(index, at, {"step": [], "loss": [], "snapshot_step": [], "snapshot": []})

    def add(self, **entries: float | torch.Tensor) -> None:
        """Record a step and the mean loss up to it, or a step and the predictions before it."""
        for name, entry in entries.items():
            self.arrays[name].append(entry)

    def tables(self) -> dict[str, np.ndarray]:
        """The history as arrays; snapshots of lifted predictions are projected onto their two principal axes."""
        return {
            "step": np.array(self.arrays["step"], np.int64),
            "loss": np.array(self.arrays["loss"], np.float32),
            "snapshot_step": np.array(self.arrays["snapshot_step"], np.int64),
            "snapshot": np.stack([_flat(one.numpy()) for one in self.arrays["snapshot"]]).astype(np.float32),
            "snapshot_index": self.index.numpy(),
        }


def _flat(points: np.ndarray) -> np.ndarray:
    if points.shape[1] == 2:
        return points
    _, _, axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)
    return points @ axes[:2].T
