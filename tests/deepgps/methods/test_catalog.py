from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from deepgps.methods.catalog import METHODS
from deepgps.methods.positioner import load_positioner
from deepgps.progress import ignore
from deepgps.scenario import MethodName
from deepgps.settings import LearnSettings
from sim.errors import InputError
from sim.recording.format import open_recording

EXPLICIT = {"explicit", "explicit_mds"}
SCANS = {"pca_knn"}  # tests/deepgps/methods/test_pca_knn.py


def test_every_method_a_scenario_may_name_exists():
    assert set(METHODS) == set(get_args(MethodName))


@pytest.mark.parametrize("name", sorted(set(METHODS) - EXPLICIT - SCANS))
def test_a_real_recording_of_images_is_learned_and_loaded(name: str, small_recording: Path, tmp_path: Path):
    recording = open_recording(small_recording)
    settings = LearnSettings.model_validate({"train": {"steps": 20}, "network": {"width": 32}, "fold": {"restarts": 0}})
    positioner = METHODS[name](recording, settings, 0, tmp_path / name, ignore)
    images = np.asarray(recording.test_observation[:, 0])
    assert positioner(images).shape == (len(images), 2)
    assert np.array_equal(load_positioner(tmp_path / name)(images), positioner(images))
    again = METHODS[name](recording, settings, 0, tmp_path / "again" / name, ignore)
    assert np.array_equal(again(images), positioner(images))


@pytest.mark.parametrize("name", sorted(EXPLICIT))
def test_what_solves_for_landmarks_refuses_images(name: str, small_recording: Path, tmp_path: Path):
    with pytest.raises(InputError, match="holds images; explicit positioning needs distances to landmarks"):
        METHODS[name](open_recording(small_recording), LearnSettings(), 0, tmp_path / name, ignore)
    assert not (tmp_path / name).exists()


def test_the_resnet_learns_from_raw_images(small_recording: Path, tmp_path: Path):
    recording = open_recording(small_recording)
    network = {"architecture": "resnet", "channels": 4}
    train = {"steps": 4, "segments": 4, "samples": 4}
    settings = LearnSettings.model_validate({"network": network, "train": train, "fold": {"restarts": 0}})
    positioner = METHODS["deepgps"](recording, settings, 0, tmp_path / "deepgps", ignore)
    assert np.isfinite(positioner(np.asarray(recording.observation[:5]))).all()
