"""A calibrated camera that looks up: where it sees a direction in its raw image, and the polar image of what it sees.

The polar image is always that of an equidistant lens, whatever the camera's own lens does. The camera's axes are those
of ROS: x to the right in the image, y down, z along the optical axis. With the image's top towards the robot's front, x
is the robot's left: something seen from below is mirrored against the view from above.
"""

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from sim.errors import InputError
from sim.sensors.camera.lens import Lens, distort, polar_rays
from sim.sensors.camera.unwrap import draw_polar, oversample

Model = Literal["equidistant", "plumb_bob", "rational_polynomial"]
MODELS: dict[str, Model] = {
    **dict.fromkeys(("equidistant", "fisheye", "kannala_brandt"), "equidistant"),
    **dict.fromkeys(("plumb_bob", "rational_polynomial"), "plumb_bob"),
}
"""Model by the names that drivers and calibration programs use; the rational one has more coefficients of OpenCV's."""
COEFFICIENTS = {"equidistant": 4, "fisheye": 4, "kannala_brandt": 4, "plumb_bob": 5, "rational_polynomial": 8}
WIDEST, PINHOLE = np.radians(95.0), np.radians(80.0)
"""Largest angle from the axis that is used, of a fisheye and of a pinhole with distortion [rad]."""
STEPS = 951


@dataclass(frozen=True)
class RawCamera:
    """Intrinsics, with pixel centres at integers.

    Attributes:
        model: Name of the lens's model.
        size: Width and height of the image [px].
        focal: Focal lengths fx, fy [px].
        centre: Column and row of the optical axis [px].
        coefficients: Of the distortion, as many as the model has.
    """

    model: str
    size: tuple[int, int]
    focal: tuple[float, float]
    centre: tuple[float, float]
    coefficients: tuple[float, ...]

    def project(self, theta: np.ndarray, azimuth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Column and row [px] of directions by their angles from the optical axis, and from x to y [rad]."""
        if MODELS[self.model] == "equidistant":
            radius = distort(theta, self.coefficients)
            x, y = radius * np.cos(azimuth), radius * np.sin(azimuth)
            return self.focal[0] * x + self.centre[0], self.focal[1] * y + self.centre[1]
        across = np.tan(theta)
        points = np.stack([across * np.cos(azimuth), across * np.sin(azimuth), np.ones_like(across + azimuth)], axis=-1)
        matrix = np.array([[self.focal[0], 0, self.centre[0]], [0, self.focal[1], self.centre[1]], [0, 0, 1.0]])
        none = np.zeros(3)
        pixels, _ = cv2.projectPoints(points.reshape(-1, 1, 3), none, none, matrix, np.array(self.coefficients))
        return tuple(pixels.reshape(*points.shape[:-1], 2).transpose(-1, *range(points.ndim - 1)))

    def find_half_angle(self, circle_px: float | None = None) -> float:
        """Largest angle from the axis [rad] up to which all directions are inside the image and the image circle.

        Args:
            circle_px: Radius of the image circle around the optical axis [px]; None: it fills the image.
        """
        widest = WIDEST if MODELS[self.model] == "equidistant" else PINHOLE
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
    if camera.model not in MODELS:
        raise InputError(f"distortion model {camera.model!r}: must be {', '.join(MODELS)}")
    if not np.isfinite(camera.coefficients).all():
        raise InputError(f"distortion coefficients {camera.coefficients}: must be finite")
    if not (np.isfinite([*camera.focal, *camera.centre]).all() and min(camera.focal) > 0):
        raise InputError(f"focal lengths {camera.focal} and centre {camera.centre}: must be finite, and positive")
    if not (0 <= column <= width - 1 and 0 <= row <= height - 1):
        raise InputError(f"centre {column:g}, {row:g}: must be in the image of {width} x {height} px")


class Unwrapping:
    """Makes polar images of a camera's raw images."""

    def __init__(
        self,
        camera: RawCamera,
        lens: Lens,
        rings: int,
        sectors: int,
        forward_deg: float = 0.0,
        mirrored: bool = False,
    ) -> None:
        """Prepare the maps.

        Args:
            camera: The camera.
            lens: Lens of the polar image, in whose rim everything must be seen.
            rings: Rows of the polar image.
            sectors: Its columns, counter-clockwise from the robot's forward axis as seen from above.
            forward_deg: Direction of the robot's forward axis in the raw image, clockwise from its top [deg].
            mirrored: Whether the raw image is mirrored left to right.
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

        Raises:
            InputError: The image has another size than the calibration.
        """
        if image.shape[1::-1] != self.camera.size:
            width, height = self.camera.size
            raise InputError(
                f"image of {image.shape[1]} x {image.shape[0]} px: the calibration is for {width} x {height} px"
            )
        return draw_polar(image, self._maps, self.rings, self.sectors)
