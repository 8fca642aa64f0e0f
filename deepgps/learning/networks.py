"""Networks that map one observation to one position: dense layers on features, and the paper's circular ResNet-18."""

from itertools import pairwise
from typing import NamedTuple

import torch
from torch import nn
from torch.nn import functional

from deepgps.config.learning import Architecture, NetworkSettings


class Padding(NamedTuple):
    """Padding modes of ``torch.nn.functional.pad`` for an image: constant adds zeros, circular joins the ends."""

    sectors: str
    rings: str


PADDING: dict[Architecture, Padding] = {
    "resnet": Padding("circular", "constant"),
    "resnet_paper": Padding("circular", "circular"),
    "resnet_plain": Padding("constant", "constant"),
    "invariant": Padding("circular", "constant"),
}


class SpectralNetwork(nn.Module):
    """Fully connected layers on features (B, components) -> (B, outputs) [m]."""

    def __init__(self, inputs: int, outputs: int, width: int, layers: int) -> None:
        super().__init__()
        sizes = [inputs] + [width] * layers
        self.hidden = nn.ModuleList(nn.Linear(a, b) for a, b in pairwise(sizes))
        self.head = nn.Linear(width, outputs)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Positions (B, outputs) [m]; the last layer is always float32."""
        for layer in self.hidden:
            x = functional.gelu(layer(x))
        return _in_float32(self.head, x)


class ResNet(nn.Module):
    """ResNet-18 on polar images (B, 3, rings, sectors), first kernel 3 (He et al. 2016; paper section III-B2).

    Its strides halve the sectors five times, so even with circular padding a turn by one sector changes its output.
    ``every_turn`` makes the network exactly invariant: each halving is done twice, starting at the first sector and at
    the second. This amounts to the mean over all turns of the image, at a fraction of the cost ("a trous", Holschneider
    et al. 1990), and is exact if 32 divides the number of sectors. In training, each image is turned at random instead,
    which draws one of these turns.
    """

    def __init__(self, outputs: int, channels: int, padding: Padding, every_turn: bool) -> None:
        super().__init__()
        self.padding, self.every_turn = padding, every_turn
        self.first = PaddedConv(3, channels, 3, 2, padding)
        self.first_norm = nn.BatchNorm2d(channels)
        stages, before = [], channels
        for stage in range(4):
            after = channels * 2**stage
            stride = 1 if stage == 0 else 2
            stages += [Block(before, after, stride, padding), Block(after, after, 1, padding)]
            before = after
        self.blocks = nn.Sequential(*stages)
        self.head = nn.Linear(before, outputs)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Positions (B, outputs) [m]."""
        images = x.shape[0]  # and not len(x), which an export to ONNX would take for a constant
        x = functional.relu(self.first_norm(self.first(self._turn(x))))
        # After a ReLU nothing is below zero, so zero padding never wins the maximum.
        x = functional.max_pool2d(pad(self._turn(x), 1, self.padding), 3, 2)
        for block in self.blocks:
            x = block(self._turn(x) if block.stride == 2 else x)
        x = x.mean(dim=(2, 3)).unflatten(0, (-1, images)).mean(dim=0)
        return _in_float32(self.head, x)

    def _turn(self, x: torch.Tensor) -> torch.Tensor:
        """Append, with ``every_turn`` in evaluation mode, a copy turned by one sector: the next stride drops half."""
        return torch.cat([x, x.roll(1, dims=3)]) if self.every_turn and not self.training else x


class Block(nn.Module):
    """Basic residual block of two 3 x 3 convolutions."""

    def __init__(self, inputs: int, outputs: int, stride: int, padding: Padding) -> None:
        super().__init__()
        self.stride = stride
        self.first = PaddedConv(inputs, outputs, 3, stride, padding)
        self.first_norm = nn.BatchNorm2d(outputs)
        self.second = PaddedConv(outputs, outputs, 3, 1, padding)
        self.second_norm = nn.BatchNorm2d(outputs)
        same = stride == 1 and inputs == outputs
        self.shortcut = (
            nn.Identity()
            if same
            else nn.Sequential(nn.Conv2d(inputs, outputs, 1, stride, bias=False), nn.BatchNorm2d(outputs))
        )

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """(B, inputs, h, w) -> (B, outputs, h / stride, w / stride)."""
        y = functional.relu(self.first_norm(self.first(x)))
        return functional.relu(self.second_norm(self.second(y)) + self.shortcut(x))


class PaddedConv(nn.Conv2d):
    """Convolution without bias, with a separate padding mode for sectors and for rings."""

    def __init__(self, inputs: int, outputs: int, kernel: int, stride: int, padding: Padding) -> None:
        super().__init__(inputs, outputs, kernel, stride, bias=False)
        self.beyond = padding

    def forward(self, input: torch.Tensor) -> torch.Tensor:
        """(B, inputs, h, w) -> (B, outputs, h / stride, w / stride)."""
        return super().forward(pad(input, self.kernel_size[0] // 2, self.beyond))


def pad(x: torch.Tensor, width: int, padding: Padding) -> torch.Tensor:
    """Pad sectors (last axis) and rings (the axis before) by ``width`` at both ends, each in its own mode."""
    x = functional.pad(x, (width, width, 0, 0), mode=padding.sectors)
    return functional.pad(x, (0, 0, width, width), mode=padding.rings)


def make_network(settings: NetworkSettings, inputs: int, outputs: int, generator: torch.Generator) -> nn.Module:
    """Build a network and draw its weights from ``generator`` (on the CPU) alone.

    ``inputs`` is the number of features of one observation, unused by the ResNets, which take images; ``outputs`` that
    of the numbers predicted.
    """
    with torch.device("meta"):
        network = (
            SpectralNetwork(inputs, outputs, settings.width, settings.layers)
            if settings.architecture == "spectral"
            else ResNet(
                outputs, settings.channels, PADDING[settings.architecture], settings.architecture == "invariant"
            )
        )
    network = network.to_empty(device="cpu")
    for module in network.modules():
        if isinstance(module, nn.Linear | nn.Conv2d):
            nn.init.kaiming_normal_(module.weight, nonlinearity="relu", generator=generator)
            if module.bias is not None:
                nn.init.zeros_(module.bias)
        elif isinstance(module, nn.BatchNorm2d):
            module.reset_parameters()
    return network


def count_parameters(network: nn.Module) -> int:
    """Number of values that training adjusts."""
    return sum(parameter.numel() for parameter in network.parameters())


def _in_float32(layer: nn.Linear, x: torch.Tensor) -> torch.Tensor:
    with torch.autocast(x.device.type, enabled=False):
        return layer(x.float())
