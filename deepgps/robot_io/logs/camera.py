"""The camera of a log: its calibration, from CameraInfo, a file or the configuration, and the polar images it gives."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

import cv2
import numpy as np
import yaml
from pydantic import ValidationError

from deepgps.config.plain_yaml import MAX_FILE_BYTES
from deepgps.config.setting_problems import describe_problems
from deepgps.robot_io.logs.containers import Log
from deepgps.robot_io.logs.pictures import take_images
from deepgps.robot_io.logs.robot_config import CameraConfig, Intrinsics
from deepgps.terminal.progress import Report
from sim.errors import InputError, one_line, quote, read_file
from sim.sensors.camera.lens import Lens
from sim.sensors.camera.unwrap import RawCamera, Unwrapping, check_camera

CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
MIN_HALF_ANGLE = np.radians(30.0)
"""Smallest angle between the optical axis and the rim that is worth learning from [rad]."""
FIRST_IMAGES = 20  # Images of which most have the size of all; some cameras begin with another one
KALIBR_MODELS = {
    ("pinhole", "equidistant"): "equidistant",
    ("pinhole", "radtan"): "plumb_bob",
    ("pinhole", "none"): "plumb_bob",
    ("omni", "radtan"): "omni",
    ("omni", "none"): "omni",
}
CAMODOCAL_MODELS = {
    "KANNALA_BRANDT": "mu, mv, u0, v0 are fx, fy, cx, cy, and k2 to k5 the coefficients of model equidistant",
    "MEI": "gamma1, gamma2, u0, v0 are fx, fy, cx, cy, and xi, k1, k2, p1, p2 the coefficients of model omni",
    "PINHOLE": "fx, fy, cx, cy are the same, and k1, k2, p1, p2 the coefficients of model plumb_bob",
}
NO_CALIBRATION = "it is no calibration of camera_calibration, Kalibr or OpenCV"
OCAM = (
    "a calibration of OCamCalib, whose polynomial is not read: calibrate with Kalibr or OpenCV's fisheye; its center "
    "is cy, cx, and its first coefficient without sign about fx and fy"
)


def find_camera(log: Log, config: CameraConfig, size: tuple[int, int]) -> RawCamera:
    """The calibration of a log's camera, for images of this width and height [px]; raises InputError if it is none."""
    if config.info is not None:
        camera, where = _read_info(log, config.info), config.info
    elif config.file is not None:
        camera, where = read_calibration(config.file), str(config.file)
    elif config.intrinsics is not None:
        camera, where = config.intrinsics.camera, "camera.intrinsics"
    else:  # an equidistant lens in the middle of the image
        assert config.circle_px is not None and config.field_of_view_deg is not None
        focal = config.circle_px / (np.radians(config.field_of_view_deg) / 2)
        middle = (size[0] - 1) / 2, (size[1] - 1) / 2
        camera, where = RawCamera("equidistant", size, (focal, focal), middle, (0.0,) * 4), "camera.circle_px"
    try:
        check_camera(camera)
        if camera.size != size:
            raise InputError(f"it is for {camera.size[0]} x {camera.size[1]} px, and images have {size[0]} x {size[1]}")
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    return camera


def _make(model: Any, *size_focal_centre: Any, coefficients: Any) -> RawCamera:
    """A calibration of values that a file or a message gives."""
    values = dict(zip(("width", "height", "fx", "fy", "cx", "cy"), size_focal_centre, strict=True))
    try:
        return Intrinsics.model_validate({"model": model, **values, "coefficients": coefficients}).camera
    except ValidationError as error:
        raise InputError(describe_problems(error, Intrinsics)) from None


