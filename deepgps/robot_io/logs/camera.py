"""The camera of a log: its calibration, from CameraInfo, a file or the configuration, and the polar images it gives."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

import numpy as np

from deepgps.config.plain_yaml import read_yaml
from deepgps.robot_io.logs.containers import Log
from deepgps.robot_io.logs.pictures import take_images
from deepgps.robot_io.logs.robot_config import CameraConfig
from deepgps.terminal.progress import Report
from sim.errors import InputError, quote
from sim.sensors.camera.lens import Lens
from sim.sensors.camera.unwrap import COEFFICIENTS, MODELS, RawCamera, Unwrapping, check_camera

CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
MIN_HALF_ANGLE = np.radians(30.0)
"""Smallest angle between the optical axis and the rim that is worth learning from [rad]."""
FIRST_IMAGES = 20  # Images of which most have the size of all; some cameras begin with another one


def find_camera(log: Log, config: CameraConfig, size: tuple[int, int]) -> RawCamera:
    """The calibration of a log's camera.

    Args:
        log: The log.
        config: Where the calibration is.
        size: Width and height of the images [px].

    Raises:
        InputError: There is none, it is impossible, or it is for images of another size.
    """
    if config.info is not None:
        camera, where = _read_info(log, config.info), config.info
    elif config.file is not None:
        camera, where = read_calibration(config.file), str(config.file)
    elif config.intrinsics is not None:
        given = config.intrinsics
        camera = make_camera(
            given.model, (given.width, given.height), (given.fx, given.fy), (given.cx, given.cy), given.coefficients
        )
        where = "camera.intrinsics"
    else:
        camera, where = _assume(config, size), "camera.circle_px"
    try:
        check_camera(camera)
        if camera.size != size:
            raise InputError(f"it is for {camera.size[0]} x {camera.size[1]} px, and images have {size[0]} x {size[1]}")
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    return camera


def make_camera(
    model: str,
    size: tuple[int, int],
    focal: tuple[float, float],
    centre: tuple[float, float],
    coefficients: Sequence[float],
) -> RawCamera:
    """A calibration with all of its model's coefficients; raises InputError if there are too many."""
    if model not in MODELS:
        raise InputError(f"distortion model {quote(model)}: must be {', '.join(MODELS)}")
    given = [float(value) for value in coefficients]
    if len(given) > COEFFICIENTS[model]:
        raise InputError(f"{model} has {COEFFICIENTS[model]} coefficients, not {len(given)}")
    return RawCamera(model, size, focal, centre, tuple(given + [0.0] * (COEFFICIENTS[model] - len(given))))


def prepare_unwrapping(camera: RawCamera, config: CameraConfig) -> tuple[Unwrapping, Lens]:
    """What makes polar images of the images, and the lens of these; raises InputError if the camera sees too little."""
    seen = camera.find_half_angle(config.circle_px)
    half = seen if config.field_of_view_deg is None else np.radians(config.field_of_view_deg) / 2
    if half < MIN_HALF_ANGLE:
        raise InputError(
            f"camera: the largest circle in the image reaches {np.degrees(half):.1f} deg from the optical axis, and at "
            f"least {np.degrees(MIN_HALF_ANGLE):g} are needed"
        )
    lens = Lens(float(half))
    return Unwrapping(camera, lens, config.rings, config.sectors, config.forward_deg, config.mirrored), lens


def read_info(message: Any) -> RawCamera | None:
    """The calibration of a CameraInfo, of ROS 1 or 2; None if the camera is not calibrated: K is zero."""
    k, d = (getattr(message, name, getattr(message, name.upper(), None)) for name in "kd")
    if k is None or d is None or not float(k[0]):
        return None
    if message.binning_x > 1 or message.binning_y > 1 or message.roi.x_offset or message.roi.y_offset:
        raise InputError("binning or a region of interest is set; give the calibration of the image as it is")
    size = int(message.width), int(message.height)
    return make_camera(str(message.distortion_model), size, (float(k[0]), float(k[4])), (float(k[2]), float(k[5])), d)


def _read_info(log: Log, topic: str) -> RawCamera:
    log.check_topic(topic, "camera.info", [CAMERA_INFO])
    why = f"{topic} holds no message"
    for sample, part in log.read([topic]):
        try:
            camera = read_info(part.decode(sample))
        except InputError as error:
            raise InputError(f"{topic}: {error}") from None
        if camera is not None:
            return camera
        why = f"{topic}: the camera is not calibrated (K is 0); give camera.file or camera.intrinsics"
    raise InputError(why)


