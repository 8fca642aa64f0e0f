"""Images one by one, from a file, a folder, standard input or a robot's log, with the log's odometry."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache, partial
from itertools import count
from pathlib import Path
from typing import BinaryIO, NamedTuple

import cv2
import numpy as np

from deepgps.positioner.pose import Poses
from deepgps.robot_io.logs.camera import PolarSource, open_polar
from deepgps.robot_io.logs.containers import open_log
from deepgps.robot_io.logs.drive import LoggedDrive, read_drive
from deepgps.robot_io.logs.lag import compare_wheels
from deepgps.robot_io.logs.pictures import decode_file, list_images, take_images
from deepgps.robot_io.logs.robot_config import RobotConfig, load_config
from deepgps.robot_io.logs.sample import Heard
from deepgps.robot_io.logs.segmentation import Path as Odometry
from deepgps.robot_io.logs.segmentation import find_path
from deepgps.terminal.progress import Report
from sim.errors import InputError, one_line, read_file, shorten
from sim.sensors.camera.unwrap import RoundImage, draw_polar

SUFFIXES = (".bmp", ".jpeg", ".jpg", ".png", ".ppm", ".tif", ".tiff", ".webp")
LOGS = (".bag", ".db3", ".mcap")
MAX_BYTES = 100_000_000  # Largest encoded image that is read
STDIN = "-"  # Name of standard input as a source


class Unwrapper:
    """Makes polar images of this shape from raw ones, which an image circle of unknown place must fill."""

    def __init__(self, shape: tuple[int, ...], circle: RoundImage | None = None) -> None:
        self.shape, self.circle = shape, circle
        self._find_points = lru_cache(maxsize=2)(RoundImage.find_points)

    def __call__(self, image: np.ndarray) -> np.ndarray:
        """The polar image (rings, sectors, 3) of a polar or a raw image (height, width, 3) uint8 RGB.

        Raises InputError if the circle is not known, or not in the image.
        """
        if image.shape == self.shape:
            return image
        (height, width), (rings, sectors, _) = image.shape[:2], self.shape
        if self.circle is None and height != width:
            raise InputError(
                f"it has {width} x {height} px: --centre and --radius-px must say where the image circle is, unless an "
                "image is square and the circle fills it"
            )
        circle = self.circle or RoundImage(((width - 1) / 2, (height - 1) / 2), width / 2)
        circle.check(image, rings, sectors)
        return draw_polar(image, self._find_points(circle, rings, sectors), rings, sectors)


class Picture(NamedTuple):
    """One image of a source, and what is found of it."""

    name: str  # Its file, or its number from 0
    image: np.ndarray | None  # The image (height, width, 3) uint8 RGB; None: it cannot be read
    error: str | None = None  # Why not
    time_s: float | None = None  # When it was taken [s]; None: unknown
    pose: Poses | None = None  # Its pose; None: it is not found
    cause: str | None = None  # Name of the cause for which it is refused or suspicious; empty: none. None: nobody asks


def open_pictures(source: str, stdin: BinaryIO) -> Iterator[Picture]:
    """The images of an image file, a folder, in the order of names, or ``-``, each when it is asked for.

    Standard input holds for each image four bytes with the length of what follows, the most significant first, and that
    many bytes of JPEG or another format. Raises InputError if there is no such file, or the folder holds no image.
    """
    if source == STDIN:
        return read_stream(stdin)
    path = Path(source)
    if path.suffix in LOGS or (path / "metadata.yaml").is_file():
        raise InputError(f"{shorten(source, 300)} is a log: it needs --config; deepgps import LOG --look proposes one")
    if not path.exists():
        raise InputError(f"{shorten(source, 300)}: no such file or folder")
    paths = [path]
    if path.is_dir():
        paths = sorted(one for one in path.iterdir() if one.suffix.lower() in SUFFIXES)
        if not paths:
            raise InputError(f"{shorten(source, 300)} holds no image ({', '.join(SUFFIXES)})")
    return (decode(str(one), partial(read_file, one, MAX_BYTES, one.name)) for one in paths)


def read_stream(stream: BinaryIO) -> Iterator[Picture]:
    """The images of a stream, until it ends; raises InputError where no length can be right."""
    for number in count():
        if not (head := stream.read(4)):
            return
        length = int.from_bytes(head, "big")
        if len(head) == 4 and not 0 < length <= MAX_BYTES:
            raise InputError(
                f"standard input: image {number} has a length of {length} bytes; must be 1 to {MAX_BYTES}, four "
                "bytes before each image, the most significant first"
            )
        data = stream.read(length) if len(head) == 4 else b""
        if len(head) < 4 or len(data) < length:
            yield Picture(str(number), None, "standard input ends in the middle of it")
            return
        yield decode(str(number), partial(bytes, data))


def decode(name: str, read: Callable[[], bytes]) -> Picture:
    """The image that some bytes encode, in any format of OpenCV, or why it cannot be read."""
    try:
        if (image := decode_file(read())) is None:
            return Picture(name, None, "it is no image that OpenCV can read")
        return Picture(name, cv2.cvtColor(image, cv2.COLOR_BGR2RGB))
    except (InputError, cv2.error) as error:
        return Picture(name, None, one_line(error))


def read_log(polar: PolarSource, listed: Heard) -> Iterator[Picture]:
    """The images of a log, or why one cannot be decoded."""
    for number, image in take_images(polar.log, polar.topic, range(len(listed.log_ns))):
        time_s = 1e-9 * (listed.stamp_ns[number] or listed.log_ns[number])
        seen, error = (None, str(image)) if isinstance(image, InputError) else (image, None)
        yield Picture(str(number), seen, error, time_s)


@contextmanager
def open_source(
    path: Path, config: Path, field_of_view_deg: float | None, with_odometry: bool, progress: Report
) -> Iterator[tuple[PolarSource, Iterator[Picture], Odometry | None]]:
    """Open a log for reading, with the ``robot.yaml`` with which it would be imported: what makes polar images, its
    images, and if asked, distance and heading by the wheels at each, NaN where they are not known.

    The full angle is that of the polar images, where the configuration does not set it; None: unknown. Raises
    InputError if the log or its configuration cannot be used.
    """
    robot = load_config(config)
    view = {"field_of_view_deg": robot.camera.field_of_view_deg or field_of_view_deg}
    robot = robot.model_copy(update={"camera": robot.camera.model_copy(update=view), "pose": None})
    with open_log(path) as log:
        if with_odometry:
            drive, polar = read_drive(log, robot, progress), open_polar(log, robot.camera)
            yield polar, read_log(polar, drive.listed), _follow(robot, drive, polar, progress)
            return
        listed = list_images(log, robot.camera.topic)
        log.feed([listed], progress)
        listed.check()
        polar = open_polar(log, robot.camera)
        yield polar, read_log(polar, listed), None


def _follow(robot: RobotConfig, drive: LoggedDrive, polar: PolarSource, progress: Report) -> Odometry:
    """Distance and heading at each image, by the wheels when they were read later by their lag."""
    lag_s, wheels = robot.wheels.lag_s, drive.driven.wheels
    if lag_s == "estimate":
        lag_s, _ = compare_wheels(polar, drive, lag_s, progress)
    time_s = drive.image_s + float(lag_s)
    angle = wheels.at(time_s)
    angle[1:][np.diff(wheels.count_breaks(time_s)) != 0] = np.nan  # the motion since the image before is unknown
    return find_path(angle, robot.wheels.radius_m, robot.wheels.track_m)
