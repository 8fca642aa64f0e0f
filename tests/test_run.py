"""The run folder: what is kept and what is thrown away when a run ends early."""

from pathlib import Path

import pytest

from deepgps import run as running
from deepgps.progress import ignore
from deepgps.run import claim, open_run, run
from deepgps.scenario import Scenario
from sim.errors import InputError
from sim.files import write_json
from sim.records import work_folder

SCENARIO = Scenario(world="landmarks", methods=("knn",))


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


def test_wrong_input_takes_nothing_from_a_run_that_was_begun_before(tmp_path: Path):
    begin(tmp_path)
    with pytest.raises(InputError), claim(SCENARIO, tmp_path, fresh=False):
        raise InputError
    assert open_run(tmp_path) == SCENARIO


def on_device(name: str) -> Scenario:
    return Scenario.model_validate({**SCENARIO.model_dump(), "learn": {"train": {"device": name}}})


def test_a_device_that_is_not_here_is_told_before_anything_is_driven(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    monkeypatch.setattr(running, "make_recording", lambda *_: pytest.fail("it drove"))
    with pytest.raises(InputError, match=r"learn\.train\.device 'cuda': this machine has no CUDA device"):
        run(on_device("cuda"), tmp_path / "run", False, ignore)
    assert list(tmp_path.iterdir()) == []


def test_what_stands_needs_no_device(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    record(tmp_path)
    running.ask_for_device(on_device("cuda"), tmp_path)
