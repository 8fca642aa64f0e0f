"""The run folder: what is kept and what is thrown away when a run ends early."""

import os
import random
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from deepgps.config.scenario import Scenario, write_out
from deepgps.methods.train import ask_for_device, make_judge
from deepgps.run import run
from deepgps.runs import collect as stages
from deepgps.runs.owned_folder import MARK
from deepgps.runs.provenance import stage_times, timed
from deepgps.runs.run_folder import RUN, claim, open_run
from deepgps.terminal.progress import ignore
from sim.errors import InputError
from sim.files.checksums import read_json, write_json
from sim.recording.format import open_recording, work_folder
from sim.settings import SimSettings
from tests.faults.bits import damage, names
from tests.helpers.command import deepgps_here
from tests.helpers.recordings import small_chunks

SCENARIO = Scenario(world="landmarks", methods=("knn",))
WITHOUT_MUJOCO = "import sys; sys.modules['mujoco'] = None; from deepgps.commands.main import main; main(sys.argv[1:])"


def begin(folder: Path, scenario: Scenario = SCENARIO) -> None:
    with claim(scenario, folder, fresh=False):
        pass


def record(folder: Path) -> None:
    """Leave what tells a finished recording."""
    write_json(folder / "recording" / "manifest.json", {})


def test_wrong_input_leaves_nothing_behind(tmp_path: Path):
    folder = tmp_path / "new" / "run"
    with pytest.raises(InputError), claim(SCENARIO, folder, fresh=False):
        work_folder(folder / "recording").mkdir()
        raise InputError
    assert list(tmp_path.iterdir()) == []


def test_wrong_input_that_shows_late_costs_no_finished_work(tmp_path: Path):
    with pytest.raises(InputError), claim(SCENARIO, tmp_path / "run", fresh=False):
        record(tmp_path / "run")
        raise InputError
    assert (tmp_path / "run" / "recording" / "manifest.json").is_file()
    assert open_run(tmp_path / "run") == SCENARIO


@pytest.mark.parametrize("trained", [False, True])
def test_of_a_study_s_run_wrong_input_leaves_only_what_was_trained(trained: bool, tmp_path: Path):
    record(tmp_path / "shared")
    with pytest.raises(InputError), claim(SCENARIO, tmp_path / "runs" / "one", fresh=False):
        (tmp_path / "runs" / "one" / "recording").symlink_to(tmp_path / "shared" / "recording")
        if trained:
            write_json(tmp_path / "runs" / "one" / "posenet" / "positioner.json", {})
        raise InputError
    assert (tmp_path / "runs" / "one" / "posenet" / "positioner.json").exists() == trained
    assert (tmp_path / "runs").exists() == trained
    assert (tmp_path / "shared" / "recording" / "manifest.json").is_file()


def test_wrong_input_takes_nothing_from_a_run_that_was_begun_before(tmp_path: Path):
    begin(tmp_path)
    with pytest.raises(InputError), claim(SCENARIO, tmp_path, fresh=False):
        raise InputError
    assert open_run(tmp_path) == SCENARIO


