from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from deepgps.config.learning import LearnSettings
from deepgps.learning import training_data
from tests.helpers.toy import make_toy


def test_features_do_not_depend_on_the_number_of_cores(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    toy = make_toy(tmp_path / "toy", samples=300)
    images = np.random.default_rng(0).integers(0, 256, (len(toy.observation), 4, 16, 3), np.uint8)
    manifest = toy.manifest.model_copy(update={"sensors": {"fisheye": "polar_image"}})
    recording = replace(toy, observation=images, manifest=manifest)
    threads = []
    plain = training_data.cached_features

    def count_threads(*arguments):
        threads.append(torch.get_num_threads())
        return plain(*arguments)

    monkeypatch.setattr(training_data, "cached_features", count_threads)
    before = torch.get_num_threads()
    training_data.prepare(recording, LearnSettings(), 0, tmp_path)
    assert threads == [LearnSettings().train.threads]
    assert torch.get_num_threads() == before
