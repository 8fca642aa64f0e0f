"""The images of a log: their times, and those that are wanted, decoded one at a time, in every usual encoding."""

from collections.abc import Collection, Iterator
from typing import Any

import cv2
import numpy as np

from deepgps.robot_io.logs.containers import Log
from deepgps.robot_io.logs.sample import Heard
from sim.errors import InputError, one_line, quote

RAW_IMAGE, COMPRESSED_IMAGE = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
MAGIC = (b"\xff\xd8\xff", b"\x89PNG\r\n\x1a\n")
"""How JPEG and PNG begin; what a message says of its format differs between drivers."""
KINDS = (RAW_IMAGE, COMPRESSED_IMAGE)

# what OpenCV says of a damaged picture is in our own message
cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_ERROR)  # pyright: ignore[reportAttributeAccessIssue]


ENCODINGS = {
    "rgb8": (3, None),
    "bgr8": (3, cv2.COLOR_BGR2RGB),
    "rgba8": (4, cv2.COLOR_RGBA2RGB),
    "bgra8": (4, cv2.COLOR_BGRA2RGB),
    "mono8": (1, cv2.COLOR_GRAY2RGB),
    "yuv422": (2, cv2.COLOR_YUV2RGB_UYVY),
    "yuv422_yuy2": (2, cv2.COLOR_YUV2RGB_YUY2),
    "nv21": (1, cv2.COLOR_YUV2RGB_NV21),
    "nv12": (1, cv2.COLOR_YUV2RGB_NV12),
    "bayer_rggb8": (1, cv2.COLOR_BayerRGGB2RGB),
    "bayer_bggr8": (1, cv2.COLOR_BayerBGGR2RGB),
    "bayer_gbrg8": (1, cv2.COLOR_BayerGBRG2RGB),
    "bayer_grbg8": (1, cv2.COLOR_BayerGRBG2RGB),
}
"""Bytes of a pixel, and OpenCV's conversion to RGB, by the encoding's name."""
ALIASES = {"8uc1": "mono8", "8uc3": "bgr8", "8uc4": "bgra8", "uyvy": "yuv422", "yuyv": "yuv422_yuy2"}


def decode_image(message: Any) -> np.ndarray:
    """The image (height, width, 3) uint8 RGB of an ``Image`` or a ``CompressedImage``; raises InputError."""
    try:
        return decode_raw(message) if hasattr(message, "encoding") else decode_compressed(message)
    except cv2.error as error:  # a size that the encoding cannot have, or that no memory could hold
        raise InputError(one_line(error)) from None


def decode_raw(message: Any) -> np.ndarray:
    """The image (height, width, 3) uint8 RGB of an ``Image``, whose rows may be padded.

    Raises InputError if its encoding is unknown, or there are fewer bytes than its size needs.
    """
    name = str(message.encoding).strip().lower()
    if (name := ALIASES.get(name, name)) not in ENCODINGS:
        raise InputError(f"encoding {quote(message.encoding)}: must be {', '.join((*ENCODINGS, *ALIASES))}")
    channels, code = ENCODINGS[name]
    height, width, data = int(message.height), int(message.width), bytes(message.data)
    rows = height + height // 2 * name.startswith("nv")  # the colours are below
    step = int(message.step) or width * channels
    # the last row may end with its last pixel
    if not (height and width) or step < width * channels or len(data) < (rows - 1) * step + width * channels:
        raise InputError(
            f"{len(data)} bytes, and {width} x {height} pixels of {name} with rows of {step} bytes need {rows * step}"
        )
    pixels = np.ndarray((rows, width, channels), np.uint8, data, strides=(step, channels, 1))
    pixels = np.ascontiguousarray(pixels[..., 0] if channels == 1 else pixels)
    return pixels if code is None else cv2.cvtColor(pixels, code)


def decode_file(data: bytes, how: int = cv2.IMREAD_COLOR) -> np.ndarray | None:
    """Pixels (height, width[, 3]) uint8, BGR or grey, of the bytes of an image file; None: OpenCV cannot read it.

    Raises InputError if it has more than 8 bits a channel, of which it is not known which ones matter.
    """
    depth = cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
    pixels = cv2.imdecode(np.frombuffer(data, np.uint8), how | depth) if data else None
    if pixels is not None and pixels.dtype != np.uint8:
        raise InputError(f"a picture of {8 * pixels.dtype.itemsize} bits a channel: must be 8")
    return pixels


def decode_compressed(message: Any) -> np.ndarray:
    """The image (height, width, 3) uint8 RGB of a ``CompressedImage``; raises InputError if, by its first bytes, it is
    neither a JPEG nor a PNG of 8 bits, or it is damaged."""
    data = bytes(message.data)
    if not data.startswith(MAGIC):
        raise InputError(f"format {quote(message.format)}, {len(data)} bytes: neither JPEG nor PNG")
    source, _, rest = str(message.format).lower().partition(";")
    stored = rest.partition("compressed")[2].strip() or source.strip()  # ROS 2 usually stores a mosaic as mono8
    mosaic = stored.startswith("bayer") and stored in ENCODINGS
    pixels = decode_file(data, cv2.IMREAD_GRAYSCALE if mosaic else cv2.IMREAD_COLOR)
    if pixels is None:
        raise InputError(f"format {quote(message.format)}, {len(data)} bytes: the picture is damaged")
    return cv2.cvtColor(pixels, ENCODINGS[stored][1] if mosaic else cv2.COLOR_BGR2RGB)


def list_images(log: Log, topic: str) -> Heard:
    """What notes the times of a topic's images; raises InputError if there is no such topic."""
    log.check_topic(topic, "camera.topic", KINDS)
    return Heard(topic)


def take_images(log: Log, topic: str, wanted: Collection[int]) -> Iterator[tuple[int, np.ndarray | InputError]]:
    """Numbers and pixels (height, width, 3) uint8 RGB of some images of a topic, or why one cannot be decoded."""
    last = max(wanted, default=-1)
    for number, sample in enumerate(log.read([topic])):
        if number > last:
            return
        if number in wanted:
            try:
                yield number, decode_image(sample.decode())
            except InputError as error:
                yield number, error
