from pathlib import Path

import cv2
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from scipy.spatial.distance import pdist

from deepgps.config.learning import LearnSettings
from deepgps.config.methods import METHODS, colour_of
from deepgps.methods.fit import fit_method
from deepgps.positioner.stored_positioner import load_positioner
from deepgps.reports.plots import colour_on_dark
from deepgps.terminal.progress import ignore
from sim.errors import InputError
from sim.recording.format import open_recording

EXPLICIT = sorted(name for name, method in METHODS.items() if method.observes == "vector")
QUICK = ("deepgps", "knn", "registration", "registration_distances", "sfa_linear")
IMAGES = sorted(name for name, method in METHODS.items() if method.observes in {None, "polar_image"})


def test_no_two_methods_are_alike_in_colour_on_paper_or_on_the_screen():
    for shown in (lambda name: tuple(round(255 * part) for part in to_rgb(colour_of(name))), colour_on_dark):
        colours = np.array([[shown(name)] for name in METHODS], np.float32) / 255
        lab = cv2.cvtColor(colours, cv2.COLOR_RGB2LAB)[:, 0]
        assert pdist(lab).min() > 20.0  # of some hundred from black to white; a just noticeable difference is 2


@pytest.mark.parametrize(
    "name", [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in IMAGES]
)
def test_a_real_recording_of_images_is_learned_and_loaded(name: str, small_recording: Path, tmp_path: Path):
    recording = open_recording(small_recording)
    settings = LearnSettings.model_validate({"train": {"steps": 20}, "network": {"width": 32}, "fold": {"restarts": 0}})
    positioner = fit_method(name, recording, settings, 0, tmp_path / name, ignore)
    images = np.asarray(recording.test_observation[:, 0])
    assert positioner(images).shape == (len(images), 2)
    assert np.array_equal(load_positioner(tmp_path / name)(images), positioner(images))
    again = fit_method(name, recording, settings, 0, tmp_path / "again" / name, ignore)
    assert np.array_equal(again(images), positioner(images))


@pytest.mark.parametrize("name", EXPLICIT)
def test_what_solves_for_landmarks_refuses_images(name: str, small_recording: Path, tmp_path: Path):
    with pytest.raises(InputError, match="needs distances to landmarks"):
        fit_method(name, open_recording(small_recording), LearnSettings(), 0, tmp_path / name, ignore)
    assert not (tmp_path / name).exists()


def test_the_resnet_learns_from_raw_images(small_recording: Path, tmp_path: Path):
    recording = open_recording(small_recording)
    network = {"architecture": "resnet", "channels": 4}
    train = {"steps": 4, "segments": 4, "samples": 4}
    settings = LearnSettings.model_validate({"network": network, "train": train, "fold": {"restarts": 0}})
    positioner = fit_method("deepgps", recording, settings, 0, tmp_path / "deepgps", ignore)
    assert np.isfinite(positioner(np.asarray(recording.observation[:5]))).all()
