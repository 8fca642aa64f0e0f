"""Commands on what exists already: a recording, a run, a run with one more method. No finished work is lost."""

import shutil
from pathlib import Path

import pytest

from deepgps.runs.run_folder import open_run
from sim.files.checksums import read_json
from tests.helpers.command import deepgps_here
from tests.helpers.toy import make_toy

PLANE = (
    *("landmarks", "--landmarks.segments", "12", "--grid.spacing-m", "0.5", "--learn.train.steps", "20"),
    *("--learn.network.width", "8", "--learn.fold.restarts", "0"),
)


def read_files(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> Path:
    """A run with one method, and what it says."""
    home = tmp_path_factory.mktemp("runs")
    done = deepgps_here("run", *PLANE, "--methods", "knn", "--out", "one", cwd=home)
    assert done.returncode == 0, done.stderr
    return home / "one"


@pytest.fixture
def copied(finished: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(finished, tmp_path / "one"))


@pytest.mark.parametrize("words", [("one", "--methods", "posenet"), (*PLANE, "--methods", "posenet", "--out", "one")])
def test_a_method_is_added_and_the_rest_stays(words, copied, monkeypatch):
    before = read_files(copied)
    monkeypatch.setattr("sim.planar.drive.collect", None)  # the drive is not made again
    done = deepgps_here("run", *words, cwd=copied.parent)
    assert done.returncode == 0, done.stderr
    after = read_files(copied)
    assert open_run(copied).methods == ("knn", "posenet")
    assert list(read_json(copied / "metrics.json")["methods"]) == ["knn", "posenet"]
    kept = [name for name in before if name.startswith(("recording/", "knn/"))]
    assert {name: after[name] for name in kept} == {name: before[name] for name in kept}
    assert after["run.rrd"] != before["run.rrd"]
    assert "posenet/positioner.json" in after


def test_training_alone_keeps_the_old_figures_until_they_are_measured_again(copied):
    before = read_files(copied)
    assert deepgps_here("train", "one", "--methods", "posenet", cwd=copied.parent).returncode == 0
    assert read_files(copied)["metrics.json"] == before["metrics.json"]
    assert deepgps_here("evaluate", "one", cwd=copied.parent).returncode == 0
    assert list(read_json(copied / "metrics.json")["methods"]) == ["knn", "posenet"]


def test_fewer_methods_throw_nothing_away(copied):
    deepgps_here("train", "one", "--methods", "posenet", cwd=copied.parent)
    before = read_files(copied)
    done = deepgps_here("train", *PLANE, "--methods", "posenet", "--out", "one", cwd=copied.parent)
    assert done.returncode == 0, done.stderr
    assert read_files(copied) == before


def test_methods_that_are_not_trained_are_no_reason_to_drive_again(tmp_path):
    deepgps_here("collect", *PLANE, "--out", "c1", cwd=tmp_path)
    before = read_files(tmp_path / "c1" / "recording")
    done = deepgps_here("evaluate", *PLANE, "--out", "c1", "--methods", "knn", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert read_files(tmp_path / "c1" / "recording") == before
    assert open_run(tmp_path / "c1").methods == ("knn",)


def test_another_setting_of_learning_makes_a_run_of_its_own(copied):
    before = read_files(copied)
    done = deepgps_here("evaluate", "one", "--learn.train.steps", "10", "--out", "two", cwd=copied.parent)
    assert done.returncode == 0, done.stderr
    two = copied.parent / "two"
    assert (two / "recording").resolve() == (copied / "recording").resolve()
    assert open_run(two).learn.train.steps == 10
    assert read_files(copied) == before


def test_a_recording_without_a_scenario_is_trained_on_and_measured(tmp_path):
    make_toy(tmp_path / "mine", samples=300)
    before = read_files(tmp_path / "mine")
    words = ("--methods", "knn", "--learn.features.components", "4")
    done = deepgps_here("train", "mine", *words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    (run,) = (tmp_path / "runs" / "mine").iterdir()
    assert (run / "knn" / "positioner.json").is_file()
    assert deepgps_here("evaluate", "mine", *words, cwd=tmp_path).returncode == 0
    assert list(read_json(run / "metrics.json")["methods"]) == ["knn"]
    assert read_files(tmp_path / "mine") == before


def test_settings_of_a_finished_drive_cannot_be_changed(copied, tmp_path):
    before = read_files(copied)
    done = deepgps_here("train", "one", "--encoder.step-noise", "0.1", cwd=copied.parent)
    assert done.returncode == 2
    assert "--encoder.step-noise: the recording one/recording is made already; with it, only --methods" in done.stderr
    assert read_files(copied) == before


@pytest.mark.parametrize(("command", "says"), [("train", "choose one"), ("view", "choose one"), ("evaluate", "one")])
def test_a_folder_of_runs_lists_them(command, says, copied):
    done = deepgps_here(command, ".", cwd=copied.parent)
    assert done.returncode == 2
    assert ". is a folder of runs" in done.stderr
    assert says in done.stderr


def test_a_run_of_a_study_is_not_changed(copied, tmp_path):
    (tmp_path / "study" / "runs").mkdir(parents=True)
    (tmp_path / "study" / "study.yaml").touch()
    shutil.move(copied, tmp_path / "study" / "runs" / "one")
    done = deepgps_here("train", "study/runs/one", "--methods", "posenet", cwd=tmp_path)
    assert (done.returncode, "is a run of a study" in done.stderr) == (2, True)
