"""Pictures for people: round ones of polar images, JPEG, and figures."""

from collections.abc import Iterable

import cv2
import numpy as np
import rerun as rr
from matplotlib.figure import Figure

from deepgps.reports.plots import to_png
from deepgps.viewer.stream import Rows, put, send_rows
from sim.sensors.camera.lens import make_lens, project_polar, round_rays
from sim.settings import CameraSettings

ROUND_PX = 160  # Side of the round pictures [px]
JPEG_QUALITY = 85
POLAR_PICTURES = {"fisheye": "Fisheye", "polar": "Polar image, zenith at the top"}
"""Pictures of a polar image by name, with their titles."""


def make_warp(camera: CameraSettings, rings: int, sectors: int, size: int = ROUND_PX) -> np.ndarray:
    """Polar image coordinates of each pixel of the round picture: column, row [px] (size, size, 2), NaN outside.

    Columns count from one sector before the first, since ``warp_round`` adds a sector on either side.
    """
    place = project_polar(make_lens(camera), round_rays(make_lens(camera), size), rings, sectors)
    row, column = np.clip(place[..., 0], 0, rings - 1), place[..., 1] + 1
    return np.stack([column, row], axis=-1).astype(np.float32)


def warp_round(polar: np.ndarray, warp: np.ndarray) -> np.ndarray:
    """The round picture (size, size, 3) of a polar image (rings, sectors, 3), black outside the rim."""
    around = np.concatenate([polar[:, -1:], polar, polar[:, :1]], axis=1)
    outside = np.isnan(warp[..., 0])
    column, row = np.moveaxis(np.where(outside[..., None], np.float32(0), warp), -1, 0)
    picture = cv2.remap(around, column, row, cv2.INTER_LINEAR)
    picture[outside] = 0
    return picture


def encode_jpeg(image: np.ndarray) -> bytes:
    """An RGB image (rows, columns, 3) uint8 as JPEG."""
    bgr = np.ascontiguousarray(image[..., ::-1])
    return cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes()


def log_round(stream: rr.RecordingStream, path: str, images: np.ndarray, camera: CameraSettings, at: Rows) -> None:
    """Log a camera's polar images (n, rings, sectors, 3) at so many times as round pictures."""
    warp = make_warp(camera, images.shape[1], images.shape[2])
    log_jpegs(stream, path, (warp_round(image, warp) for image in images), at)


def log_polar(
    stream: rr.RecordingStream, images: np.ndarray, camera: CameraSettings, at: Rows, root: str = "drive"
) -> None:
    """Log polar images (n, rings, sectors, 3) at so many times, as they are and as round pictures."""
    log_jpegs(stream, f"{root}/polar", images, at)
    log_round(stream, f"{root}/fisheye", images, camera, at)


def log_figure(stream: rr.RecordingStream, path: str, figure: Figure) -> None:
    """Log a figure as a picture."""
    put(stream, path, rr.EncodedImage(contents=to_png(figure), media_type="image/png"))


def log_jpegs(stream: rr.RecordingStream, path: str, images: Iterable[np.ndarray], at: Rows) -> None:
    """Log RGB images (rows, columns, 3) uint8 at so many times."""
    blobs = {"blob": list(map(encode_jpeg, images))}
    send_rows(stream, path, rr.EncodedImage, at, blobs, {"media_type": "image/jpeg"})
