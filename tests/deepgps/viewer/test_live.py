"""A run that is watched: what arrives is what was made, the results are the same, and a lost viewer ends nothing."""

import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
import rerun as rr
from rerun.chunk import RrdReader

from deepgps.config.scenario import Scenario
from deepgps.evaluation.error_field import read_all_headings, split_by_acceptance
from deepgps.runs.run_folder import open_run
from deepgps.terminal.progress import Look, ignore
from deepgps.viewer.connect import connect, open_viewer
from deepgps.viewer.drive import ROBOT
from deepgps.viewer.error_field import ACCEPTED_PART
from deepgps.viewer.live import LiveDrive, LiveView, show_live
from deepgps.viewer.own_map import OWN_MAP, log_own_map
from deepgps.viewer.stream import run_clock
from sim.errors import InputError, WorkError
from sim.files.checksums import write_arrays
from sim.recording.format import chunk_files, open_truth, work_folder
from sim.settings import CameraSettings
from tests.helpers.blueprints import count_rows, find_missing, read_entity, read_error_field
from tests.helpers.command import MINI, arrays, assert_one_clear_line, deepgps, deepgps_here, drop_progress, wait_until
from tests.helpers.live_server import serve_grpc
from tests.helpers.toy import make_toy


@pytest.fixture(scope="module")
def watched(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A run that streamed to a viewer while it went on, and what the viewer got."""
    folder = tmp_path_factory.mktemp("watched")
    (folder / "mini.yaml").write_text(MINI)
    got = folder / "got.rrd"
    with serve_grpc("--save", str(got)) as (address, server):
        done = deepgps("run", "mini.yaml", "--out", "run", "--live", address, cwd=folder)
        time.sleep(1)
        server.send_signal(signal.SIGINT)
        server.wait(10)
    assert (done.returncode, drop_progress(done.stderr)) == (0, [])
    return folder / "run", got


# The server is killed at last, and does not close its file.
no_footer = pytest.mark.filterwarnings("ignore:RRD file has no footer")


def check_whole(run: Path, got: Path) -> None:
    """Assert that what a viewer got of a run is all of it."""
    counts = count_rows(got)
    assert counts["/world/drive/path"] >= len(np.unique(np.load(run / "recording" / "truth" / "reading.npy")[:, 0]))
    # the drive goes on to the end of its chunk, and is cut to the samples wanted
    assert counts[f"/{ROBOT}"] >= len(np.load(run / "recording" / "truth" / "pose.npy"))
    assert counts["/drive/fisheye"] == counts["/drive/polar"] > 0
    for name in ("deepgps", "posenet"):
        with np.load(run / name / "history.npz") as history:
            assert counts[f"/training/{name}/loss"] >= len(history["loss"])
            assert counts[f"/world/training/{name}"] >= len(history["snapshot"])
    static = {chunk.entity_path for chunk in RrdReader(got).stream() if not chunk.timeline_names}
    for name, field in read_all_headings(run).items():
        _, predicted = read_error_field(got, name, parts=(ACCEPTED_PART,))
        np.testing.assert_allclose(predicted, split_by_acceptance(field)[0].predicted, atol=1e-6)
    assert {"/world/room", "/world/floor_plan", "/report/figures", "/steps"} <= static
    assert find_missing(got) == []


def test_a_finished_run_is_sent_whole(finished_run: Path, tmp_path: Path) -> None:
    with rr.RecordingStream("test") as stream:
        stream.save(tmp_path / "got.rrd")
        view = LiveView(stream, open_run(finished_run), finished_run)
        view.steps["drive"] = (1, 2)
        view.update()
        view.update()  # nothing is sent twice
        stream.disconnect()
    check_whole(finished_run, tmp_path / "got.rrd")
    assert count_rows(tmp_path / "got.rrd")[f"/{ROBOT}"] == len(open_truth(finished_run / "recording").pose)


@pytest.mark.slow
@no_footer
def test_a_viewer_gets_the_whole_run_while_it_goes_on(watched: tuple[Path, Path]) -> None:
    check_whole(*watched)


@pytest.mark.slow
def test_a_run_that_is_watched_is_the_same_in_every_byte(watched: tuple[Path, Path], finished_run: Path) -> None:
    assert arrays(watched[0]) == arrays(finished_run)


@pytest.mark.slow
def test_a_viewer_killed_in_the_middle_is_one_line_and_changes_no_byte(finished_run: Path, tmp_path: Path) -> None:
    words = ["evaluate", str(finished_run.parent / "mini.yaml"), "--out", "run", "--live"]
    pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
    with serve_grpc("--serve-grpc") as (address, server):
        process = subprocess.Popen(
            [sys.executable, "-m", "deepgps.commands.main", *words, address], cwd=tmp_path, **pipes
        )
        wait_until(lambda: list(tmp_path.glob("run/recording.collecting/drive-*.npz")), process)
        server.kill()
        _, said = process.communicate(timeout=300)
    assert process.returncode == 0, said
    assert "warning: the connection to the viewer is lost" in said and "the run continues without it" in said
    assert len(drop_progress(said)) == 1
    assert arrays(tmp_path / "run") == arrays(finished_run)


def write_chunk(recording: Path, place: np.ndarray, reading: np.ndarray) -> None:
    """Write what a drive leaves while it is collected: places (n, 2), and segment and observation of readings."""
    state = np.zeros((len(place), 7))
    state[:, :2], state[:, 3] = place, 1.0
    arrays = {"state": state, "segment": reading[:, 0], "observation": reading[:, 1]}
    write_arrays(chunk_files(work_folder(recording), 0)[0], arrays)


@pytest.mark.parametrize("endpoint", [False, True])
def test_segments_after_the_last_chunk_that_was_seen_are_whole(tmp_path: Path, endpoint: bool) -> None:
    recording = make_toy(tmp_path / "recording", samples=40 if endpoint else 400, endpoint=endpoint)
    truth = open_truth(recording.folder)
    begins = np.flatnonzero(np.diff(truth.reading[:, 0], prepend=-1))
    strips = np.stack([truth.reading[begins, 1], truth.reading[np.r_[begins[1:], len(truth.reading)] - 1, 1]], axis=1)
    seen = truth.reading[truth.reading[:, 0] < 3]
    write_chunk(recording.folder, truth.pose[: seen[-1, 1] + 1, :2], seen)
    path = tmp_path / "got.rrd"
    with rr.RecordingStream("test") as stream:
        stream.save(path)
        drive = LiveDrive(stream, recording.folder, CameraSettings())
        drive.send_chunks(np.arange)
        drive.send_rest(recording.observation, truth, np.arange)
        stream.disconnect()
    shown = np.concatenate(read_entity(path, "world/drive/path")["LineStrips3D:strips"].drop_null().to_pylist())
    np.testing.assert_allclose(shown[:, :, :2], truth.pose[strips, :2], atol=1e-6)


def test_the_own_map_is_laid_where_the_robot_truly_is(tmp_path: Path) -> None:
    """The robot is at (1, 2), ahead along y; on its map it is at (0.5, 0), ahead along x, with a thing 0.2 m ahead."""
    view = np.zeros((3, 20), np.uint8)
    view[1, 14], view[0, 0] = 4, 1
    chunk = {"view": view, "view_at": np.array((-0.025, -0.075, 0.05)), "view_pose": np.array((0.5, 0.0, 0.0))}
    with rr.RecordingStream("test") as stream:
        stream.save(tmp_path / "got.rrd")
        log_own_map(stream, chunk, np.array((1.0, 2.0, np.pi / 2)), run_clock(np.zeros(1)))
        stream.disconnect()
    for name, expected in (("obstacles", (1.0, 2.2)), ("passed", (1.05, 1.5))):
        (points,) = read_entity(tmp_path / "got.rrd", f"{OWN_MAP}/{name}")["Points3D:positions"].drop_null().to_pylist()
        np.testing.assert_allclose(np.array(points)[:, :2], [expected], atol=1e-6)


HANGING_VIEWER = """
import os, signal, sys
from pathlib import Path
from deepgps.terminal.progress import ignore
from deepgps.config.scenario import Scenario
from deepgps.viewer import live

live.STALL_S, live.PATIENCE_S = 1.0, 2.0
with live.show_live(sys.argv[1], Scenario(), Path(sys.argv[2]), ignore, print) as report:
    os.kill(int(sys.argv[3]), signal.SIGSTOP)
    report("drive", 1, 2)
print("done")
"""


@pytest.mark.slow
def test_a_viewer_that_hangs_holds_up_neither_the_run_nor_the_end_of_the_process(tmp_path: Path) -> None:
    many = np.arange(100_000)  # more than waits in the sockets between
    write_chunk(tmp_path / "recording", np.stack([many / len(many), 0 * many], 1), np.stack([0 * many, many], 1))
    with serve_grpc("--serve-grpc") as (address, server):
        command = [sys.executable, "-c", HANGING_VIEWER, address, str(tmp_path), str(server.pid)]
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
        server.send_signal(signal.SIGCONT)
    assert done.returncode == 0, done.stderr
    warning, end = done.stdout.splitlines()
    assert re.fullmatch(
        r"the (connection to the viewer is lost \(.+\); the run continues|viewer no longer accepts data).+", warning
    )
    assert end == "done"


def test_what_the_stages_tell_is_told_on_and_only_a_viewer_that_went_away_is_called_gone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    heard, warned = [], []

    def progress(label: str, done: int, total: int, look: Look | None = None) -> None:
        heard.append((label, done, total))

    with serve_grpc("--serve-grpc") as (address, _):
        with show_live(address, Scenario(), tmp_path, progress, warned.append) as report:
            report("drive", 1, 2)
            report("deepgps", 2, 2, dict)
        assert (heard, warned) == ([("drive", 1, 2), ("deepgps", 2, 2)], [])
        for error, said in (
            (RuntimeError("no connection"), "the connection to the viewer is lost (RuntimeError: no connection)"),
            (ConnectionResetError("reset"), "the connection to the viewer is lost (ConnectionResetError: reset)"),
            (InputError("a file is\ncut off"), "the live view failed (InputError: a file is cut off)"),
        ):

            def fail(view: LiveView, error: Exception = error) -> None:
                raise error

            monkeypatch.setattr(LiveView, "update", fail)
            with show_live(address, Scenario(), tmp_path, ignore, warned.append) as report:
                report("drive", 1, 2)
            assert warned.pop() == f"{said}; the run continues without it" and not warned


def test_a_folder_that_is_refused_is_not_shown_and_a_finished_run_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    looked = []

    def look(view: LiveView) -> None:
        looked.append(view)

    monkeypatch.setattr(LiveView, "update", look)
    with serve_grpc("--serve-grpc") as (address, _):
        with suppress(InputError), show_live(address, Scenario(), tmp_path, ignore, pytest.fail):
            raise InputError("it holds a run of another scenario")
        assert len(looked) == 0
        with show_live(address, Scenario(), tmp_path, ignore, pytest.fail):
            pass  # the stages of a finished run report nothing
        assert len(looked) == 1


def test_a_wrong_address_is_one_clear_line_and_one_with_a_scheme_is_taken_as_it_is() -> None:
    for address, message in (
        ("127.0.0.1:99999", "invalid port number"),
        ("127.0.0.1:9876 twice", "invalid port number"),
        ("http://127.0.0.1:9876/proxy", "Invalid or missing scheme"),
        ("rerun+http://127.0.0.1:9876", "Unexpected URI"),
    ):
        with pytest.raises(InputError) as caught:
            connect(address, "test")
        assert message in str(caught.value) and f"--live {address}: no Rerun viewer answers" in str(caught.value)
    with serve_grpc("--serve-grpc") as (address, _):
        connect(f"rerun+http://{address}/proxy", "test").disconnect()


@pytest.fixture
def stranger() -> Iterator[str]:
    """Something that listens and is no viewer."""
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def answer() -> None:
            with suppress(OSError):  # closed
                while True:
                    with listener.accept()[0] as connection:
                        connection.sendall(b"HTTP/1.1 505 what?\r\n\r\n")

        threading.Thread(target=answer, daemon=True).start()
        yield f"127.0.0.1:{listener.getsockname()[1]}"


def test_without_a_viewer_that_answers_nothing_begins(stranger: str, tmp_path: Path) -> None:
    for address in ("127.0.0.1:1", stranger):
        done = deepgps_here("run", "tiny", "--live", address, cwd=tmp_path)
        assert_one_clear_line(done, 2, f"--live {address}: no Rerun viewer answers there", tmp_path)


def test_a_viewer_without_a_display_is_one_clear_line(without_display: None) -> None:
    with pytest.raises(WorkError, match="cannot open a window; without a display, --live HOST:PORT streams"):
        open_viewer()
