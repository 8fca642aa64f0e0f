"""The recording: whole, read back as it was written, and one clear line where something is missing."""

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import rerun as rr
from rerun.chunk import RrdReader
from synthetic_run import METHODS, write_synthetic_run

from deepgps.figures import read_fields
from deepgps.viewer import drive
from deepgps.viewer.drive import ROBOT
from deepgps.viewer.read import read_error_field
from deepgps.viewer.recording import RECORDING, find_recording, write_recording
from deepgps.viewer.show import find_viewer, view
from deepgps.viewer.timeline import DRIVE_TIME, PROGRESS, STEP
from sim.errors import InputError, WorkError

SAMPLES = 60


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = write_synthetic_run(tmp_path_factory.mktemp("run"), samples=SAMPLES, spacing_m=0.4)
    rr.set_strict_mode(True)
    write_recording(folder)
    rr.set_strict_mode(False)
    return folder


@pytest.fixture
def copied(run: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(run, tmp_path / "copy"))


def rows(path: Path) -> dict[str, int]:
    """Rows of each entity over time; static ones count none."""
    counts: dict[str, int] = {}
    for chunk in RrdReader(path).stream():
        timed = set(chunk.to_record_batch().schema.names) & {DRIVE_TIME, STEP}
        counts[chunk.entity_path] = counts.get(chunk.entity_path, 0) + (chunk.num_rows if timed else 0)
    return counts


@pytest.mark.parametrize("method", METHODS)
def test_the_error_field_reads_back_as_it_was_measured(run: Path, method: str) -> None:
    with np.load(run / "error_field.npz") as arrays:
        truth, predicted = arrays["truth"], arrays[method]
    error = np.linalg.norm(predicted - truth[:, None], axis=-1).max(axis=1)
    field = read_error_field(run / RECORDING, method)
    np.testing.assert_allclose(field.truth, truth, atol=1e-6)
    np.testing.assert_allclose(field.error, error, atol=1e-6)
    np.testing.assert_allclose(field.predicted, read_fields(run)[method].predicted, atol=1e-6)


def test_drive_and_training_are_there_row_by_row(run: Path) -> None:
    counts = rows(run / RECORDING)
    readings = len(np.load(run / "recording" / "reading.npy"))
    for path in ("drive/distance/encoder", "drive/distance/truth", "drive/difference", "drive/ticks/left"):
        assert counts[f"/{path}"] == readings
    for path in ("drive/fisheye", "drive/polar", ROBOT):
        assert counts[f"/{path}"] == SAMPLES
    for name in ("deepgps", "posenet", "odometry"):
        with np.load(run / name / "history.npz") as history:
            assert counts[f"/training/{name}/loss"] == len(history["loss"])
            assert counts[f"/world/training/{name}"] == len(history["snapshot"])
    assert {"/world/room", "/world/floor_plan", "/report/figures", "/report/text"} <= set(counts)


def test_the_timelines_hold_no_wall_clock(run: Path) -> None:
    reader = RrdReader(run / RECORDING)
    names = {name for chunk in reader.stream() for name in chunk.timeline_names}
    assert names == {DRIVE_TIME, STEP, PROGRESS}


def test_a_blueprint_is_embedded(run: Path) -> None:
    assert len(RrdReader(run / RECORDING).blueprints()) >= 1


def test_equal_runs_give_equal_contents(run: Path, copied: Path) -> None:
    write_recording(copied)
    pair = [str(folder / RECORDING) for folder in (run, copied)]
    ids = [RrdReader(path).recordings()[0].recording_id for path in pair]
    assert ids[0] == ids[1]
    compared = subprocess.run(
        [find_viewer(), "rrd", "compare", "--unordered", *pair], check=False, capture_output=True, text=True
    )
    assert compared.returncode == 0, compared.stderr


def test_the_file_verifies(run: Path) -> None:
    command = [find_viewer(), "rrd", "verify", str(run / RECORDING)]
    verified = subprocess.run(command, check=False, capture_output=True, text=True)
    assert verified.returncode == 0, verified.stderr


def test_images_of_a_long_drive_are_thinned(copied: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(drive, "IMAGES_AT_MOST", 25)
    counts = rows(write_recording(copied))
    assert counts["/drive/fisheye"] == counts["/drive/polar"] == 20  # every third of 60
    assert counts[f"/{ROBOT}"] == SAMPLES


def test_a_method_that_is_not_there_is_told_with_those_that_are(run: Path) -> None:
    with pytest.raises(InputError, match="no method 'gps'; it has deepgps, knn, odometry, posenet"):
        read_error_field(run / RECORDING, "gps")


def test_a_missing_recording_is_written_when_it_is_looked_for(copied: Path) -> None:
    (copied / RECORDING).unlink()
    assert find_recording(copied).is_file()


@pytest.mark.parametrize("keep", [0.0, 0.3, 0.999])
def test_a_cut_off_recording_is_one_clear_line(copied: Path, keep: float) -> None:
    path = copied / RECORDING
    content = path.read_bytes()
    path.write_bytes(content[: int(keep * len(content))])
    with pytest.raises(InputError, match=r"recording.rrd is cut off or no recording") as caught:
        view([copied])
    assert "\n" not in str(caught.value)


def test_a_folder_that_is_no_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"is no run: it has no metrics\.json"):
        view([tmp_path])


def test_a_run_half_there_leaves_nothing_half_written(copied: Path) -> None:
    (copied / RECORDING).unlink()
    (copied / "recording" / "scene.glb").write_bytes(b"half")
    with pytest.raises(InputError, match=r"scene.glb cannot be read"):
        view([copied])
    assert not (copied / RECORDING).exists()


def test_a_viewer_without_a_display_is_one_clear_line(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(WorkError, match="without a display, copy") as caught:
        view([run])
    assert "\n" not in str(caught.value)


def test_a_missing_viewer_is_one_clear_line(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", "/nonexistent/python")
    monkeypatch.setenv("PATH", "/nonexistent")
    with pytest.raises(WorkError, match="the Rerun viewer is missing"):
        view([run])
