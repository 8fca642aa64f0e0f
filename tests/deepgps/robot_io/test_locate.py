"""Poses of images as they come: the same as from Python, whatever the source; what cannot be read is said."""

import io
import json
import sys
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

import deepgps
from deepgps.robot_io.locate import find_shape
from deepgps.robot_io.sources import MAX_BYTES, Unwrapper, open_pictures, read_stream
from deepgps.viewer.pictures import make_warp, warp_round
from sim.errors import InputError
from sim.sensors.camera.unwrap import RoundImage, unwrap_fisheye
from tests.helpers.command import deepgps_here
from tests.helpers.toy import make_toy

KEYS = {"image", "x", "y", "yaw", "radius_68", "radius_95", "accepted", "frame"}


@pytest.fixture(scope="module")
def run(finished_run: Path) -> deepgps.Run:
    return deepgps.load(finished_run)


@pytest.fixture
def folder(run: deepgps.Run, tmp_path: Path) -> Path:
    """A folder with three polar images."""
    for number in range(3):
        (tmp_path / f"{number}.png").write_bytes(encode(run.recording.observation[number]))
    (tmp_path / "notes.txt").write_text("no image")
    return tmp_path


def encode(image: np.ndarray) -> bytes:
    """An RGB image as PNG."""
    return cv2.imencode(".png", np.ascontiguousarray(image[..., ::-1]))[1].tobytes()


def frame(*images: bytes) -> bytes:
    """Images as standard input has them."""
    return b"".join(len(image).to_bytes(4, "big") + image for image in images)


def test_causes_are_named_if_asked_for(run: deepgps.Run, folder: Path):
    (folder / "black.png").write_bytes(encode(np.zeros_like(run.recording.observation[0])))
    done = deepgps_here("locate", str(run.folder), ".", "--causes", cwd=folder)
    assert done.returncode == 0, done.stderr
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    assert [set(line) for line in lines] == [KEYS | {"cause"}] * 4
    assert {line["image"]: line["cause"] for line in lines}["black.png"] == "black"
    assert {line["cause"] for line in lines if line["accepted"]} <= {None, "black"}


def test_lines_are_the_poses_that_python_gives(run: deepgps.Run, folder: Path):
    (folder / "nonsense.png").write_bytes(encode(np.zeros((9, 12, 3), np.uint8)))
    places: tuple[tuple[str, deepgps.api.run.Frame], ...] = (("deepgps", "map"), ("posenet", "world"))
    for method, place in places:
        done = deepgps_here("locate", str(run.folder), ".", "--method", method, "--frame", place, cwd=folder)
        said = "failed: 1 of 4 images could not be located; their lines say why\n"
        assert (done.returncode, done.stderr) == (1, said)
        *lines, wrong = (json.loads(line) for line in done.stdout.splitlines())
        assert set(wrong) == {"image", "error"} and "it has 12 x 9 px: " in wrong["error"]
        assert [set(line) for line in lines] == [KEYS] * 3
        assert [(line["image"], line["frame"]) for line in lines] == [(f"{number}.png", place) for number in range(3)]
        for number, line in enumerate(lines):
            pose = run.pose(run.recording.observation[number], method, place)
            np.testing.assert_allclose([line["x"], line["y"]], pose.position, atol=1e-5)
            yaw = np.nan if line["yaw"] is None else line["yaw"]
            np.testing.assert_allclose(yaw, np.asarray(pose.yaw, float), atol=1e-5)
            assert (line["radius_95"] is None) == (pose.radius_95 is None)
            assert line["accepted"] in ({None} if pose.accepted is None else {bool(pose.accepted)})


def test_standard_input_is_read_image_by_image(run: deepgps.Run, folder: Path, monkeypatch: pytest.MonkeyPatch):
    data = [(folder / f"{number}.png").read_bytes() for number in range(3)]
    stdin = io.BytesIO(frame(data[0], b"nonsense", data[2]) + (1000).to_bytes(4, "big") + b"cut off")
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=stdin))
    done = deepgps_here("locate", str(run.folder), "-", cwd=folder)
    assert (done.returncode, done.stderr) == (1, "failed: 2 of 4 images could not be located; their lines say why\n")
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    assert [line["image"] for line in lines] == ["0", "1", "2", "3"]
    assert [line.get("error") for line in lines] == [
        None,
        "it is no image that OpenCV can read",
        None,
        "standard input ends in the middle of it",
    ]
    alone = json.loads(deepgps_here("locate", str(run.folder), "2.png", cwd=folder).stdout)
    assert {**alone, "image": "2"} == lines[2]


