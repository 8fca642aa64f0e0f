"""The raw pictures of a log, drawn and compressed by worker processes, a file for each few hundred."""

import zlib
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import cv2
import mujoco
import numpy as np

from sim.files.checksums import read_arrays, write_arrays
from sim.recording.renderers import Part, UnsteadyError
from sim.robot.world import RoomWorld
from sim.sensors.camera.fisheye import Fisheye
from sim.settings import DeploymentSettings, SimSettings

ROWS, COLUMNS = 480, 640
"""Size of the image (TurtleBot3: 640 x 480); the round picture is as high and in its middle [px]."""
FACE_PX = 160
"""Side of the faces that it is drawn from: half of what would resolve each of its pixels, for speed."""
QUALITY = 85
PER_PART = 256
JPEG, END = "jpeg", "end"
Sense = Callable[[np.ndarray, np.ndarray | None], np.ndarray]
"""(state (nq,), lean of the camera (2,) [rad] or None) -> image (ROWS, COLUMNS, 3) RGB."""


def draw_part(part: Part, beat: Callable[[], None]) -> None:
    """Run in a worker: draw the pictures of a part's states and write their JPEG files, one after the other.

    Raises:
        UnsteadyError: A picture that was drawn twice came out different; nothing is written.
    """
    sense = open_camera(part.settings)  # pyright: ignore[reportArgumentType] (frozen settings do hash)
    files = []
    for number in range(len(part.states)):
        files.append(_take(sense, part, number))
        beat()
    again = zlib.crc32(part.path.name.encode()) % max(len(files) - 1, 1)
    if not np.array_equal(_take(sense, part, again), files[again]):
        raise UnsteadyError(f"{part.path}: picture {again} of {len(files)} was drawn twice and came out different")
    write_arrays(part.path, {JPEG: np.concatenate(files), END: np.cumsum([len(file) for file in files])})


@lru_cache(maxsize=1)
def open_camera(settings: SimSettings) -> Sense:
    """The camera, opened once per worker process, since a context belongs to its process."""
    model = RoomWorld(settings.model_copy(update={"deployment": DeploymentSettings()})).model
    camera = Fisheye(model, settings.camera.model_copy(update={"face_px": FACE_PX}), settings.camera_mount)
    data = mujoco.MjData(model)

    def sense(state: np.ndarray, lean: np.ndarray | None) -> np.ndarray:
        data.qpos[:] = state
        mujoco.mj_kinematics(model, data)
        return _frame(camera.round(data, ROWS, lean))

    return sense


def read_pictures(path: Path) -> list[np.ndarray]:
    """The JPEG files of a part, each (n,) uint8; raises DamagedError."""
    stored = read_arrays(path)
    return np.split(stored[JPEG], stored[END][:-1])


def _frame(round_picture: np.ndarray) -> np.ndarray:
    side = (COLUMNS - ROWS) // 2
    return np.pad(round_picture, ((0, 0), (side, side), (0, 0)))


def _take(sense: Sense, part: Part, number: int) -> np.ndarray:
    image = sense(part.states[number], None if part.leans is None else part.leans[number])
    done, file = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    assert done
    return file
