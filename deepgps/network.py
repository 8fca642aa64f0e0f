"""Networks that map one observation to one position: layers on features, and the paper's circular ResNet-18."""

from itertools import pairwise

import torch
from torch import nn
from torch.nn import functional

from deepgps.settings import NetworkSettings


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

    Args:
        outputs: Numbers predicted.
        channels: Channels of the first stage; ResNet-18 has 64.
        both_ways: Circular padding along rings too, as the paper writes; otherwise zeros beyond zenith and rim.
    """

    def __init__(self, outputs: int, channels: int, both_ways: bool) -> None:
        super().__init__()
        self.first = CircularConv(3, channels, 3, 2, both_ways)
        self.first_norm = nn.BatchNorm2d(channels)
        self.both_ways = both_ways
        stages, before = [], channels
        for stage in range(4):
            after = channels * 2**stage
            stride = 1 if stage == 0 else 2
            stages += [Block(before, after, stride, both_ways), Block(after, after, 1, both_ways)]
            before = after
        self.blocks = nn.Sequential(*stages)
        self.head = nn.Linear(before, outputs)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Positions (B, outputs) [m]."""
        x = functional.relu(self.first_norm(self.first(x)))
        # After a ReLU nothing is below zero, so zeros beyond zenith and rim never win the maximum.
        x = functional.max_pool2d(pad_circular(x, 1, self.both_ways), 3, 2)
        x = self.blocks(x)
        return _in_float32(self.head, x.mean(dim=(2, 3)))


class Block(nn.Module):
    """Basic residual block of two circular 3 x 3 convolutions."""

    def __init__(self, inputs: int, outputs: int, stride: int, both_ways: bool) -> None:
        super().__init__()
        self.first = CircularConv(inputs, outputs, 3, stride, both_ways)
        self.first_norm = nn.BatchNorm2d(outputs)
        self.second = CircularConv(outputs, outputs, 3, 1, both_ways)
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


class CircularConv(nn.Conv2d):
    """Convolution without bias whose padding joins the last sector to the first."""

    def __init__(self, inputs: int, outputs: int, kernel: int, stride: int, both_ways: bool) -> None:
        super().__init__(inputs, outputs, kernel, stride, bias=False)
        self.both_ways = both_ways

    def forward(self, input: torch.Tensor) -> torch.Tensor:
        """(B, inputs, h, w) -> (B, outputs, h / stride, w / stride)."""
        return super().forward(pad_circular(input, self.kernel_size[0] // 2, self.both_ways))


def pad_circular(x: torch.Tensor, width: int, both_ways: bool) -> torch.Tensor:
    """Pad sectors (last axis) around the circle, and rings (the axis before) with zeros, or around as well."""
    x = functional.pad(x, (width, width, 0, 0), mode="circular")
    return functional.pad(x, (0, 0, width, width), mode="circular" if both_ways else "constant")


def make_network(settings: NetworkSettings, inputs: int, outputs: int, generator: torch.Generator) -> nn.Module:
    """Build a network and draw its weights from ``generator`` alone.

    Args:
        settings: Which network.
        inputs: Features of one observation; unused by the ResNets, which take images.
        outputs: Numbers predicted.
        generator: A CPU generator.
    """
    with torch.device("meta"):
        network = (
            SpectralNetwork(inputs, outputs, settings.width, settings.layers)
            if settings.architecture == "spectral"
            else ResNet(outputs, settings.channels, settings.architecture == "resnet_paper")
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
    """Numbers that training adjusts."""
    return sum(parameter.numel() for parameter in network.parameters())


def _in_float32(layer: nn.Linear, x: torch.Tensor) -> torch.Tensor:
    with torch.autocast(x.device.type, enabled=False):
        return layer(x.float())
