"""Light in images: ranks of pixel values, which it rarely alters, and copies of polar images under other light.

Lamps that are off and windows at dusk brighten or darken parts of a room, which ranks over the image do not undo. From
copies under smooth random gains, slow features learn what light changes.
"""

from functools import lru_cache

import numpy as np
import torch


def rank_values(image: torch.Tensor) -> torch.Tensor:
    """Replace each value of an image by the share of its values, of all colours, that are darker.

    Equal values share the mean of their ranks. Light, exposure and gamma change what a pixel's value is, and rarely
    which of two pixels is brighter. This is histogram equalisation (Hummel, "Image enhancement by histogram
    transformation", Computer Graphics and Image Processing 6(2), 1977).

    Args:
        image: Pixel values (N, ...) uint8.

    Returns:
        float32 of the same shape, between 0 and 255; the mean of each image is 127.5.
    """
    flat = image.flatten(1)
    count, size = flat.shape
    own = 256 * torch.arange(count, dtype=torch.int32)
    place = (flat.int() + own[:, None]).view(-1)
    values = torch.bincount(place, minlength=256 * count).view(count, 256)
    ranks = ((values.cumsum(dim=1) - values / 2) * (255.0 / size)).float()
    return ranks.view(-1).index_select(0, place).view(image.shape)


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