def read_calibration(path: Path) -> RawCamera:
    """The calibration in a file of ROS's camera_calibration; raises InputError that names what is wrong."""
    values = read_yaml(path)
    try:
        k, d = (_take_numbers(values, name) for name in ("camera_matrix", "distortion_coefficients"))
        if len(k) != 9:
            raise InputError(f"camera_matrix.data has {len(k)} numbers, and must have 9")
        size = _take_size(values, "image_width"), _take_size(values, "image_height")
        return make_camera(str(values["distortion_model"]), size, (k[0], k[4]), (k[2], k[5]), d)
    except KeyError as error:
        raise InputError(f"{path} is no calibration as of camera_calibration: {error} is missing") from None
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _take_numbers(values: Mapping[str, Any], name: str) -> list[float]:
    """The numbers of a matrix in a calibration file; raises InputError if they are none."""
    data = values[name].get("data") if isinstance(values[name], dict) else values[name]
    numbers = [_as_number(value) for value in data] if isinstance(data, list) else [np.nan]
    if not np.isfinite(numbers).all():
        raise InputError(f"{name}.data {quote(data)}: must be a list of finite numbers")
    return numbers


def _take_size(values: Mapping[str, Any], name: str) -> int:
    """A number of pixels in a calibration file; raises InputError if it is none."""
    number = _as_number(values[name])
    if not number.is_integer():
        raise InputError(f"{name} {quote(values[name])}: must be a whole number of pixels")
    return int(number)


def _as_number(value: Any) -> float:
    """A number, which YAML reads as text if it has an exponent and no point; NaN: it is none."""
    try:
        return float(value) if isinstance(value, int | float | str) and not isinstance(value, bool) else np.nan
    except (ValueError, OverflowError):
        return np.nan


def _assume(config: CameraConfig, size: tuple[int, int]) -> RawCamera:
    """An equidistant lens in the middle of the image, by the radius of its image circle and its field of view."""
    assert config.circle_px is not None and config.field_of_view_deg is not None
    focal = config.circle_px / (np.radians(config.field_of_view_deg) / 2)
    return RawCamera("equidistant", size, (focal, focal), ((size[0] - 1) / 2, (size[1] - 1) / 2), (0.0, 0.0, 0.0, 0.0))


@dataclass
class PolarSource:
    """A log's images and what makes polar images of them."""

    log: Log  # The log
    topic: str  # Topic of the images
    camera: RawCamera  # Its calibration
    unwrap: Unwrapping  # Makes polar images
    lens: Lens  # Lens of the polar images
    # Numbers of images that cannot be used, and why, as far as they have been read
    damaged: dict[int, str] = field(default_factory=dict)
    drawn: set[int] = field(default_factory=set)  # Numbers of the images that have been read

    @property
    def size(self) -> int:
        """Size of a polar image."""
        return self.unwrap.rings * self.unwrap.sectors * 3

    def draw(self, wanted: Sequence[int], store: IO[bytes], progress: Report, label: str) -> None:
        """Write the polar images of some images of the log to a file, in the order of ``wanted``."""
        places = dict[int, list[int]]()
        for place, number in enumerate(wanted):
            places.setdefault(number, []).append(place)
        self.drawn.update(places)
        store.truncate(len(wanted) * self.size)
        for done, (number, image) in enumerate(take_images(self.log, self.topic, places, self.damaged)):
            try:
                data = self.unwrap(image).tobytes()
            except InputError as error:
                self.damaged[number] = str(error)
                continue
            for place in places[number]:
                store.seek(place * self.size)
                store.write(data)
            progress(label, done + 1, len(places))
        store.flush()

    def map(self, store: IO[bytes], count: int) -> np.ndarray:
        """The polar images in a file (n, rings, sectors, 3), memory-mapped."""
        shape = (count, self.unwrap.rings, self.unwrap.sectors, 3)
        return np.memmap(store, np.uint8, "c", shape=shape) if count else np.empty(shape, np.uint8)


def open_polar(log: Log, config: CameraConfig) -> PolarSource:
    """Find the calibration, for the size of most of the first images that can be decoded.

    Raises:
        InputError: There is no such image, or no calibration for it.
    """
    problems = dict[int, str]()
    sizes = Counter(
        (image.shape[1], image.shape[0]) for _, image in take_images(log, config.topic, range(FIRST_IMAGES), problems)
    )
    if not sizes:
        why = next(iter(problems.values()), "there is none")
        raise InputError(f"camera.topic {config.topic}: none of the first images can be used: {why}")
    camera = find_camera(log, config, sizes.most_common(1)[0][0])
    unwrap, lens = prepare_unwrapping(camera, config)
    return PolarSource(log, config.topic, camera, unwrap, lens)
