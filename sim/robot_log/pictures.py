"""The raw pictures of a log, drawn and compressed by worker processes, a file for each few hundred."""

import zlib
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

from sim.files import read_arrays, write_arrays
from sim.recording.renderers import Part, UnsteadyError
from sim.robot.world import RoomWorld
from sim.sensors.catalog import Opened
from sim.sensors.fisheye import open_round
from sim.settings import DeploymentSettings, SimSettings

ROWS, COLUMNS = 480, 640
"""Size of the image (TurtleBot3: 640 x 480); the round picture is as high and in its middle [px]."""
FACE_PX = 160
"""Side of the faces that it is drawn from: half of what would resolve each of its pixels, for speed."""
QUALITY = 85
PER_PART = 256
JPEG, END = "jpeg", "end"


def draw_part(part: Part, beat: Callable[[], None]) -> None:
    """Run in a worker: draw the pictures of a part's states and write their JPEG files, one after the other.

    Raises:
        UnsteadyError: A picture that was drawn twice came out different; nothing is written.
    """
    camera = open_camera(part.settings)  # pyright: ignore[reportArgumentType] (frozen settings do hash)
    files = []
    for number in range(len(part.states)):
        files.append(_take(camera, part, number))
        beat()
    again = zlib.crc32(part.path.name.encode()) % max(len(files) - 1, 1)
    if not np.array_equal(_take(camera, part, again), files[again]):
        raise UnsteadyError(f"{part.path}: picture {again} of {len(files)} was drawn twice and came out different")
    write_arrays(part.path, {JPEG: np.concatenate(files), END: np.cumsum([len(file) for file in files])})


@lru_cache(maxsize=1)
def open_camera(settings: SimSettings) -> Opened:
    """The camera, opened once per worker process, since a context belongs to its process."""
    world = RoomWorld(settings.model_copy(update={"deployment": DeploymentSettings()}))
    return open_round(settings, world.model, ROWS, FACE_PX)


@lru_cache(maxsize=1)
def read_pictures(path: Path) -> list[np.ndarray]:
    """The JPEG files of a part, each (n,) uint8; raises DamagedError."""
    stored = read_arrays(path)
    return np.split(stored[JPEG], stored[END][:-1])


def frame(round_picture: np.ndarray) -> np.ndarray:
    """The camera's image (ROWS, COLUMNS, 3), black beside the round picture (ROWS, ROWS, 3)."""
    side = (COLUMNS - ROWS) // 2
    return np.pad(round_picture, ((0, 0), (side, side), (0, 0)))


def _take(camera: Opened, part: Part, number: int) -> np.ndarray:
    lean = None if part.leans is None else part.leans[number]
    image = frame(camera.sense(part.states[number], lean))
    done, file = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    assert done
    return file
