"""Ranks of an image's pixel values, which no monotone change of its brightness alters."""

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
