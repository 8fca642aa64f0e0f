"""The fisheye lens: maps directions in the robot frame to image points, and back.

Equidistant with the optional Kannala-Brandt polynomial: the image radius grows with the angle theta from the
optical axis as ``r = f (theta + k1 theta^3 + k2 theta^5 + k3 theta^7 + k4 theta^9)`` (Kannala and Brandt, "A generic
camera model and calibration method", IEEE PAMI 28(8), 2006, eq. 6; the model of ``cv2.fisheye``). Here r is a
fraction of the image's rim: ``f`` is chosen so that the rim, half the field of view from the axis, has r = 1.

Directions are unit vectors (x forward, y left, z up along the optical axis). Two pictures are drawn:

- polar ``(rings, sectors)``: row i at ``r = (i + 0.5) / rings``, column j at ``2 pi (j + 0.5) / sectors`` from x to y;
- round ``(size, size)``: the view of an upward camera, with the robot's x axis at the top and y at the right.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim.errors import InputError
from sim.settings import CameraSettings

_EXPONENT = np.arange(1, 11, 2)


@dataclass(frozen=True)
class Lens:
    """A radially symmetric lens.

    Attributes:
        half_angle: Angle between the optical axis and the rim [rad].
        k: Kannala-Brandt coefficients k1 to k4.
    """

    half_angle: float
    k: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)

    def radius(self, theta: np.ndarray) -> np.ndarray:
        """Image radius as a fraction of the rim's, at angles ``theta`` from the axis [rad]."""
        return distort(np.asarray(theta, float), self.k) / distort(np.array(self.half_angle), self.k)

    def angle(self, radius: np.ndarray) -> np.ndarray:
        """Angle from the axis [rad] at an image radius; the inverse of ``radius`` up to just outside the rim."""
        radius = np.asarray(radius, float)
        target = radius * distort(np.array(self.half_angle), self.k)
        table = np.linspace(0.0, self.half_angle, 513)
        theta = np.interp(radius, self.radius(table), table) + np.maximum(radius - 1.0, 0.0) * self.half_angle
        for _ in range(3):  # starting from so fine a table, Newton steps reach machine precision
            theta = theta - (distort(theta, self.k) - target) / self._slope(theta)
        return theta

    def focal_length(self, rim_px: float) -> float:
        """Focal length f [px] of an image whose rim has this radius: f = rim_px / (theta + k1 theta^3 + ...) there."""
        return float(rim_px / distort(np.array(self.half_angle), self.k))

    def _slope(self, theta: np.ndarray) -> np.ndarray:
        square = theta * theta
        k1, k2, k3, k4 = self.k
        return 1.0 + square * (3 * k1 + square * (5 * k2 + square * (7 * k3 + square * 9 * k4)))


def distort(theta: np.ndarray, k: Sequence[float]) -> np.ndarray:
    """Image radius over focal length at angles from the axis [rad], by the Kannala-Brandt coefficients k1 to k4."""
    square = theta * theta
    k1, k2, k3, k4 = k
    return theta * (1.0 + square * (k1 + square * (k2 + square * (k3 + square * k4))))


def make_lens(camera: CameraSettings) -> Lens:
    """Make the lens of the settings; raises InputError if its radius stops growing before the rim."""
    half_angle = np.radians(camera.field_of_view_deg) / 2
    k = camera.distortion
    turning = _first_turning_angle(k)
    if turning <= half_angle:
        raise InputError(
            f"camera.distortion {k}: the image radius must grow with the angle from the zenith up to "
            f"{np.degrees(half_angle):g} deg (half of camera.field_of_view_deg), and stops growing at "
            f"{np.degrees(turning):.1f} deg"
        )
    return Lens(float(half_angle), k)


