"""Images of logs: every encoding gives the same picture, rows may be padded, and what cannot be read is named."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from deepgps.robot_io.logs.pictures import decode_compressed, decode_image, decode_raw
from sim.errors import InputError
from tests.helpers.robot_log import ENCODERS, encode


@pytest.fixture(scope="module")
def image() -> np.ndarray:
    rng = np.random.default_rng(0)
    return cv2.GaussianBlur(rng.integers(0, 255, (48, 64, 3)).astype(np.uint8), (0, 0), 6.0)


def test_every_encoding_gives_the_picture(image: np.ndarray) -> None:
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)[..., None].repeat(3, axis=2)
    inner = np.s_[2:-2, 2:-2]  # a mosaic has no neighbours at its edge
    for encoding, pack in ENCODERS.items():
        for pad in (0, 13):
            found = decode_raw(SimpleNamespace(**encode(image, encoding, pad)))
            wanted = grey if encoding == "mono8" else image
            assert found.shape == image.shape and found.dtype == np.uint8
            assert np.abs(found[inner].astype(int) - wanted[inner]).max() <= (0 if pack(image).ndim == 3 else 24)
    fields = encode(image, "bgr8", 5)
    cut = SimpleNamespace(**{**fields, "data": fields["data"][:-5]})
    np.testing.assert_array_equal(decode_raw(cut), image, "the last row may lack its padding")


def test_what_is_no_picture_is_refused_in_one_line(image: np.ndarray) -> None:
    for change, message in (
        ({"encoding": "16UC1"}, "encoding '16UC1': must be rgb8, bgr8"),
        ({"data": np.zeros(100, np.uint8)}, "100 bytes, and 64 x 48 pixels of rgb8 with rows of 192 bytes need 9216"),
        ({"step": 10}, "64 x 48 pixels of rgb8 with rows of 10 bytes"),
        ({"height": 0}, "64 x 0 pixels"),
        ({"encoding": "nv12", "width": 5, "height": 4}, "OpenCV"),
        ({"encoding": "nv12", "width": 5, "height": 5}, "OpenCV"),
        ({"encoding": "yuyv", "width": 5, "height": 4}, "OpenCV"),
    ):
        with pytest.raises(InputError, match=message) as caught:
            decode_image(SimpleNamespace(**{**encode(image, "rgb8"), **change}))
        assert "\n" not in str(caught.value)
    sixteen = cv2.imencode(".png", image.astype(np.uint16) * 16)[1]
    for form, data, message in (
        ("png", sixteen, "a picture of 16 bits a channel: must be 8"),
        ("jpeg", encode(image, "image/jpeg")["data"][:20], "20 bytes: the picture is damaged"),
        ("h264", b"\0\0\0\1", "format 'h264', 4 bytes: neither JPEG nor PNG"),
    ):
        with pytest.raises(InputError, match=message):
            decode_image(SimpleNamespace(format=form, data=data))


def test_a_compressed_picture_is_known_by_its_bytes(image: np.ndarray) -> None:
    for kind, within in (("image/jpeg", 12), ("image/png", 0)):
        for form in ("jpeg", "rgb8; jpeg compressed bgr8", "", "nonsense"):
            found = decode_compressed(SimpleNamespace(**{**encode(image, kind), "format": form}))
            assert np.abs(found.astype(int) - image).max() <= within


def test_what_is_stored_is_a_mosaic_only_if_it_says_so(image: np.ndarray) -> None:
    def find(form: str, pixels: np.ndarray) -> np.ndarray:
        return decode_compressed(SimpleNamespace(format=form, data=cv2.imencode(".png", pixels)[1]))

    found = find("bayer_rggb8; jpeg compressed ", ENCODERS["bayer_rggb8"](image))
    assert np.abs(found[2:-2, 2:-2].astype(int) - image[2:-2, 2:-2]).max() <= 24
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    found = find("bayer_rggb8; jpeg compressed mono8", grey)
    np.testing.assert_array_equal(found, np.repeat(grey[..., None], 3, axis=2))
    np.testing.assert_array_equal(find("bayer_rggb8; png compressed bgr8", image[..., ::-1]), image)
