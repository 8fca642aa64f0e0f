"""The images of a log are located as those of its recording would be, and tracked by its wheels."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

import deepgps
from deepgps.data.checks import find_view
from deepgps.robot_io.locate import find_shape
from deepgps.robot_io.sources import open_source
from deepgps.terminal.progress import ignore
from tests.helpers.command import deepgps_here
from tests.helpers.robot_log import CONFIG, make_notes, write_log


@pytest.fixture(scope="module")
def run(finished_run: Path) -> deepgps.Run:
    return deepgps.load(finished_run)


@pytest.fixture(scope="module")
def folder(run: deepgps.Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a log, and with configurations for images as the run has them and for others."""
    place = tmp_path_factory.mktemp("log")
    write_log(place / "drive.mcap", make_notes("image/jpeg"))
    rings, sectors, _ = find_shape(run)
    for name, size in (("robot.yaml", {"rings": rings, "sectors": sectors}), ("other.yaml", {})):
        (place / name).write_text(yaml.safe_dump({**CONFIG, "camera": {**CONFIG["camera"], **size}}))
    return place


def locate(run: deepgps.Run, folder: Path, *words: str) -> list[dict]:
    done = deepgps_here(
        "locate", str(run.folder), "drive.mcap", "--config", "robot.yaml", "--frame", "map", *words, cwd=folder
    )
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()]


@pytest.fixture(scope="module")
def lines(run: deepgps.Run, folder: Path) -> list[dict]:
    return locate(run, folder)


def test_every_image_is_unwrapped_by_the_calibration_and_located(run: deepgps.Run, folder: Path, lines: list[dict]):
    view_deg = find_view(run.recording)
    with open_source(folder / "drive.mcap", folder / "robot.yaml", view_deg, False, ignore) as (source, pictures, _):
        assert np.degrees(2 * source.lens.half_angle) == pytest.approx(view_deg)
        polar = np.stack([source.unwrap(one.image) for one in pictures if one.image is not None])
    pose = run.pose(polar, frame="map")
    assert [line["image"] for line in lines] == [str(number) for number in range(len(polar))]
    np.testing.assert_allclose([[line["x"], line["y"]] for line in lines], pose.position, atol=1e-5)
    times = np.array([line["time"] for line in lines])
    assert (np.diff(times) > 0).all() and times[0] > 1e9


def test_a_log_is_tracked_by_its_wheels(run: deepgps.Run, folder: Path, lines: list[dict]):
    tracked = locate(run, folder, "--track")
    assert len(tracked) == len(lines)
    assert set(tracked[-1]) == {"image", "time", "x", "y", "yaw", "radius_68", "radius_95", "accepted", "frame"}
    assert all(line["radius_68"] < line["radius_95"] for line in tracked if line["radius_95"] is not None)


def test_what_does_not_fit_is_refused(run: deepgps.Run, folder: Path):
    before = sorted(folder.iterdir())
    for words, said in (
        (("drive.mcap",), "drive.mcap is a log: it needs --config"),
        (("drive.mcap", "--config", "other.yaml"), "camera.rings and camera.sectors (16, 64): "),
        ((".", "--track"), "--track needs the wheels of a log: --config robot.yaml"),
        (
            ("drive.mcap", "--config", "robot.yaml", "--centre", "9", "9", "--radius-px", "9"),
            "--centre and --radius-px",
        ),
        (("drive.mcap", "--config", "nowhere.yaml"), "nowhere.yaml"),
    ):
        done = deepgps_here("locate", str(run.folder), *words, cwd=folder)
        assert (done.returncode, done.stdout) == (2, "") and said in done.stderr, done.stderr
        assert len([line for line in done.stderr.splitlines() if line.startswith("error: ")]) == 1
    assert sorted(folder.iterdir()) == before