def project_polar(lens: Lens, directions: np.ndarray, rings: int, sectors: int) -> np.ndarray:
    """Project directions (..., 3) to the polar image: (..., 2) row, column [px], with pixel centres at integers."""
    theta, azimuth = _angles(directions)
    row = lens.radius(theta) * rings - 0.5
    column = np.mod(azimuth / (2 * np.pi), 1.0) * sectors - 0.5
    return np.stack([row, column], axis=-1)


def unproject_polar(lens: Lens, pixels: np.ndarray, rings: int, sectors: int) -> np.ndarray:
    """Directions (..., 3) seen at points (..., 2) row, column [px] of the polar image."""
    pixels = np.asarray(pixels, float)
    theta = lens.angle((pixels[..., 0] + 0.5) / rings)
    return _directions(theta, 2 * np.pi * (pixels[..., 1] + 0.5) / sectors)


def project_round(lens: Lens, directions: np.ndarray, size: int) -> np.ndarray:
    """Project directions (..., 3) to the round picture: (..., 2) row, column [px], with pixel centres at integers."""
    theta, azimuth = _angles(directions)
    radius = lens.radius(theta) * size / 2
    middle = (size - 1) / 2
    return np.stack([middle - radius * np.cos(azimuth), middle + radius * np.sin(azimuth)], axis=-1)


def unproject_round(lens: Lens, pixels: np.ndarray, size: int) -> np.ndarray:
    """Directions (..., 3) seen at points (..., 2) row, column [px] of the round picture; NaN outside its rim."""
    offset = (np.asarray(pixels, float) - (size - 1) / 2) / (size / 2)
    forward, left = -offset[..., 0], offset[..., 1]
    radius = np.hypot(forward, left)
    theta = np.where(radius <= 1.0 + 1e-9, lens.angle(np.minimum(radius, 1.0)), np.nan)
    return _directions(theta, np.arctan2(left, forward))


def polar_rays(lens: Lens, rings: int, sectors: int, centre: float = 0.0) -> np.ndarray:
    """Directions of all pixels of the polar image (rings, sectors, 3).

    The optical centre is so far ahead of the polar image's, as a fraction of the rim's radius. Pixels that are then
    outside the rim are NaN.
    """
    if not centre:
        return unproject_polar(lens, _pixels(rings, sectors), rings, sectors)
    row, column = np.moveaxis(_pixels(rings, sectors), -1, 0)
    radius, azimuth = (row + 0.5) / rings, 2 * np.pi * (column + 0.5) / sectors
    forward, left = radius * np.cos(azimuth) - centre, radius * np.sin(azimuth)
    radius = np.hypot(forward, left)
    theta = np.where(radius <= 1.0, lens.angle(np.minimum(radius, 1.0)), np.nan)
    return _directions(theta, np.arctan2(left, forward))


def round_rays(lens: Lens, size: int, centre: float = 0.0) -> np.ndarray:
    """Directions of all pixels of the round picture (size, size, 3), NaN outside the rim; ``centre`` as above."""
    return unproject_round(lens, _pixels(size, size) + [centre * size / 2, 0.0], size)


def _pixels(rows: int, columns: int) -> np.ndarray:
    return np.stack(np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij"), axis=-1)


def _angles(directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    x, y, z = np.moveaxis(np.asarray(directions, float), -1, 0)
    return np.arctan2(np.hypot(x, y), z), np.arctan2(y, x)


def _directions(theta: np.ndarray, azimuth: np.ndarray) -> np.ndarray:
    across = np.sin(theta)
    x, y, z = across * np.cos(azimuth), across * np.sin(azimuth), np.cos(theta)
    return np.stack([x, y, z], axis=-1)


def _first_turning_angle(k: tuple[float, float, float, float]) -> float:
    # the slope of the radius is a polynomial in theta^2: 1 + 3 k1 u + 5 k2 u^2 + 7 k3 u^3 + 9 k4 u^4
    roots = np.roots((_EXPONENT * np.array([1.0, *k]))[::-1])
    real = roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 0)]
    return float(np.sqrt(real.min())) if real.size else np.inf
