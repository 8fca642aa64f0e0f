"""One step of gradient descent, which a GPU records once and replays.

A step is some 300 kernels of microseconds each: to launch them one by one takes longer than to compute them.
"""

from collections.abc import Callable
from dataclasses import replace

import torch
from torch import nn

from deepgps.learning.batches import Batch

WARM_UP_STEPS = 3
"""Steps before one is recorded, in which CUDA's libraries allocate their memory."""

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
    step must not read a value back from the GPU, nor depend on a Python value that changes. Other shapes of the
    arguments are recorded anew.

    Args:
        step: Takes a step when it is called; the first ones are only called.
        optimiser: The optimiser that it steps.
    """

    def __init__(self, step: Step, optimiser: torch.optim.Optimizer) -> None:
        self.step, self.optimiser = step, optimiser
        self.left = WARM_UP_STEPS
        self.graph: torch.cuda.CUDAGraph | None = None
        for group in optimiser.param_groups:
            device = group["params"][0].device
            group.update(lr=torch.zeros((), device=device), capturable=False)  # until it is recorded

    def __call__(self, inputs: torch.Tensor, batch: Batch, done: torch.Tensor) -> torch.Tensor:
        """Take a step; what it returns is overwritten by the next."""
        self.left -= 1
        with torch.cuda.device(inputs.device):
            return (self._warm_up if self.left >= 0 else self._replay)(inputs, batch, done)

    def _replay(self, inputs: torch.Tensor, batch: Batch, done: torch.Tensor) -> torch.Tensor:
        given = [inputs, done, *(one for one in vars(batch).values() if one is not None)]
        if self.graph is None or [one.shape for one in given] != [one.shape for one in self.held]:
            self.graph, self.held, self.value = self._record(inputs, batch, done)
        for held, one in zip(self.held, given, strict=True):
            held.copy_(one)
        self.graph.replay()
        return self.value

    def _warm_up(self, inputs: torch.Tensor, batch: Batch, done: torch.Tensor) -> torch.Tensor:
        """Take a step on a stream of its own, as a recording does."""
        stream = torch.cuda.Stream()
        stream.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(stream):
            value = self.step(inputs, batch, done)
        torch.cuda.current_stream().wait_stream(stream)
        return value

    def _record(
        self, inputs: torch.Tensor, batch: Batch, done: torch.Tensor
    ) -> tuple[torch.cuda.CUDAGraph, list[torch.Tensor], torch.Tensor]:
        """Record a step, which does not take it: the graph, what it reads, and the loss that it writes."""
        for group in self.optimiser.param_groups:
            group["capturable"] = True
        tensors = {name: one.clone() for name, one in vars(batch).items() if one is not None}
        inputs, done, batch = inputs.clone(), done.clone(), replace(batch, **tensors)
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph):
            value = self.step(inputs, batch, done)
        return graph, [inputs, done, *tensors.values()], value


def set_rate(optimiser: torch.optim.Optimizer, rate: float) -> None:
    """Set the learning rate, in place where it is a tensor."""
    for group in optimiser.param_groups:
        if isinstance(group["lr"], torch.Tensor):
            group["lr"].fill_(rate)
        else:
            group["lr"] = rate
