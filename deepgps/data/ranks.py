"""Ranks of an image's pixel values, which no monotone change of its brightness alters."""

import torch


def rank_values(image: torch.Tensor) -> torch.Tensor:
    """Replace each value by the share of the values of its image and colour that are darker; equal ones share a rank.

    Light, exposure and a lens's gain change what a pixel's value is, and rarely which of two pixels is brighter. This
    is histogram equalisation, with its mid-ranks (Hummel, "Image enhancement by histogram transformation", 1977).

    Args:
        image: Pixel values (N, rings, colours, sectors) uint8.

    Returns:
        float32 of the same shape, between 0 and 255; each image's mean is 127.5 in every colour.
    """
    count, rings, colours, sectors = image.shape
    own = 256 * torch.arange(count * colours, dtype=torch.int32).view(count, 1, colours, 1)
    place = (image.int() + own).view(-1)
    values = torch.bincount(place, minlength=256 * count * colours).view(-1, 256)
    darker = values.cumsum(dim=1) - values / 2
    ranks = (darker * (255.0 / (rings * sectors))).float()
    return ranks.view(-1).index_select(0, place).view(image.shape)