def read_info(message: Any) -> RawCamera | None:
    """The calibration of a CameraInfo, of ROS 1 or 2; None if the camera is not calibrated: K is zero."""
    k, d = (getattr(message, name, getattr(message, name.upper(), None)) for name in "kd")
    if k is None or d is None or not float(k[0]):
        return None
    if message.binning_x > 1 or message.binning_y > 1 or message.roi.x_offset or message.roi.y_offset:
        raise InputError("binning or a region of interest is set; give the calibration of the image as it is")
    model, *numbers = message.distortion_model, message.width, message.height, *np.asarray(k)[[0, 4, 2, 5]].tolist()
    return _make(model, *numbers, coefficients=np.asarray(d).tolist())


def _read_info(log: Log, topic: str) -> RawCamera:
    log.check_topic(topic, "camera.info", [CAMERA_INFO])
    try:
        cameras = (read_info(sample.decode()) for sample in log.read([topic]))
        camera = next((one for one in cameras if one is not None), None)
    except InputError as error:
        raise InputError(f"{topic}: {error}") from None
    if camera is None:
        raise InputError(
            f"{topic}: the camera is not calibrated (K is 0 in every message); give camera.file or intrinsics"
        )
    return camera


def read_calibration(path: Path) -> RawCamera:
    """The calibration in a file of ROS's camera_calibration, Kalibr or OpenCV's FileStorage; raises InputError that
    says what else it is, or what is wrong in it."""
    text = read_file(path, MAX_FILE_BYTES, f"{path}: a calibration").decode(errors="replace")
    try:
        if "ocam_model" in text:
            raise InputError(OCAM)
        plain = re.sub(r"\A%YAML:1\.0|!!opencv-matrix", "", text)
        values = _read_xml(text) if text.lstrip().startswith("<?xml") else yaml.safe_load(plain)
        if not isinstance(values, dict):
            raise InputError(NO_CALIBRATION)
        if kind := values.get("model_type"):
            where = CAMODOCAL_MODELS.get(kind)
            way = f"give camera.intrinsics, where {where}" if where else f"its model {quote(kind)} is not read"
            raise InputError(f"a calibration of camodocal, as of VINS: {way}")
        cameras = [one for name, one in values.items() if re.fullmatch(r"cam\d+", str(name))]
        return _take_kalibr(cameras) if cameras else _take_matrices(values)
    except (yaml.YAMLError, cv2.error) as error:
        raise InputError(f"{path}: {NO_CALIBRATION}: {one_line(error)}") from None
    except KeyError as error:
        raise InputError(f"{path}: {NO_CALIBRATION}: {error} is missing") from None
    except (InputError, TypeError) as error:
        raise InputError(f"{path}: {error}") from None