def test_killed_while_it_wrote_its_first_file_the_folder_is_still_ours(tmp_path: Path):
    (tmp_path / MARK).touch()
    (tmp_path / MARK).write_text(RUN.text)
    (tmp_path / "scenario.yaml.123.deepgps-part").write_text("name: li")
    begin(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {MARK, "scenario.yaml"}


def on_device(name: str) -> Scenario:
    return Scenario.model_validate({**SCENARIO.model_dump(), "learn": {"train": {"device": name}}})


def test_a_device_that_is_not_here_is_told_before_anything_is_driven(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    monkeypatch.setattr(stages, "make_recording", lambda *_: pytest.fail("it drove"))
    with pytest.raises(InputError, match=r"learn\.train\.device 'cuda': this machine has no CUDA device"):
        run(on_device("cuda"), tmp_path / "run", False, ignore)
    assert list(tmp_path.iterdir()) == []


def test_what_stands_needs_no_device(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    record(tmp_path)
    ask_for_device(on_device("cuda"), tmp_path)


def until(settings: SimSettings, radius_m: float) -> Scenario:
    drive = {"headings": "map", "samples": 300, "until": {"unseen": 0.3, "radius_m": radius_m}}
    features = {"principal": 64, "components": 16}
    values = {**settings.model_dump(), "drive": drive, "grid": {"spacing_m": 0.8}, "learn": {"features": features}}
    return Scenario.model_validate({**values, "methods": ("registration",)})


def test_a_drive_is_enough_if_registration_says_so_and_else_nothing_is_kept_of_that(
    small_settings: SimSettings, small_recording: Path, tmp_path: Path
):
    recording, known = open_recording(small_recording), tmp_path / "registration" / "training.json"
    for radius_m, enough in ((1.0, True), (1e-6, False)):
        judge = make_judge(until(small_settings, radius_m), tmp_path)
        assert judge is not None and judge(recording) == known.is_file() == enough
    assert make_judge(SCENARIO, tmp_path) is None


@pytest.mark.slow  # quick: the one before, and in test_collect
def test_a_drive_ends_by_its_radius_if_that_is_reached_and_else_with_its_samples(
    small_settings: SimSettings, tmp_path: Path
):
    found = {}
    for radius_m in (0.06, 1e-6):
        folder = tmp_path / str(radius_m)
        with small_chunks(256):
            run(until(small_settings, radius_m), folder, False, ignore, last="evaluate")
        found[radius_m] = read_json(folder / "metrics.json")["explore"]
        trained = read_json(folder / "registration" / "training.json")
        assert found[radius_m]["radius_m"] == trained["left_out_m"]
        assert not work_folder(folder / "recording").exists()
    near, far = found.values()
    assert (near["ended_by"], far["ended_by"], far["images"]) == ("radius_m", "samples", 300)
    assert near["radius_m"] <= 0.06 and near["images"] < 300


@pytest.mark.slow
def test_where_the_recording_stands_a_run_needs_neither_mujoco_nor_a_renderer(
    small_settings: SimSettings, small_recording: Path, tmp_path: Path
):
    scenario = Scenario.model_validate({**small_settings.model_dump(), "methods": ("knn",)})
    begin(tmp_path / "run", scenario)
    shutil.copytree(small_recording, tmp_path / "run" / "recording")
    (tmp_path / "mine.yaml").write_text(write_out(scenario))

    def start(*more: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-c", WITHOUT_MUJOCO, "run", "mine.yaml", "--out", "run", *more]
        environment = {**os.environ, "MUJOCO_GL": "nothing"}
        return subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)

    done = start()
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "run" / "run.rrd").is_file()
    assert "MUJOCO_GL" in start("--fresh").stderr
    assert (tmp_path / "run" / "run.rrd").is_file()


def test_a_stage_that_was_cut_off_is_timed_as_the_sum_of_its_parts(tmp_path: Path):
    with pytest.raises(KeyboardInterrupt), timed(tmp_path, "train knn"):
        time.sleep(0.05)
        raise KeyboardInterrupt
    first_s = stage_times(tmp_path)["train"]
    assert first_s >= 0.05
    with timed(tmp_path, "train knn"):
        time.sleep(0.05)
    assert stage_times(tmp_path)["train"] >= first_s + 0.05
    assert (tmp_path / "log.txt").read_text().count("train knn: ") == 2


def test_only_what_was_done_here_is_timed(tmp_path: Path):
    for stage, done in (("train posenet", True), ("train deepgps", False), ("evaluate", False)):
        with timed(tmp_path, stage, done):
            time.sleep(0.02)
    assert set(read_json(tmp_path / "timing.json")) == {"train deepgps", "evaluate"}
    assert list(stage_times(tmp_path)) == ["train", "evaluate"]


@pytest.mark.parametrize(("first", "tries"), [(0, 3), pytest.param(100, 30, marks=pytest.mark.slow)])
def test_random_damage_to_a_run_is_refused_in_a_line_or_harmless(
    first: int, tries: int, finished_run: Path, tmp_path: Path
):
    clean, fields = read_json(finished_run / "metrics.json")["methods"], np.load(finished_run / "error_field.npz")
    for seed in range(first, first + tries):
        folder = shutil.copytree(finished_run, tmp_path / str(seed))
        name, how, _ = damage(folder, random.Random(seed))
        done = deepgps_here("run", str(folder), cwd=tmp_path)
        what = f"seed {seed}: {name}, {how}: {done.stderr}"
        if done.returncode:
            (line,) = [line for line in done.stderr.splitlines() if line.startswith(("error: ", "failed: "))]
            assert names(line, name), what
        else:
            assert read_json(folder / "metrics.json")["methods"] == clean, what
            after = np.load(folder / "error_field.npz")
            assert all((after[array] == fields[array]).all() for array in fields), what
        shutil.rmtree(folder)