def test_an_image_is_answered_before_the_next_one_is_read():
    read = []

    class Slow(io.BytesIO):
        def read(self, size: int | None = -1) -> bytes:
            read.append(size)
            return super().read(size)

    picture = encode(np.zeros((4, 4, 3), np.uint8))
    pictures = read_stream(Slow(frame(picture, picture)))
    assert next(pictures).image is not None
    assert read == [4, len(picture)]
    for length in (0, MAX_BYTES + 1):
        with pytest.raises(InputError, match=f"standard input: image 0 has a length of {length} bytes; must be 1 to"):
            next(read_stream(io.BytesIO(length.to_bytes(4, "big") + b"more")))


def test_a_raw_image_is_unwrapped_where_the_circle_is(run: deepgps.Run):
    polar, shape = np.asarray(run.recording.observation[0]), find_shape(run)
    rings, sectors, _ = shape
    raw = warp_round(polar, make_warp(run.scenario.camera, rings, sectors, 121))
    centre = ((121 - 1) / 2, (121 - 1) / 2)
    unwrapped = unwrap_fisheye(raw, centre, 60.5, rings, sectors)
    np.testing.assert_array_equal(Unwrapper(shape)(raw), unwrapped)
    assert np.abs(unwrapped.astype(float) - polar).mean() < 10.0
    np.testing.assert_array_equal(Unwrapper(shape)(polar), polar)
    wide = np.pad(raw, ((0, 0), (20, 30), (0, 0)))
    circle = RoundImage((centre[0] + 20, centre[1]), 60.5)
    np.testing.assert_array_equal(Unwrapper(shape, circle)(wide), unwrapped)
    with pytest.raises(InputError, match="it has 171 x 121 px: --centre and --radius-px must say where"):
        Unwrapper(shape)(wide)
    with pytest.raises(InputError, match="must be column and row in an image of 121 x 121 px"):
        Unwrapper(shape, RoundImage((150.0, 3.0), 60.5))(raw)


def test_wrong_words_are_refused(run: deepgps.Run, tmp_path: Path):
    circle = ("0.png", "--centre", "3", "3", "--radius-px")
    (tmp_path / "empty").mkdir()
    for words, said in (
        (("nowhere.png",), "nowhere.png: no such file"),
        (("empty",), "empty holds no image"),
        (("0.png", "--method", "pca_knn"), "method 'pca_knn': "),
        (("0.png", "--radius-px", "3"), "--centre and --radius-px: give both"),
        (("0.png", "--forward-deg", "3"), "--forward-deg needs --centre"),
        (("0.png", "--centre", "nan", "3", "--radius-px", "9"), "--centre nan 3: "),
        (("0.png", "--centre", "3", "-1", "--radius-px", "9"), "--centre 3 -1: "),
        ((*circle, "inf"), "--radius-px inf: must be from 1 to 32000 px"),
        ((*circle, "0.9"), "--radius-px 0.9: must be from 1 to 32000 px"),
        ((*circle, "9", "--forward-deg", "nan"), "--forward-deg nan: must be from -360 to 360"),
        ((*circle, "9", "--forward-deg", "361"), "--forward-deg 361: must be from -360 to 360"),
    ):
        done = deepgps_here("locate", str(run.folder), *words, cwd=tmp_path)
        assert (done.returncode, done.stdout, len(done.stderr.splitlines())) == (2, "", 1) and said in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["empty"]


def test_scans_have_no_images_to_locate_and_a_folder_is_no_image(tmp_path: Path):
    make_toy(tmp_path / "recording", samples=60)
    with pytest.raises(InputError, match="has learned from observations of kind vector"):
        find_shape(SimpleNamespace(folder=tmp_path))  # pyright: ignore[reportArgumentType]
    (tmp_path / "a.png").mkdir()
    (picture,) = open_pictures(str(tmp_path), io.BytesIO())
    assert picture.image is None and picture.error == "a.png is a folder, not a file"
