"""Pictures for people: round ones of polar images, JPEG, and large fisheye images that are rendered after a run."""

from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path

import cv2
import numpy as np
import rerun as rr
from matplotlib import style
from matplotlib.figure import Figure

from deepgps.evaluation.error_field import ErrorField
from deepgps.reports.plots import SCREEN, to_png
from deepgps.reports.run_figures import draw_error_cdf
from deepgps.viewer.stream import Rows, put, send_rows
from sim.errors import DamagedError
from sim.files.checksums import read_arrays, write_arrays
from sim.recording.format import open_recording, open_truth
from sim.sensors.camera.lens import make_lens, project_polar, round_rays
from sim.settings import CameraSettings

PICTURES = "pictures.npz"  # File of the large pictures in a run's folder
LARGE_ENTITY = "large"  # Name of the large pictures below ``drive``
DISTRIBUTION = "report/distribution"
PICTURE_COUNT = 36
ROUND_PX, POLAR_ZOOM = 256, 3
JPEG_QUALITY = 85


def choose_views(run: Path) -> tuple[np.ndarray, np.ndarray]:
    """Observations of a run's drive to draw for people (n,), evenly spread, and their true poses (n, 3)."""
    recording, truth = open_recording(run / "recording"), open_truth(run / "recording")
    seen = np.unique(recording.reading[:, 1])
    chosen = seen[np.unique(np.linspace(0, len(seen) - 1, PICTURE_COUNT).round().astype(int))]
    return chosen, truth.pose[chosen]


def write_pictures(run: Path, observation: np.ndarray, pictures: np.ndarray) -> None:
    """Write pictures (n, rows, columns, 3) of observations (n,)."""
    blobs = {
        f"{number:06d}": np.frombuffer(encode_jpeg(picture), np.uint8)
        for number, picture in zip(observation, pictures, strict=True)
    }
    write_arrays(run / PICTURES, blobs)


def read_pictures(run: Path) -> dict[int, bytes]:
    """Pictures as JPEG by observation; none if they were not drawn, or if the file is damaged."""
    with suppress(DamagedError, FileNotFoundError):
        return {int(name): blob.tobytes() for name, blob in read_arrays(run / PICTURES).items()}
    return {}


def make_warp(camera: CameraSettings, rings: int, sectors: int, size: int) -> np.ndarray:
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


def enlarge(image: np.ndarray, times: int) -> np.ndarray:
    """An image (rows, columns, 3) with each pixel ``times`` as high and wide."""
    return np.repeat(np.repeat(image, times, axis=0), times, axis=1)


def encode_jpeg(image: np.ndarray) -> bytes:
    """An RGB image (rows, columns, 3) uint8 as JPEG."""
    bgr = np.ascontiguousarray(image[..., ::-1])
    return cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes()


def log_views(stream: rr.RecordingStream, path: str, images: np.ndarray, camera: CameraSettings, at: Rows) -> None:
    """Log a camera's polar images (n, rings, sectors, 3) at so many times: enlarged, and as round pictures."""
    warp = make_warp(camera, images.shape[1], images.shape[2], ROUND_PX)
    log_jpegs(stream, f"{path}/polar", (encode_jpeg(enlarge(image, POLAR_ZOOM)) for image in images), at)
    log_jpegs(stream, f"{path}/round", (encode_jpeg(warp_round(image, warp)) for image in images), at)


def log_distribution(stream: rr.RecordingStream, *fields: Mapping[str, ErrorField]) -> None:
    """Log the distribution of errors of each method, and dashed that in a run that it is compared with."""
    with style.context(
        ["dark_background", {"figure.facecolor": SCREEN[0], "axes.facecolor": SCREEN[0], "grid.color": "#777777"}]
    ):
        figure = draw_error_cdf(*fields)
    log_figure(stream, DISTRIBUTION, figure)


def log_figure(stream: rr.RecordingStream, path: str, figure: Figure) -> None:
    """Log a figure as a picture."""
    put(stream, path, rr.EncodedImage(contents=to_png(figure), media_type="image/png"))


def log_jpegs(stream: rr.RecordingStream, path: str, blobs: Iterable[bytes], at: Rows) -> None:
    """Log pictures in JPEG at so many times."""
    send_rows(stream, path, rr.EncodedImage, at, {"blob": list(blobs)}, {"media_type": "image/jpeg"})
