"""Copies of polar images under other light: smooth random gains, by which slow features learn what light changes.

Lamps that are off and windows at dusk brighten or darken parts of a room, which ranks over the image do not undo.
"""

from functools import lru_cache

import numpy as np
import torch

GAIN, COLOUR_GAIN = 0.4, 0.1
"""Standard deviation of the logarithm of the light's gain, shared by the colours, and of what is each colour's own."""
WAVES, BENDS = 4, 2
"""Highest number of periods of a gain around the circle, and of half periods from the centre to the rim."""
DIMMER = 0.8
"""Factor of all values, which leaves room for gains above 1."""
GAMMA = 2.2
"""Pixel values grow with about this root of the light."""


def relight(images: np.ndarray, generator: torch.Generator) -> np.ndarray:
    """Copies of polar images (N, rings, sectors, colours) uint8, each under another random light."""
    count, rings, sectors, colours = images.shape
    waves = _make_waves(rings, sectors)
    shared = GAIN * torch.randn((count, 1, len(waves)), generator=generator)
    own = COLOUR_GAIN * torch.randn((count, colours, len(waves)), generator=generator)
    gain = ((shared + own) @ waves).div_(GAMMA).exp_().view(count, colours, rings, sectors).permute(0, 2, 3, 1)
    return (torch.from_numpy(images) * gain * DIMMER).round_().clamp_(0.0, 255.0).to(torch.uint8).numpy()


@lru_cache(maxsize=8)
def _make_waves(rings: int, sectors: int) -> torch.Tensor:
    """Waves around the circle and along the radius (W, rings * sectors), smoother ones larger; RMS 1 in total."""
    angle, radius = 2.0 * np.pi * np.arange(sectors) / sectors, (np.arange(rings) + 0.5) / rings
    made = []
    for wave in range(WAVES + 1):
        for bend in range(BENDS + 1):
            along = np.cos(np.pi * bend * radius)[:, None] / ((1.0 + wave / 2.0) * (1.0 + bend / 2.0))
            made += [along * np.cos(wave * angle), *([along * np.sin(wave * angle)] if wave else [])]
    waves = np.array(made).reshape(len(made), -1)
    return torch.from_numpy((waves / np.sqrt((waves**2).sum(axis=0).mean())).astype(np.float32))
