"""The polar image of a raw fisheye image: rings from the centre to the rim, sectors once around."""

from dataclasses import dataclass

import cv2
import numpy as np

from sim.errors import InputError
from sim.sensors.camera.lens import Lens

MOST_FINER = 16
"""Largest number of points, along each axis, whose mean is a pixel of the polar image."""
LARGEST_PX = 32_000
"""Largest side of an image that OpenCV remaps."""
MOST_DEG = 360
"""Largest angle of the forward axis, to either side."""


def unwrap_fisheye(
    images: np.ndarray,
    centre: tuple[float, float],
    radius_px: float,
    rings: int = 32,
    sectors: int = 128,
    forward_deg: float = 0.0,
    lens: Lens | None = None,
    polar_lens: Lens | None = None,
) -> np.ndarray:
    """Polar images of the raw images of a fisheye camera that looks up.

    The distance from the centre of the image grows along the rings as in the raw image, so a camera that is used both
    in training and in deployment needs no lens here. To show a network the images of a camera with another lens than
    the one that it was trained with, give both lenses.

    Args:
        images: One raw image (height, width, 3) or several (N, height, width, 3), uint8 RGB.
        centre: Column and row of the optical axis in the raw image [px], with pixel centres at integers.
        radius_px: Distance of the image's rim from the centre [px]. With OpenCV's fisheye calibration, this is
            f (t + k1 t^3 + k2 t^5 + k3 t^7 + k4 t^9), where t is half the field of view [rad].
        rings: Rows of the polar image, from the zenith to the rim.
        sectors: Columns of the polar image, counter-clockwise from the robot's forward axis as seen from above.
        forward_deg: Direction of the robot's forward axis in the raw image, clockwise from the image's top [deg].
        lens: Lens of the camera, whose rim is at ``radius_px``; None: that of the polar image.
        polar_lens: Lens of the polar image; None: that of the camera.

    Returns:
        Polar images (rings, sectors, 3) or (N, rings, sectors, 3) uint8, black where the raw image shows nothing.

    Raises:
        InputError: The images have the wrong shape or type, or the centre, a size or the angle is impossible.
    """
    images = np.asarray(images)
    _check(images, centre, radius_px, rings, sectors, forward_deg)
    across, around = oversample(radius_px, rings, sectors)
    warp = _make_warp(centre, radius_px, rings * across, sectors * around, forward_deg, lens, polar_lens)
    batch = images if images.ndim == 4 else images[None]
    polar = np.empty((len(batch), rings, sectors, 3), np.uint8)
    for index, image in enumerate(batch):
        polar[index] = draw_polar(image, warp, rings, sectors)
    return polar if images.ndim == 4 else polar[0]


def oversample(radius_px: float, rings: int, sectors: int) -> tuple[int, int]:
    """Points whose mean is a pixel of the polar image, across and along the rings; the rim has this radius [px]."""
    across = int(np.clip(np.ceil(radius_px / rings), 1, MOST_FINER))
    around = int(np.clip(np.ceil(2 * np.pi * radius_px / sectors), 1, min(MOST_FINER, LARGEST_PX // sectors)))
    return across, around


def draw_polar(image: np.ndarray, warp: tuple[np.ndarray, np.ndarray], rings: int, sectors: int) -> np.ndarray:
    """The polar image (rings, sectors, 3) of an image, by the column and row of its points [px], several per pixel."""
    fine = cv2.remap(np.ascontiguousarray(image), *warp, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    return cv2.resize(fine, (sectors, rings), interpolation=cv2.INTER_AREA)


def _make_warp(
    centre: tuple[float, float],
    radius_px: float,
    rings: int,
    sectors: int,
    forward_deg: float,
    lens: Lens | None,
    polar_lens: Lens | None,
) -> tuple[np.ndarray, np.ndarray]:
    """Column and row of the raw image at each point of a polar image, both (rings, sectors) float32 [px]."""
    radius = (np.arange(rings) + 0.5)[:, None] / rings
    if lens is not None and polar_lens is not None:
        angle = polar_lens.angle(radius)
        radius = np.where(angle <= lens.half_angle, lens.radius(angle), np.nan)
    # The view from below is a mirror image of the view from above: counter-clockwise there is clockwise here.
    azimuth = 2 * np.pi * (np.arange(sectors) + 0.5) / sectors + np.radians(forward_deg)
    column = centre[0] + radius_px * radius * np.sin(azimuth)
    row = centre[1] - radius_px * radius * np.cos(azimuth)
    return tuple(np.nan_to_num(axis, nan=-1e6).astype(np.float32) for axis in (column, row))


def _check(
    images: np.ndarray, centre: tuple[float, float], radius_px: float, rings: int, sectors: int, forward_deg: float
) -> None:
    if images.ndim not in {3, 4} or images.shape[-1] != 3 or images.dtype != np.uint8 or 0 in images.shape[-3:]:
        raise InputError(
            f"images {images.shape} {images.dtype}: must be (height, width, 3) or (N, height, width, 3) uint8 RGB"
        )
    height, width = images.shape[-3:-1]
    if max(height, width) > LARGEST_PX:
        raise InputError(f"images {images.shape}: height and width must be at most {LARGEST_PX} px")
    column, row = centre
    if not (0 <= column <= width - 1 and 0 <= row <= height - 1):
        raise InputError(f"centre {tuple(centre)}: must be column and row in an image of {width} x {height} px")
    if not 1 <= radius_px <= LARGEST_PX:
        raise InputError(f"radius_px {radius_px}: must be from 1 to {LARGEST_PX}")
    if not (1 <= rings <= 1024 and 1 <= sectors <= 4096):
        raise InputError(f"rings {rings} and sectors {sectors}: must be from 1 to 1024, and from 1 to 4096")
    if not abs(forward_deg) <= MOST_DEG:  # also refuses NaN
        raise InputError(f"forward_deg {forward_deg}: must be from -{MOST_DEG} to {MOST_DEG}")


@dataclass(frozen=True)
class RoundImage:
    """Where the image circle is in the raw images of a camera that looks up, as for ``unwrap_fisheye``.

    Attributes:
        centre: Column and row of the optical axis [px].
        radius_px: Distance of the rim from the centre [px].
        forward_deg: Direction of the robot's forward axis, clockwise from the image's top [deg].
    """

    centre: tuple[float, float]
    radius_px: float
    forward_deg: float = 0.0

    def find_points(self, rings: int, sectors: int) -> tuple[np.ndarray, np.ndarray]:
        """Columns and rows that ``draw_polar`` takes, the same for all images of the camera."""
        across, around = oversample(self.radius_px, rings, sectors)
        size = (rings * across, sectors * around)
        return _make_warp(self.centre, self.radius_px, *size, self.forward_deg, None, None)

    def check(self, image: np.ndarray, rings: int, sectors: int) -> None:
        """Raise InputError if this cannot be the circle in a raw image (height, width, 3) uint8."""
        _check(image, self.centre, self.radius_px, rings, sectors, self.forward_deg)