def _read_xml(text: str) -> dict[str, Any]:
    """Matrices, as lists, texts and numbers of OpenCV's FileStorage."""
    storage, found = cv2.FileStorage(), dict[str, Any]()
    storage.open(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
    root = storage.root()
    for name in root.keys():  # noqa: SIM118  it is no dict
        node = root.getNode(name)
        if node.isMap() and not node.getNode("dt").empty():
            found[name] = node.mat().ravel().tolist()
        elif node.isString() or node.isInt() or node.isReal():
            found[name] = node.string() if node.isString() else node.real()
    return found


def _take_kalibr(cameras: Sequence[Mapping[str, Any]]) -> RawCamera:
    """The camera of a camchain that holds one."""
    if len(cameras) > 1:
        raise InputError(f"it holds {len(cameras)} cameras: leave the one that looks up")
    one = cameras[0]
    kind = one["camera_model"], one["distortion_model"]
    if kind not in KALIBR_MODELS:
        raise InputError(f"camera model {quote(kind)} of Kalibr: must be {quote(list(KALIBR_MODELS), 300)}")
    count = 5 if kind[0] == "omni" else 4
    if len(one["intrinsics"]) != count:
        raise InputError(f"intrinsics of Kalibr's {kind[0]} must be {count} numbers")
    *xi, fx, fy, cx, cy = one["intrinsics"]
    coefficients = [*xi, *(one["distortion_coeffs"] or ())]
    return _make(KALIBR_MODELS[kind], *one["resolution"][:2], fx, fy, cx, cy, coefficients=coefficients)


def _take_matrices(values: Mapping[str, Any]) -> RawCamera:
    """The camera of a file of ROS or OpenCV, whose programs spell names differently."""
    names = {re.sub("[_ ]", "", str(name)).lower(): value for name, value in values.items()}

    def take(*known: str) -> Any:
        found = names[next((name for name in known if name in names), known[0])]
        return found["data"] if isinstance(found, dict) else found

    k, d = take("cameramatrix", "k"), take("distortioncoefficients", "distcoeffs", "d")
    if not (isinstance(k, list) and isinstance(d, list) and len(k) == 9):
        raise InputError("the camera matrix must be a list of 9 numbers, and the distortion coefficients a list")
    model = names.get("distortionmodel")
    if model is None and "fisheyemodel" in names:
        model = "equidistant" if names["fisheyemodel"] else "plumb_bob" if len(d) <= 5 else "rational_polynomial"
    if model is None:
        raise InputError("it names no model: add distortion_model: equidistant, or another one")
    return _make(model, take("imagewidth"), take("imageheight"), k[0], k[4], k[2], k[5], coefficients=d)


@dataclass
class PolarSource:
    """A log's images and what makes polar images of them."""

    log: Log  # The log
    topic: str  # Topic of the images
    unwrap: Unwrapping  # Makes polar images by the calibration
    lens: Lens  # Lens of the polar images
    scratch: Path | None = None  # Folder for images that are drawn; None: the system's for temporary files
    # Numbers of images that cannot be used, and why, as far as they have been read
    damaged: dict[int, str] = field(default_factory=dict)
    drawn: set[int] = field(default_factory=set)  # Numbers of the images that have been read

    @property
    def shape(self) -> tuple[int, int, int]:
        """Shape of a polar image."""
        return self.unwrap.rings, self.unwrap.sectors, 3

    def draw(self, wanted: np.ndarray, progress: Report, label: str) -> np.ndarray:
        """Polar images (n, rings, sectors, 3) of images of the log by their numbers (n,), mapped from a file."""
        numbers = set(np.asarray(wanted).tolist())
        self.drawn |= numbers
        if not numbers:
            return np.empty((0, *self.shape), np.uint8)
        with TemporaryFile(dir=self.scratch) as store:
            images = np.memmap(store, np.uint8, "w+", shape=(len(wanted), *self.shape))
        for done, (number, image) in enumerate(take_images(self.log, self.topic, numbers), start=1):
            try:
                if isinstance(image, InputError):
                    raise image
                images[wanted == number] = self.unwrap(image)
            except InputError as error:
                self.damaged[number] = str(error)
            progress(label, done, len(numbers))
        return images


def open_polar(log: Log, config: CameraConfig, scratch: Path | None = None) -> PolarSource:
    """Find the calibration, for the size of most of the first images that can be decoded; raises InputError if there is
    none, or the camera sees too little."""
    first = [image for _, image in take_images(log, config.topic, range(FIRST_IMAGES))]
    sizes = Counter((image.shape[1], image.shape[0]) for image in first if not isinstance(image, InputError))
    if not sizes:
        raise InputError(f"camera.topic {config.topic}: none of the first images can be used: {first[0]}")
    camera = find_camera(log, config, sizes.most_common(1)[0][0])
    seen = camera.find_half_angle(config.circle_px)
    half = seen if config.field_of_view_deg is None else np.radians(config.field_of_view_deg) / 2
    if half < MIN_HALF_ANGLE:
        raise InputError(
            f"camera: the largest circle in the image reaches {np.degrees(half):.1f} deg from the optical axis, and at "
            f"least {np.degrees(MIN_HALF_ANGLE):g} are needed"
        )
    lens = Lens(float(half))
    unwrap = Unwrapping(camera, lens, config.rings, config.sectors, config.forward_deg, config.mirrored)
    return PolarSource(log, config.topic, unwrap, lens, scratch)
