"""Trainings in processes of their own: what they report, how they fail, and that they give the same bytes."""

import os
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from deepgps.config.learning import LearnSettings
from deepgps.config.methods import folder_of
from deepgps.config.scenario import Scenario
from deepgps.methods import train as side_by_side
from deepgps.methods.train import choose_long, train, train_side_by_side
from deepgps.terminal.progress import ignore
from sim.errors import InputError, WorkError


@dataclass(frozen=True)
class Fake:
    """What a child process does in place of a training."""

    method: str
    does: str

    def __call__(self, progress):
        if self.does == "refuse":
            raise InputError(f"{self.method}: no")
        if self.does == "die":
            os._exit(3)
        if self.does == "wait":
            time.sleep(60)
        for step in range(3):
            progress(self.method, step + 1, 3, lambda: {"loss": np.arange(3.0)})


def test_every_training_reports_its_steps_and_its_history():
    heard = []
    train_side_by_side([Fake(name, "learn") for name in "abc"], 2, lambda *step: heard.append(step))  # pyright: ignore
    for name in "abc":
        steps = [step for step in heard if step[0] == name]
        assert [done for _, done, _, _ in steps] == [1, 2, 3]
        np.testing.assert_array_equal(steps[-1][3]()["loss"], np.arange(3.0))


@pytest.mark.parametrize(("does", "kind", "text"), [("refuse", InputError, "b: no"), ("die", WorkError, "training b")])
def test_the_first_error_ends_all_trainings(does, kind, text):
    start = time.monotonic()
    with pytest.raises(kind, match=text):
        train_side_by_side([Fake("a", "wait"), Fake("b", does)], 2, ignore)  # pyright: ignore
    assert time.monotonic() - start < 40, "the other training was waited for"


def test_short_trainings_single_ones_and_those_on_one_core_stay_in_this_process(monkeypatch: pytest.MonkeyPatch):
    settings = LearnSettings()
    monkeypatch.setattr(side_by_side, "usable_cores", lambda: 2)
    names = ["deepgps", "knn", "posenet"]
    assert choose_long(names, settings, 600) == ["deepgps", "posenet"]
    assert choose_long(names, settings, 8000) == names
    assert choose_long(names[:2], settings, 600) == []
    assert choose_long(names, LearnSettings(train={"steps": 100}), 600) == []  # pyright: ignore
    monkeypatch.setattr(side_by_side, "usable_cores", lambda: 1)
    assert choose_long(names, settings, 8000) == []


@pytest.mark.slow
def test_trainings_side_by_side_give_the_same_bytes_in_any_order(
    small_recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    names = ["deepgps", "registration", "posenet", "registration_distances"]
    learn = {"train": {"steps": 60, "checkpoint_steps": 30, "segments": 8, "samples": 4}, "network": {"width": 32}}
    scenario = Scenario.model_validate({"name": "mine", "learn": learn, "methods": names})
    monkeypatch.setattr(side_by_side, "MIN_IMAGES", 0)
    for name, methods, processes in (("one", names, 1), ("two", names, 2), ("back", names[::-1], 3)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "recording").symlink_to(small_recording)
        train(scenario.model_copy(update={"methods": methods}), tmp_path / name, ignore, processes)
    for method in names:
        for file in folder_of(tmp_path / "one", method).glob("*.safetensors"):
            for other in ("two", "back"):
                assert file.read_bytes() == (folder_of(tmp_path / other, method) / file.name).read_bytes()
