"""The camera's mounting: its lean, its motion while the shutter is open, and how images are brought upright."""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryFile

import cv2
import numpy as np

from sim.geometry import planar_pose
from sim.sensors.camera.lens import Lens, polar_rays, project_polar
from sim.settings import CameraMountSettings

CIRCLE_PX = 480  # Diameter of the round image in whose pixels an error of the optical centre is given [px]
FRAMES = 5  # Number of pictures that are averaged to an image if the robot drives while the shutter is open


def draw_leans(settings: CameraMountSettings, count: int, rng: np.random.Generator) -> np.ndarray | None:
    """Draw the lean to the right and forward (count, 2) [rad] of the next images; None if the camera is upright."""
    fixed = np.array([settings.roll_deg, settings.pitch_deg])
    if not fixed.any() and not settings.wobble_deg:
        return None
    return np.radians(fixed + settings.wobble_deg * rng.standard_normal((count, 2)))


def tilt(lean: np.ndarray) -> np.ndarray:
    """Axes (3, 3), as columns, of a camera that leans to the right and forward (2,) [rad], in the frame of the upright
    one: R_y(ahead) R_x(right)."""
    (s, t), (c, d) = np.sin(lean), np.cos(lean)
    right = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    ahead = np.array([[d, 0.0, t], [0.0, 1.0, 0.0], [-t, 0.0, d]])
    return ahead @ right


def drive_on(state: np.ndarray, driven_m: float) -> np.ndarray:
    """States (FRAMES, nq) along a straight path around ``state`` (nq,): in the middle of each of FRAMES equal parts."""
    yaw = planar_pose(state)[2]
    along = driven_m * ((np.arange(FRAMES) + 0.5) / FRAMES - 0.5)
    states = np.tile(state, (FRAMES, 1))
    states[:, :2] += along[:, None] * [np.cos(yaw), np.sin(yaw)]
    return states


PADDING_PX = 4  # Pixels that interpolation reads beyond the one it is in
CHUNK = 256  # Images that are resampled at once


@dataclass(frozen=True)
class Upright:
    """Sets polar images upright."""

    lens: Lens  # Their lens
    # Lean of the camera to the robot's right and forward [rad]; none: images stay as they are
    lean: tuple[float, float]
    # Lean that turns seem to show besides, as the camera is off the turning axis [rad]; images show none
    parallax: tuple[float, float] = (0.0, 0.0)
    # Standard deviation of single images' leans about it along each axis [rad]; it is not undone
    wobble: float = 0.0

    def __call__(self, images: np.ndarray) -> np.ndarray:
        """Upright images (N, rings, sectors, channels) uint8 of a leaning camera's images of the same shape.

        Lanczos interpolation, which blurs less than bicubic or linear; beyond the rim, where the leaning camera sees
        nothing, the last ring is repeated.
        """
        if not any(self.lean):
            return images
        maps = map_pixels(self, *images.shape[1:3])
        upright = np.empty(images.shape, images.dtype)  # of rows in order, which OpenCV needs
        for image, out in zip(images, upright, strict=True):
            cv2.remap(pad(image), *maps, cv2.INTER_LANCZOS4, dst=out)
        return upright

    def copy(self, images: np.ndarray, folder: Path) -> np.ndarray:
        """The same of images that need not fit into memory: memory-mapped, in a file without a name in ``folder``."""
        if not any(self.lean) or not len(images):  # an empty file cannot be mapped
            return images
        folder.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=folder) as file:
            for start in range(0, len(images), CHUNK):
                file.write(self(np.asarray(images[start : start + CHUNK])).tobytes())
            file.flush()
            return np.memmap(file, images.dtype, "c", shape=images.shape)


@lru_cache(maxsize=8)
def map_pixels(upright: Upright, rings: int, sectors: int) -> tuple[np.ndarray, np.ndarray]:
    """Column and row (rings, sectors) float32 of the padded image of the leaning camera, for each upright pixel."""
    seen = polar_rays(upright.lens, rings, sectors) @ tilt(np.array(upright.lean))
    row, column = np.moveaxis(project_polar(upright.lens, seen, rings, sectors), -1, 0)
    row = np.minimum(row, rings - 1.0)
    return (column + PADDING_PX).astype(np.float32), (row + PADDING_PX).astype(np.float32)


def pad(image: np.ndarray) -> np.ndarray:
    """The image padded by p = ``PADDING_PX``, across the zenith, too: (rings + 2 p, sectors + 2 p, channels)."""
    across = np.roll(image[PADDING_PX - 1 :: -1], image.shape[1] // 2, axis=1)
    whole = np.concatenate([across, image, np.repeat(image[-1:], PADDING_PX, axis=0)])
    return np.concatenate([whole[:, -PADDING_PX:], whole, whole[:, :PADDING_PX]], axis=1)
