"""Poses that are watched as they come: the viewer gets each of them, and without a viewer nothing begins."""

import signal
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import rerun as rr

import deepgps
from deepgps.viewer.located import LocatedView
from tests.helpers.blueprints import count_rows
from tests.helpers.command import deepgps as deepgps_command
from tests.helpers.command import deepgps_here
from tests.helpers.live_server import serve_grpc


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:RRD file has no footer")  # the server is killed at last
def test_the_viewer_gets_every_pose(finished_run: Path, tmp_path: Path):
    images = deepgps.load(finished_run).recording.observation
    (tmp_path / "images").mkdir()
    for number in range(3):
        cv2.imwrite(str(tmp_path / "images" / f"{number}.png"), np.ascontiguousarray(images[number][..., ::-1]))
    got = tmp_path / "got.rrd"
    with serve_grpc("--save", str(got)) as (address, server):
        done = deepgps_command("locate", str(finished_run), "images", "--live", address, cwd=tmp_path)
        time.sleep(1)
        server.send_signal(signal.SIGINT)
        server.wait(10)
    assert (done.returncode, done.stderr, len(done.stdout.splitlines())) == (0, "", 3)
    counts = count_rows(got)
    assert counts["/world/located/position"] == counts["/world/located/yaw"] == counts["/image"] == 3


def test_refused_images_are_no_part_of_the_way(tmp_path: Path):
    stream = rr.RecordingStream("test")
    stream.save(str(tmp_path / "one.rrd"))
    view, polar = LocatedView(stream, None), np.zeros((4, 8, 3), np.uint8)
    of_a_pose: Any = np.bool_(False)  # as a pose holds it
    for number, accepted in enumerate((True, False, None, of_a_pose)):
        view.show(1e9 + number, polar, np.array([number, 0.0]), None, None, accepted)
    stream.flush()
    assert [place[0] for place in view.trail] == [0.0, 2.0]


def test_without_a_viewer_nothing_is_located(finished_run: Path, tmp_path: Path):
    (tmp_path / "one.png").write_bytes(b"")
    done = deepgps_here("locate", str(finished_run), "one.png", "--live", "127.0.0.1:1", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (
        2,
        "",
    ) and "--live 127.0.0.1:1: no Rerun viewer answers there" in done.stderr
