"""A camera's automatic exposure and white balance, for each image by itself."""

import numpy as np

GREY = 0.18
"""Mean brightness that automatic exposure brings an image to, as a fraction of white: a grey card's."""
MOST_GAIN = 64.0
"""Largest gain of a colour."""


def expose(light: np.ndarray) -> np.ndarray:
    """Return linear light (..., rings, sectors, 3) with automatic exposure and white balance.

    Both together bring the mean of each colour to ``GREY`` ("grey world": Buchsbaum, Journal of the Franklin Institute
    310, 1980), with gains of at most ``MOST_GAIN``. What becomes brighter than white is cut off later.
    """
    mean = light.mean(axis=(-3, -2), keepdims=True)
    return light * np.minimum(GREY / np.maximum(mean, 1e-6), MOST_GAIN).astype(np.float32)
