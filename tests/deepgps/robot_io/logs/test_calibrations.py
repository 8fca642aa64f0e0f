"""Calibrations of ROS, Kalibr and OpenCV are read, with more zeros than their model needs; of others, a line says what
they are and which numbers go where."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from deepgps.robot_io.logs.camera import read_calibration
from deepgps.robot_io.logs.robot_config import Intrinsics
from sim.errors import InputError
from sim.sensors.camera.unwrap import COEFFICIENTS, RawCamera

FOUR = (0.0035, 0.0007, -0.002, 0.0002)
CAMERA = RawCamera("equidistant", (512, 480), (190.5, 191.0), (254.9, 238.9), FOUR)
MATRIX = [190.5, 0.0, 254.9, 0.0, 191.0, 238.9, 0.0, 0.0, 1.0]
ROS = {"image_width": 512, "image_height": 480, "distortion_model": "equidistant", "camera_matrix": {"data": MATRIX}}
ROS |= {"distortion_coefficients": {"rows": 1, "cols": 5, "data": [0.0035, "7e-04", *FOUR[2:], 0]}}
KALIBR = {"camera_model": "pinhole", "distortion_coeffs": [*FOUR], "distortion_model": "equidistant"}
KALIBR |= {"intrinsics": [190.5, 191.0, 254.9, 238.9], "resolution": [512, 480]}
OMNI = {**KALIBR, "camera_model": "omni", "distortion_model": "radtan", "intrinsics": [1.7, *KALIBR["intrinsics"]]}
OPENCV = f"""%YAML:1.0
---
image_Width: 512
image_Height: 480
Camera_Matrix: !!opencv-matrix
   data: {MATRIX}
Distortion_Coefficients: !!opencv-matrix
   data: {[*FOUR]}
fisheye_model: 1
"""


def write_storage(name: str) -> str:
    """The camera as OpenCV's FileStorage writes it, in the format that a file's name tells."""
    store = cv2.FileStorage(name, cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    store.write("calibration_time", "Sun Nov 29")
    for key, value in (("image_width", 512), ("image_height", 480), ("fisheye_model", 1)):
        store.write(key, value)
    store.write("camera_matrix", np.array(MATRIX).reshape(3, 3))
    store.write("distortion_coefficients", np.array([FOUR]).T)
    return store.releaseAndGetString()


def read(folder: Path, values: dict | str) -> RawCamera:
    path = folder / "camera.yaml"
    path.write_text(values if isinstance(values, str) else yaml.safe_dump(values))
    return read_calibration(path)


def test_one_camera_is_read_from_every_format(tmp_path: Path) -> None:
    for values in (ROS, {"cam0": KALIBR}, OPENCV, *map(write_storage, ("a.xml", "a.yaml"))):
        assert read(tmp_path, values) == CAMERA
    omni = read(tmp_path, {"cam0": OMNI})
    assert (omni.model, omni.focal, omni.centre, omni.coefficients) == (
        "omni",
        CAMERA.focal,
        CAMERA.centre,
        (1.7, *FOUR),
    )
    radtan = read(tmp_path, {"cam3": {**KALIBR, "distortion_model": "radtan"}})
    assert (radtan.model, radtan.coefficients) == ("plumb_bob", (*FOUR, 0.0))


@pytest.mark.parametrize("model", sorted(COEFFICIENTS))
def test_more_coefficients_than_the_model_has_must_be_zero(model: str) -> None:
    values = {"model": model, "width": 512, "height": 480, "fx": 190.5, "fy": 191.0, "cx": 254.9, "cy": 238.9}
    count = COEFFICIENTS[model]
    numbers = np.arange(1.0, 1 + count)
    for more in range(14 - count):
        given = Intrinsics.model_validate({**values, "coefficients": [*numbers, *np.zeros(more)]})
        assert given.camera.coefficients == tuple(numbers)
    given = Intrinsics.model_validate({**values, "coefficients": [*numbers, 0.0, 0.1]})
    with pytest.raises(InputError, match=f"{model} has {count} coefficients, not {count + 2}"):
        _ = given.camera


def test_other_files_are_named_and_what_is_wrong_is_said_in_one_line(tmp_path: Path) -> None:
    for values, message in (
        (
            "%YAML:1.0\n---\nmodel_type: KANNALA_BRANDT\nmu: 190.9\n",
            "give camera.intrinsics, where mu, mv, u0",
        ),
        ("%YAML:1.0\n---\nmodel_type: MEI\n", "where gamma1, gamma2, .* the coefficients of model omni"),
        (
            "#polynomial (ocam_model.ss in MATLAB).\n\n5 -2.3e+02 0\n",
            "OCamCalib, whose polynomial is not read",
        ),
        ("%YAML:1.0\n---\nmodel_type: scaramuzza\n", "as of VINS: its model 'scaramuzza' is not read"),
        ("<?xml version='1.0'?>\n<a><b></a>", "camera.yaml: "),
        (
            '<?xml version="1.0"?>\n<opencv_storage><a>1</a></opencv_storage>',
            "Kalibr or OpenCV: 'cameramatrix' is missing",
        ),
        ("just text", "it is no calibration of camera_calibration, Kalibr or OpenCV"),
        ("a: [1", "it is no calibration of camera_calibration, Kalibr or OpenCV: "),
        ({"cam0": KALIBR, "cam1": KALIBR}, "it holds 2 cameras: leave the one that looks up"),
        ({"cam0": {**KALIBR, "camera_model": "eucm"}}, r"camera model \('eucm', 'equidistant'\) of Kalibr: must be"),
        ({"cam0": {**KALIBR, "intrinsics": [1.0]}}, "intrinsics of Kalibr's pinhole must be 4 numbers"),
        ({**ROS, "distortion_model": "eucm"}, "model 'eucm': must be 'equidistant'"),
        ({**ROS, "image_height": 80.5}, r"height 80\.5: must be"),
        ({**ROS, "camera_matrix": {"data": MATRIX[:8]}}, "the camera matrix must be a list of 9 numbers"),
        ({**ROS, "camera_matrix": {"data": [True] * 9}}, "fx True: must be"),
        ({**ROS, "distortion_coefficients": {"data": {"a": 1}}}, "the distortion coefficients a list"),
        (
            {name: one for name, one in ROS.items() if name != "distortion_model"},
            "it names no model: add",
        ),
        ({name: one for name, one in ROS.items() if name != "image_width"}, "'imagewidth' is missing"),
    ):
        with pytest.raises(InputError, match=message) as caught:
            read(tmp_path, values)
        assert "\n" not in str(caught.value) and str(caught.value).startswith(f"{tmp_path / 'camera.yaml'}: ")
