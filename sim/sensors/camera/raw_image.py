"""Faults of the round image as the camera sends it, before it is unwrapped: glare and JPEG compression."""

from functools import partial

import cv2
import numpy as np

FACE_PX = 240  # Smallest side of the faces that it is drawn from: near the zenith a pixel is then 1.2 of a face's
BRIGHT_LIGHT, LAMP_LIGHT = 0.85, 30.0
"""Least light of a lamp or a window in an image, and what it is in truth, for an image ends at white; white = 1."""
SCATTERS = ((0.5, 1.5), (0.5, 16.0))
"""Scattered light: share, and standard deviation of the angle [deg]; a halo and a veil."""
COARSENESS = 4  # Pixels of the image, along each side, that are one in scattered light


def add_glare(light: np.ndarray, glare: float, px_per_deg: float) -> np.ndarray:
    """Linear light (px, px, 3) float32 of a round image, with a fraction of the light of lamps and windows scattered.

    Glare does not dim what scatters: what was white stays white.
    """
    bright = light.max(axis=2, keepdims=True) >= BRIGHT_LIGHT
    rows, columns = light.shape[0] // COARSENESS, light.shape[1] // COARSENESS
    lamps = cv2.resize(light * bright * np.float32(LAMP_LIGHT), (columns, rows), interpolation=cv2.INTER_AREA)
    blur = partial(cv2.GaussianBlur, lamps, (0, 0), borderType=cv2.BORDER_CONSTANT)
    scattered = np.sum([share * blur(sigmaX=deg * px_per_deg / COARSENESS) for share, deg in SCATTERS], axis=0)
    return light + np.float32(glare) * cv2.resize(scattered, light.shape[1::-1], interpolation=cv2.INTER_LINEAR)


def compress(image: np.ndarray, jpeg_kb: float) -> np.ndarray:
    """JPEG file (n,) uint8 of an image (px, px, 3) uint8, at the best quality whose file is no larger [kB].

    The file at the least quality, if even that is larger.
    """
    low, high = 1, 101
    file = _encode_jpeg(image, low)
    while high - low > 1:
        middle = (low + high) // 2
        tried = _encode_jpeg(image, middle)
        if len(tried) <= 1000 * jpeg_kb:
            low, file = middle, tried
        else:
            high = middle
    return file


def _encode_jpeg(image: np.ndarray, quality: int) -> np.ndarray:
    return cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
