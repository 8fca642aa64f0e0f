"""Registers polar images by their pixels, turned to one heading, on those of the training images.

Features mix the whole circle. Pixels do not, so what is hidden, or has moved, spoils only its own, and the yaw comes
with the position. Unknown are x, y, yaw, and a gain and an offset of the light; Gauss-Newton with Cauchy's weights
minimises ``sum_i rho((turn(q, yaw)_i - gain f_i(x, y) - offset) / noise_i)``, f being the kriged image.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import fft
from scipy.spatial import KDTree

from deepgps.positioner.kriging import NEIGHBOURS, Kernel, Surroundings, find_nearest, limit

ROUNDS, OUTLIER = 2, 1.5  # Rounds of Gauss-Newton; residual that counts half, in standard deviations
STEP_M, STEP_RAD = 0.15, 0.1  # Largest step of a round [m], [rad]
MAX_PIXELS = 1024  # Images with more are halved
CORRELATION_SAMPLES = 512  # Samples of the circular correlation
DAMPING = 1e-4
GAINS = 0.3, 3.0  # Smallest and largest gain


class PixelMatch(NamedTuple):
    """Registrations of n images."""

    position: np.ndarray  # (n, 2) [m]
    yaw: np.ndarray  # Heading of the camera, counter-clockwise even where the map is mirrored (n,) [rad]
    covariance: np.ndarray  # Of x, y and yaw, but for a common factor (n, 3, 3)
    weight: np.ndarray  # Weight of each pixel (n, R, S), 1 where it agrees
    spread: np.ndarray  # Median absolute residual, in standard deviations of the noise (n,)
    variance: np.ndarray  # Of the prediction, relative (n,)
    gain: np.ndarray  # Brightness over that of the training images (n,)


@dataclass(frozen=True)
class KnownPixels:
    """Grey training images, turned to one heading."""

    images: np.ndarray  # (N, R, S) uint8
    noise: np.ndarray  # Standard deviation of each ring's pixels (R,)
    heading: float  # The heading of all [rad], counter-clockwise even where the map is mirrored

    def register(
        self, images: np.ndarray, start: np.ndarray, tree: KDTree, kernel: Kernel, index: np.ndarray | None = None
    ) -> PixelMatch:
        """Register grey images (n, R, S) from positions (n, 2) [m].

        ``tree`` holds the places of the training images. These are predicted from the nearest, or from those with
        numbers ``index`` (n, k).
        """
        count, _, sectors = images.shape
        index = find_nearest(tree, start, NEIGHBOURS)[1] if index is None else index
        around = Surroundings.find(tree.data, index, kernel)
        near = self.images.reshape(len(self.images), -1).take(index, axis=0).astype(np.float32)
        sharp = np.repeat(1.0 / self.noise, sectors).astype(np.float32)
        gain, offset = np.ones((count, 1), np.float32), np.zeros((count, 1), np.float32)
        position, yaw = start.copy(), None
        for step in range(ROUNDS + 1):
            weights = around.krige(position)
            seen = weights.both.astype(np.float32) @ near
            if yaw is None:
                yaw = find_yaw(images, seen[:, 0].reshape(images.shape))
            turned, change = (part.reshape(count, -1) for part in turn(images, yaw))
            rows = np.ones((count, 6, len(sharp)), np.float32)  # derivatives, then the residual
            rows[:, :2], rows[:, 2], rows[:, 3] = gain[:, None] * seen[:, 1:], -change, seen[:, 0]
            rows[:, 5] = turned - gain * seen[:, 0] - offset
            rows *= sharp
            size = np.abs(rows[:, 5])
            middle = size.shape[1] // 2
            spread = np.maximum(np.partition(size, middle, axis=1)[:, middle], 1e-6)
            weight = 1.0 / (1.0 + (size / (1.4826 * OUTLIER * spread[:, None])) ** 2)
            product = (rows * weight[:, None]) @ np.swapaxes(rows, 1, 2)
            normal = product[:, :5, :5].astype(float)
            diagonal = np.einsum("ncc->nc", normal)
            diagonal += DAMPING * diagonal + 1e-12
            if step == ROUNDS:
                break
            move = np.linalg.solve(normal, product[:, :5, 5:])[..., 0]
            position += limit(move[:, :2], STEP_M)
            yaw = yaw + move[:, 2].clip(-STEP_RAD, STEP_RAD)
            gain = (gain + move[:, 3:4].astype(np.float32)).clip(*GAINS)
            offset = offset + move[:, 4:].astype(np.float32)
        covariance = spread[:, None, None] ** 2 * np.linalg.inv(normal)[:, :3, :3]
        return PixelMatch(
            position,
            np.asarray(yaw) + self.heading,
            covariance,
            weight.reshape(images.shape),
            spread,
            weights.variance,
            gain[:, 0] + offset[:, 0] / np.maximum(seen[:, 0].mean(axis=1), 1.0),
        )


def grey(images: np.ndarray) -> np.ndarray:
    """Polar images (N, rings, sectors, colours) without colours, large ones halved (N, R, S) float32."""
    _, rings, sectors, colours = images.shape
    total, terms = images.astype(np.float32), colours
    if rings * sectors > MAX_PIXELS:
        total, terms = total[:, : rings // 2 * 2 : 2] + total[:, 1::2], 4 * colours
        total = total[:, :, : sectors // 2 * 2 : 2] + total[:, :, 1::2]
    return (total.reshape(-1, colours) @ np.full(colours, 1.0 / terms, np.float32)).reshape(total.shape[:3])


def turn(images: np.ndarray, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Images (n, R, S) as seen with the camera turned by -angle (n,) [rad], and their derivatives by the angle."""
    sectors = images.shape[2]
    waves = np.asarray(fft.rfft(images, axis=2))
    frequency = np.arange(waves.shape[2], dtype=images.dtype)
    waves *= np.exp(-1j * frequency * angle[:, None, None].astype(images.dtype))
    turned, change = np.asarray(fft.irfft(np.stack([waves, -1j * frequency * waves]), sectors, axis=3))
    return turned, change


def find_yaw(images: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Angles (n,) [rad] by which images (n, R, S) must be turned to match known ones, by circular correlation."""
    one, other = (np.asarray(fft.rfft(part, axis=2)) for part in (images, known))
    rings = np.sqrt(np.arange(images.shape[1]) + 0.5).astype(np.float32)
    cross = (rings[:, None] * other * one.conj()).sum(axis=1)
    cross[:, 0] = 0.0
    curve = np.asarray(fft.irfft(cross, CORRELATION_SAMPLES, axis=1))
    best, rows = curve.argmax(axis=1), np.arange(len(curve))
    before, top, after = (curve[rows, (best + step) % CORRELATION_SAMPLES] for step in (-1, 0, 1))
    bend = before - 2.0 * top + after
    beside = np.divide(before - after, 2.0 * bend, out=np.zeros_like(bend), where=bend != 0.0)
    return 2.0 * np.pi * (best + beside) / CORRELATION_SAMPLES
