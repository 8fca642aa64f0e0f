"""Images one by one, from a file, a folder or standard input, and their polar images.

What cannot be read says why, and the next one follows.
"""

from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import BinaryIO, NamedTuple

import cv2
import numpy as np

from deepgps.robot_io.logs.pictures import decode_file
from sim.errors import InputError, one_line, read_file, shorten
from sim.sensors.camera.unwrap import RoundImage, draw_polar

SUFFIXES = (".bmp", ".jpeg", ".jpg", ".png", ".ppm", ".tif", ".tiff", ".webp")
LOGS = (".bag", ".db3", ".mcap")
LARGEST_BYTES = 100_000_000
"""Largest encoded image that is read."""
STDIN = "-"
"""Name of standard input as a source."""


class Unwrapper:
    """Makes polar images.

    Args:
        shape: Rings, sectors and colours of a polar image.
        circle: Where the image circle is in raw images; None: it fills them, and they must be square.
    """

    def __init__(self, shape: tuple[int, ...], circle: RoundImage | None = None) -> None:
        self.shape, self.circle = shape, circle

    def __call__(self, image: np.ndarray) -> np.ndarray:
        """The polar image (rings, sectors, 3) of a polar or a raw image (height, width, 3) uint8 RGB.

        Raises:
            InputError: The circle is not known, or not in the image.
        """
        if image.shape == self.shape:
            return image
        rings, sectors, _ = self.shape
        circle = self.circle or fill(image)
        circle.check(image, rings, sectors)
        return draw_polar(image, _find_points(circle, rings, sectors), rings, sectors)


def fill(image: np.ndarray) -> RoundImage:
    """The circle that fills a square image; raises InputError if it is not square."""
    height, width = image.shape[:2]
    if height != width:
        raise InputError(
            f"it has {width} x {height} px: --centre and --radius-px must say where the image circle is, unless an "
            "image is square and the circle fills it"
        )
    return RoundImage(((width - 1) / 2, (height - 1) / 2), width / 2)


@lru_cache(maxsize=2)
def _find_points(circle: RoundImage, rings: int, sectors: int) -> tuple[np.ndarray, np.ndarray]:
    return circle.find_points(rings, sectors)


class Picture(NamedTuple):
    """One image of a source.

    Attributes:
        name: Its file, or its number from 0.
        image: The image (height, width, 3) uint8 RGB; None: it cannot be read.
        error: Why not.
        time_s: When it was taken [s]; None: unknown.
    """

    name: str
    image: np.ndarray | None
    error: str | None = None
    time_s: float | None = None


def open_pictures(source: str, stdin: BinaryIO) -> Iterator[Picture]:
    """The images of a source, each when it is asked for.

    Args:
        source: An image file, a folder of images, which are read in the order of their names, or ``-``.
        stdin: Standard input: for each image four bytes with the length of what follows, the most significant first,
            and that many bytes of JPEG or another format.

    Raises:
        InputError: There is no such file, or the folder holds no image.
    """
    if source == STDIN:
        return read_stream(stdin)
    path = Path(source)
    if path.suffix in LOGS or (path / "metadata.yaml").is_file():
        raise InputError(f"{shorten(source, 300)} is a log: it needs --config; deepgps import LOG --look proposes one")
    if not path.is_dir():
        if not path.exists():
            raise InputError(f"{shorten(source, 300)}: no such file or folder")
        return iter([read_picture(path)])
    paths = sorted(one for one in path.iterdir() if one.suffix.lower() in SUFFIXES)
    if not paths:
        raise InputError(f"{shorten(source, 300)} holds no image ({', '.join(SUFFIXES)})")
    return map(read_picture, paths)


def read_picture(path: Path) -> Picture:
    """The image in a file."""
    try:
        return decode(str(path), read_file(path, LARGEST_BYTES, path.name))
    except InputError as error:
        return Picture(str(path), None, one_line(error))


def read_stream(stream: BinaryIO) -> Iterator[Picture]:
    """The images of a stream, until it ends; raises InputError where no length can be right."""
    number = 0
    while head := stream.read(4):
        length = int.from_bytes(head, "big")
        if len(head) == 4 and not 0 < length <= LARGEST_BYTES:
            raise InputError(
                f"standard input: image {number} has a length of {length} bytes; must be 1 to {LARGEST_BYTES}, four "
                "bytes before each image, the most significant first"
            )
        data = stream.read(length) if len(head) == 4 else b""
        if len(head) < 4 or len(data) < length:
            yield Picture(str(number), None, "standard input ends in the middle of it")
            return
        yield decode(str(number), data)
        number += 1


def decode(name: str, data: bytes) -> Picture:
    """The image that some bytes encode, in any format of OpenCV."""
    try:
        image = decode_file(data)
    except (InputError, cv2.error) as error:
        return Picture(name, None, one_line(error))
    if image is None:
        return Picture(name, None, "it is no image that OpenCV can read")
    return Picture(name, cv2.cvtColor(image, cv2.COLOR_BGR2RGB))
