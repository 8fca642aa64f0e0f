"""One step of gradient descent, which a GPU records once and replays.

A step is some 300 kernels of microseconds each: to launch them one by one takes longer than to compute them.
"""

from collections.abc import Callable
from dataclasses import replace

import torch
from torch import nn

from deepgps.learning.batches import Batch

PLAIN_STEPS = 3
"""Steps that are taken before one is recorded, in which CUDA's libraries load kernels and allocate memory."""

Loss = Callable[[torch.Tensor, Batch, torch.Tensor], torch.Tensor]
"""(predictions shaped like the batch's index plus outputs, batch, fraction of the steps done (0-dim)) -> scalar."""
Step = Callable[[torch.Tensor, Batch, torch.Tensor], torch.Tensor]
"""(network input, batch, fraction of the steps done (0-dim)) -> loss before the step, which it then takes."""


def make_step(network: nn.Module, optimiser: torch.optim.Optimizer, loss: Loss, bfloat16: bool) -> Step:
    """Return the step that changes the network's weights in place."""

    def step(inputs: torch.Tensor, batch: Batch, done: torch.Tensor) -> torch.Tensor:
        with torch.autocast(inputs.device.type, torch.bfloat16, enabled=bfloat16):
            out = network(inputs)
        value = loss(out.unflatten(0, batch.index.shape), batch, done)
        optimiser.zero_grad(set_to_none=True)
        value.backward()
        optimiser.step()
        return value.detach()

    return step


class ReplayedStep:
    """A step recorded as a CUDA graph, which is launched at once.

    Its tensors have fixed addresses, so each call copies its arguments there; the learning rate becomes a tensor. The
    step must not read a value back from the GPU, nor depend on a Python value that changes. Arguments of other shapes
    need a new recording.

    Args:
        step: Called as it is at first, then recorded.
        optimiser: The optimiser that it steps.
        device: The GPU of all tensors.
    """

    def __init__(self, step: Step, optimiser: torch.optim.Optimizer, device: torch.device) -> None:
        self.step, self.optimiser, self.device = step, optimiser, device
        self.stream = torch.cuda.Stream(device)
        self._forget()
        for group in optimiser.param_groups:
            group["lr"] = torch.zeros((), device=device)

    def _forget(self) -> None:
        """Begin again with plain steps, for arguments of shapes that are not known yet."""
        self.graph: torch.cuda.CUDAGraph | None = None
        self.plain, self.shapes = PLAIN_STEPS, list[torch.Size]()
        for group in self.optimiser.param_groups:
            group["capturable"] = False  # or a plain step warns

    def __call__(self, inputs: torch.Tensor, batch: Batch, done: torch.Tensor) -> torch.Tensor:
        """Take a step; what it returns is overwritten by the next."""
        given = [inputs, done, *(one for one in vars(batch).values() if one is not None)]
        shapes = [one.shape for one in given]
        with torch.cuda.device(self.device):
            if shapes != self.shapes:
                self._forget()
                self.shapes = shapes
            if self.plain > 0:
                self.plain -= 1
                return self._take_plainly(inputs, batch, done)
            if self.graph is None:
                self.graph, self.held, self.value = self._record(inputs, batch, done)
            for held, one in zip(self.held, given, strict=True):
                held.copy_(one)
            self.graph.replay()
            return self.value

    def _take_plainly(self, inputs: torch.Tensor, batch: Batch, done: torch.Tensor) -> torch.Tensor:
        """Take a step on the stream on which it will be recorded."""
        self.stream.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(self.stream):
            value = self.step(inputs, batch, done)
        torch.cuda.current_stream().wait_stream(self.stream)
        return value

    def _record(
        self, inputs: torch.Tensor, batch: Batch, done: torch.Tensor
    ) -> tuple[torch.cuda.CUDAGraph, list[torch.Tensor], torch.Tensor]:
        """Record a step without taking it: the graph, what it reads, and the loss that it writes."""
        for group in self.optimiser.param_groups:
            group["capturable"] = True
        tensors = {name: one.clone() for name, one in vars(batch).items() if one is not None}
        inputs, done, batch = inputs.clone(), done.clone(), replace(batch, **tensors)
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph, stream=self.stream):
            value = self.step(inputs, batch, done)
        return graph, [inputs, done, *tensors.values()], value


def set_rate(optimiser: torch.optim.Optimizer, rate: float) -> None:
    """Set the learning rate, in place where it is a tensor."""
    for group in optimiser.param_groups:
        if isinstance(group["lr"], torch.Tensor):
            group["lr"].fill_(rate)
        else:
            group["lr"] = rate
