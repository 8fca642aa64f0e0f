"""Images of logs: every encoding gives the same picture, rows may be padded, and what cannot be read is named."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from deepgps.robot_io.logs.pictures import COMPRESSED, RAW, decode_compressed, decode_raw, decoder
from sim.errors import InputError
from tests.helpers.robot_log import ENCODERS, encode


@pytest.fixture(scope="module")
def image() -> np.ndarray:
    rng = np.random.default_rng(0)
    return cv2.GaussianBlur(rng.integers(0, 255, (48, 64, 3)).astype(np.uint8), (0, 0), 6.0)


def as_message(fields: dict) -> SimpleNamespace:
    return SimpleNamespace(**fields)


@pytest.mark.parametrize("pad", [0, 13])
@pytest.mark.parametrize("encoding", ENCODERS)
def test_every_encoding_gives_the_picture(encoding: str, pad: int, image: np.ndarray) -> None:
    fields = encode(image, encoding, pad)
    found = decode_raw(as_message(fields))
    wanted = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)[..., None].repeat(3, axis=2) if encoding == "mono8" else image
    assert found.shape == image.shape and found.dtype == np.uint8
    inner = np.s_[2:-2, 2:-2]  # a mosaic has no neighbours at its edge
    assert np.abs(found[inner].astype(int) - wanted[inner]).max() <= (0 if ENCODERS[encoding](image).ndim == 3 else 24)


def test_the_last_row_may_lack_its_padding(image: np.ndarray) -> None:
    fields = encode(image, "bgr8", 5)
    np.testing.assert_array_equal(decode_raw(as_message({**fields, "data": fields["data"][:-5]})), image)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"encoding": "16UC1"}, "encoding '16UC1': must be rgb8, bgr8"),
        ({"data": np.zeros(100, np.uint8)}, "100 bytes, and 64 x 48 pixels of rgb8 with rows of 192 bytes need 9216"),
        ({"step": 10}, "64 x 48 pixels of rgb8 with rows of 10 bytes"),
        ({"height": 0}, "64 x 0 pixels"),
    ],
)
def test_what_is_no_picture_is_refused(change: dict, message: str, image: np.ndarray) -> None:
    with pytest.raises(InputError, match=message):
        decode_raw(as_message({**encode(image, "rgb8"), **change}))


@pytest.mark.parametrize(
    "form", ["jpeg", "jpg", "rgb8; jpeg compressed bgr8", "bgr8; jpeg compressed bgr8", "", "nonsense"]
)
@pytest.mark.parametrize("kind", ["image/jpeg", "image/png"])
def test_a_compressed_picture_is_known_by_its_bytes(kind: str, form: str, image: np.ndarray) -> None:
    found = decode_compressed(as_message({**encode(image, kind), "format": form}))
    assert np.abs(found.astype(int) - image).max() <= (12 if kind == "image/jpeg" else 0)


def test_pictures_of_more_than_8_bits_are_refused(image: np.ndarray) -> None:
    data = cv2.imencode(".png", image.astype(np.uint16) * 16)[1]
    with pytest.raises(InputError, match="a picture of 16 bits a channel: must be 8"):
        decoder(COMPRESSED)(SimpleNamespace(format="png", data=data))


def test_a_compressed_mosaic_is_no_grey_picture(image: np.ndarray) -> None:
    _, data = cv2.imencode(".png", ENCODERS["bayer_rggb8"](image))
    found = decode_compressed(SimpleNamespace(format="bayer_rggb8; jpeg compressed ", data=data))
    assert np.abs(found[2:-2, 2:-2].astype(int) - image[2:-2, 2:-2]).max() <= 24


def test_what_is_stored_is_a_mosaic_only_if_it_says_so(image: np.ndarray) -> None:
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    _, data = cv2.imencode(".png", grey)
    found = decode_compressed(SimpleNamespace(format="bayer_rggb8; jpeg compressed mono8", data=data))
    np.testing.assert_array_equal(found, np.repeat(grey[..., None], 3, axis=2))
    _, data = cv2.imencode(".png", image[..., ::-1])
    found = decode_compressed(SimpleNamespace(format="bayer_rggb8; png compressed bgr8", data=data))
    np.testing.assert_array_equal(found, image)


def test_damaged_pictures_are_refused(image: np.ndarray) -> None:
    data = encode(image, "image/jpeg")["data"]
    with pytest.raises(InputError, match="20 bytes: the picture is damaged"):
        decode_compressed(SimpleNamespace(format="jpeg", data=data[:20]))
    with pytest.raises(InputError, match="format 'h264', 4 bytes: neither JPEG nor PNG"):
        decode_compressed(SimpleNamespace(format="h264", data=b"\0\0\0\1"))


@pytest.mark.parametrize(("encoding", "width", "height"), [("nv12", 5, 4), ("nv12", 5, 5), ("yuyv", 5, 4)])
def test_a_size_that_an_encoding_cannot_have_is_refused_in_one_line(encoding: str, width: int, height: int):
    message = SimpleNamespace(encoding=encoding, width=width, height=height, step=0, data=bytes(1000))
    with pytest.raises(InputError) as caught:
        decoder(RAW)(message)
    assert "\n" not in str(caught.value)
