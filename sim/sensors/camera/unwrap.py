"""The polar image of a raw fisheye image: rings from the centre to the rim, sectors once around.

Without a calibration it is that of the camera's own lens; with one, always that of an equidistant lens. The calibrated
camera's axes are those of ROS: x to the right in the image, y down, z along the optical axis. With the image's top
towards the robot's front, x is the robot's left: something seen from below is mirrored against the view from above.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from sim.errors import InputError
from sim.sensors.camera.lens import Lens, distort, polar_rays

MAX_OVERSAMPLING = 16  # Largest number of points, along each axis, whose mean is a pixel of the polar image
MAX_SIDE_PX = 32_000  # Largest side of an image that OpenCV remaps
MAX_YAW_DEG = 360  # Largest angle of the forward axis, to either side


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
    circle = RoundImage(centre, radius_px, forward_deg)
    circle.check(images, rings, sectors)
    points = circle.find_points(rings, sectors, lens, polar_lens)
    if images.ndim == 3:
        return draw_polar(images, points, rings, sectors)
    polar = [draw_polar(image, points, rings, sectors) for image in images]
    return np.array(polar, np.uint8).reshape(-1, rings, sectors, 3)


def oversample(radius_px: float, rings: int, sectors: int) -> tuple[int, int]:
    """Points whose mean is a pixel of the polar image, across and along the rings; the rim has this radius [px]."""
    across = int(np.clip(np.ceil(radius_px / rings), 1, MAX_OVERSAMPLING))
    around = int(np.clip(np.ceil(2 * np.pi * radius_px / sectors), 1, min(MAX_OVERSAMPLING, MAX_SIDE_PX // sectors)))
    return across, around


def draw_polar(image: np.ndarray, warp: tuple[np.ndarray, np.ndarray], rings: int, sectors: int) -> np.ndarray:
    """The polar image (rings, sectors, 3) of an image, by the column and row of its points [px], several per pixel."""
    fine = cv2.remap(np.ascontiguousarray(image), *warp, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    return cv2.resize(fine, (sectors, rings), interpolation=cv2.INTER_AREA)


@dataclass(frozen=True)
class RoundImage:
    """Where the image circle is in the raw images of a camera that looks up, as for ``unwrap_fisheye``."""

    centre: tuple[float, float]  # Column and row of the optical axis [px]
    radius_px: float  # Distance of the rim from the centre [px]
    forward_deg: float = 0.0  # Direction of the robot's forward axis, clockwise from the image's top [deg]

    def find_points(
        self, rings: int, sectors: int, lens: Lens | None = None, polar_lens: Lens | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Columns and rows that ``draw_polar`` takes, the same for all images of the camera, both float32 [px]."""
        across, around = oversample(self.radius_px, rings, sectors)
        radius = (np.arange(rings * across) + 0.5)[:, None] / (rings * across)
        if lens is not None and polar_lens is not None:
            angle = polar_lens.angle(radius)
            radius = np.where(angle <= lens.half_angle, lens.radius(angle), np.nan)
        # The view from below is a mirror image of the view from above: counter-clockwise there is clockwise here.
        azimuth = 2 * np.pi * (np.arange(sectors * around) + 0.5) / (sectors * around) + np.radians(self.forward_deg)
        column = self.centre[0] + self.radius_px * radius * np.sin(azimuth)
        row = self.centre[1] - self.radius_px * radius * np.cos(azimuth)
        return tuple(np.nan_to_num(axis, nan=-1e6).astype(np.float32) for axis in (column, row))

    def check(self, images: np.ndarray, rings: int, sectors: int) -> None:
        """Raise InputError if this cannot be the circle in raw images (..., height, width, 3) uint8, one or several."""
        if images.ndim not in {3, 4} or images.shape[-1] != 3 or images.dtype != np.uint8 or 0 in images.shape[-3:]:
            raise InputError(
                f"images {images.shape} {images.dtype}: must be (height, width, 3) or (N, height, width, 3) uint8 RGB"
            )
        height, width = images.shape[-3:-1]
        if max(height, width) > MAX_SIDE_PX:
            raise InputError(f"images {images.shape}: height and width must be at most {MAX_SIDE_PX} px")
        column, row = self.centre
        if not (0 <= column <= width - 1 and 0 <= row <= height - 1):
            raise InputError(
                f"centre {tuple(self.centre)}: must be column and row in an image of {width} x {height} px"
            )
        if not 1 <= self.radius_px <= MAX_SIDE_PX:
            raise InputError(f"radius_px {self.radius_px}: must be from 1 to {MAX_SIDE_PX}")
        if not (1 <= rings <= 1024 and 1 <= sectors <= 4096):
            raise InputError(f"rings {rings} and sectors {sectors}: must be from 1 to 1024, and from 1 to 4096")
        if not abs(self.forward_deg) <= MAX_YAW_DEG:  # also refuses NaN
            raise InputError(f"forward_deg {self.forward_deg}: must be from -{MAX_YAW_DEG} to {MAX_YAW_DEG}")


FISHEYES, PINHOLES = ("equidistant", "fisheye", "kannala_brandt"), ("plumb_bob", "rational_polynomial")
COEFFICIENTS = {**dict.fromkeys(FISHEYES, 4), "plumb_bob": 5, "rational_polynomial": 8, "omni": 5}
"""Number of coefficients by the names of models that drivers and calibration programs use; those of pinholes are
OpenCV's, and the first of omni is the distance of its centres, xi."""
MAX_FISHEYE_ANGLE, MAX_PINHOLE_ANGLE = np.radians(95.0), np.radians(80.0)
"""Largest angle from the axis that is used, of a fisheye and of a pinhole with distortion [rad]."""
STEPS = 951


