"""Polar images of whatever a camera gives: polar images are taken as they are, raw ones are unwrapped."""

from functools import lru_cache

import numpy as np

from sim.errors import InputError
from sim.sensors.camera.unwrap import RoundImage, draw_polar


class Unwrapper:
    """Makes polar images.

    Args:
        shape: Rings, sectors and colours of a polar image.
        circle: Where the image circle is in raw images; None: it fills them, and they must be square.
    """

    def __init__(self, shape: tuple[int, ...], circle: RoundImage | None = None) -> None:
        self.shape, self.circle = shape, circle

    def __call__(self, image: np.ndarray) -> np.ndarray:
        """The polar image (rings, sectors, 3) of a polar or a raw image (height, width, 3) uint8 RGB.

        Raises:
            InputError: The circle is not known, or not in the image.
        """
        if image.shape == self.shape:
            return image
        rings, sectors, _ = self.shape
        circle = self.circle or fill(image)
        circle.check(image, rings, sectors)
        return draw_polar(image, _find_points(circle, rings, sectors), rings, sectors)


def fill(image: np.ndarray) -> RoundImage:
    """The circle that fills a square image; raises InputError if it is not square."""
    height, width = image.shape[:2]
    if height != width:
        raise InputError(
            f"it has {width} x {height} px: --centre and --radius-px must say where the image circle is, unless an "
            "image is square and the circle fills it"
        )
    return RoundImage(((width - 1) / 2, (height - 1) / 2), width / 2)


@lru_cache(maxsize=2)
def _find_points(circle: RoundImage, rings: int, sectors: int) -> tuple[np.ndarray, np.ndarray]:
    return circle.find_points(rings, sectors)