@dataclass(frozen=True)
class RawCamera:
    """Intrinsics, with pixel centres at integers."""

    model: str  # Name of the lens's model
    size: tuple[int, int]  # Width and height of the image [px]
    focal: tuple[float, float]  # Focal lengths fx, fy [px]
    centre: tuple[float, float]  # Column and row of the optical axis [px]
    coefficients: tuple[float, ...]  # Of the distortion, as many as the model has

    def project(self, theta: np.ndarray, azimuth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Column and row [px] of directions by their angles from the optical axis, and from x to y [rad]."""
        if self.model in FISHEYES:
            radius = distort(theta, self.coefficients)
            x, y = radius * np.cos(azimuth), radius * np.sin(azimuth)
            return self.focal[0] * x + self.centre[0], self.focal[1] * y + self.centre[1]
        xi, distortion = (
            (0.0, self.coefficients) if self.model != "omni" else (self.coefficients[0], self.coefficients[1:])
        )
        across = np.sin(theta) / np.maximum(np.cos(theta) + xi, 1e-9)
        points = np.stack([across * np.cos(azimuth), across * np.sin(azimuth), np.ones_like(across + azimuth)], axis=-1)
        matrix = np.array([[self.focal[0], 0, self.centre[0]], [0, self.focal[1], self.centre[1]], [0, 0, 1.0]])
        none = np.zeros(3)
        pixels, _ = cv2.projectPoints(points.reshape(-1, 1, 3), none, none, matrix, np.array(distortion))
        return tuple(pixels.reshape(*points.shape[:-1], 2).transpose(-1, *range(points.ndim - 1)))

    def find_half_angle(self, circle_px: float | None = None) -> float:
        """Largest angle from the axis [rad] up to which all directions are inside the image and the image circle, if
        any [px]."""
        widest = MAX_PINHOLE_ANGLE if self.model in PINHOLES else MAX_FISHEYE_ANGLE
        theta, azimuth = np.linspace(0.0, widest, STEPS)[:, None], np.linspace(0.0, 2 * np.pi, 360, endpoint=False)
        column, row = self.project(theta, azimuth[None])
        away = np.hypot(column - self.centre[0], row - self.centre[1])
        inside = (column >= -0.5) & (column <= self.size[0] - 0.5) & (row >= -0.5) & (row <= self.size[1] - 0.5)
        inside &= away <= (np.inf if circle_px is None else circle_px)
        inside[1:] &= np.diff(away, axis=0) > 0.0  # beyond, the model folds back
        seen = inside.all(axis=1)
        return float(theta[STEPS - 1 if seen.all() else max(int(np.argmin(seen)) - 1, 0), 0])


def check_camera(camera: RawCamera) -> None:
    """Raise InputError if intrinsics are impossible."""
    (width, height), (column, row) = camera.size, camera.centre
    if camera.model not in COEFFICIENTS:
        raise InputError(f"distortion model {camera.model!r}: must be {', '.join(COEFFICIENTS)}")
    if not np.isfinite(camera.coefficients).all():
        raise InputError(f"distortion coefficients {camera.coefficients}: must be finite")
    if not (np.isfinite([*camera.focal, *camera.centre]).all() and min(camera.focal) > 0):
        raise InputError(f"focal lengths {camera.focal} and centre {camera.centre}: must be finite, and positive")
    if not (0 <= column <= width - 1 and 0 <= row <= height - 1):
        raise InputError(f"centre {column:g}, {row:g}: must be in the image of {width} x {height} px")


class Unwrapping:
    """Makes polar images of a camera's raw images."""

    def __init__(
        self, camera: RawCamera, lens: Lens, rings: int, sectors: int, forward_deg: float = 0.0, mirrored: bool = False
    ) -> None:
        """Prepare the maps from a camera to a polar image of a lens in whose rim everything must be seen.

        Columns are counter-clockwise from the robot's forward axis as seen from above, whose direction in the raw image
        is clockwise from its top [deg]; this may be mirrored left to right.
        """
        check_camera(camera)
        self.camera, self.rings, self.sectors = camera, rings, sectors
        across, around = oversample(float(np.hypot(*camera.focal) / 2**0.5 * lens.half_angle), rings, sectors)
        rays = polar_rays(lens, rings * across, sectors * around)
        theta, azimuth = np.arccos(np.clip(rays[..., 2], -1, 1)), np.arctan2(rays[..., 1], rays[..., 0])
        # From the image's top to its right is counter-clockwise from above; the image's x is at its right.
        turned = azimuth + np.radians(-forward_deg if mirrored else forward_deg)
        column, row = camera.project(theta, turned - np.pi / 2)
        if mirrored:
            column = 2 * camera.centre[0] - column
        self._maps = column.astype(np.float32), row.astype(np.float32)

    def __call__(self, image: np.ndarray) -> np.ndarray:
        """The polar image (rings, sectors, 3) uint8 of a raw image (height, width, 3) uint8, black where it ends.

        Raises InputError if the image has another size than the calibration.
        """
        if image.shape[1::-1] != self.camera.size:
            width, height = self.camera.size
            raise InputError(
                f"image of {image.shape[1]} x {image.shape[0]} px: the calibration is for {width} x {height} px"
            )
        return draw_polar(image, self._maps, self.rings, self.sectors)
