"""The lean that turns show is the camera's, in training and deployment, and images are set upright by it."""

from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np
import pytest

from deepgps.config.learning import LearnSettings
from deepgps.data.turns import (
    LAST_TURNS,
    SeenTurns,
    adapt_upright,
    compare_images,
    find_in_place,
    find_wobble,
    ignore_small,
    measure_turns,
)
from deepgps.evaluation.deployment import adapt, measure_deployment
from deepgps.evaluation.evaluate import predict
from deepgps.learning.training_data import prepare
from deepgps.methods.fit import fit_method
from deepgps.positioner.positioner import NetworkPositioner, Positioner
from deepgps.positioner.stored_positioner import read_training
from sim.alignment import Alignment
from sim.geometry import wrap
from sim.recording.collect import collect
from sim.recording.format import Recording, open_recording, open_truth
from sim.recording.turns import Turns
from sim.sensors.camera.lens import make_lens
from sim.sensors.camera.mount import Upright
from sim.sensors.visual_compass import Hypotheses
from sim.settings import (
    CameraMountSettings,
    CameraSettings,
    DeploymentMountSettings,
    DeploymentSettings,
    DriveSettings,
    GridSettings,
    SimSettings,
)
from tests.helpers.made_once import make_once
from tests.helpers.toy import QUICK

CAMERA = CameraSettings(rings=16, sectors=64, face_px=32)
TRAINING_LEAN, KNOCK = (6.0, -3.0), (9.0, -3.0)


@pytest.fixture(scope="module")
def leaning(small_settings: SimSettings, tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """A recording of a camera that leans, and leans more in deployment."""
    changes = {
        "camera": CAMERA,
        "drive": DriveSettings(samples=200),
        "grid": GridSettings(spacing_m=0.6, headings=2),
        "camera_mount": CameraMountSettings(roll_deg=TRAINING_LEAN[0], pitch_deg=TRAINING_LEAN[1]),
        "deployment": DeploymentSettings(drive_samples=80, camera_mount=DeploymentMountSettings(roll_deg=KNOCK[0])),
    }

    def make(folder: Path) -> None:
        collect(small_settings.model_copy(update=changes), 0, folder / "recording", lambda *_: None, workers=1)

    return open_recording(make_once(tmp_path_factory, "leaning", make) / "recording")


def set_lean(lean: np.ndarray | tuple[float, float]) -> Upright:
    return Upright(make_lens(CAMERA), (float(lean[0]), float(lean[1])))


@pytest.fixture(scope="module")
def deployment(leaning: Recording) -> Recording:
    return open_recording(leaning.folder / "use")


@pytest.mark.slow
def test_the_lean_of_training_and_that_in_deployment_are_found(leaning: Recording, deployment: Recording):
    upright = measure_turns(leaning).upright
    assert upright is not None and ignore_small(upright) == upright
    np.testing.assert_allclose(np.degrees(upright.lean), TRAINING_LEAN, atol=0.3)
    adapted, measured = adapt_upright(upright, deployment)
    assert measured == adapted
    np.testing.assert_allclose(np.degrees(adapted.lean), KNOCK, atol=0.6)


@pytest.mark.slow
def test_turns_of_a_leaning_camera_are_those_of_the_robot(leaning: Recording):
    pose, turns = open_truth(leaning.folder).pose, leaning.turns
    assert turns is not None
    some = find_in_place(turns)
    seen = compare_images(leaning).hypotheses.angle[some, 0]
    error = seen - (pose[leaning.reading[turns.after[some] + 1, 1], 2] - pose[turns.before[some], 2])
    error = np.degrees(wrap(error))
    assert np.sqrt(np.mean(error**2)) < 0.5


def test_a_lean_too_small_to_matter_changes_no_image(small_recording: Path, tmp_path: Path):
    upright = ignore_small(set_lean(np.radians([0.06, 0.07])))
    assert upright.lean == (0.0, 0.0)
    settings, recording = LearnSettings.model_validate(QUICK), open_recording(small_recording)
    same, plain = (prepare(recording, settings, 0, tmp_path / name, one) for name, one in (("a", upright), ("b", None)))
    np.testing.assert_array_equal(same.features, plain.features)


def test_a_camera_that_was_not_knocked_keeps_the_correction_of_training(
    small_recording: Path, monkeypatch: pytest.MonkeyPatch
):
    drive, lean = open_recording(small_recording), np.radians(KNOCK)
    seen = SeenTurns(cast(Hypotheses, None), set_lean(lean))
    monkeypatch.setattr("deepgps.data.turns.compare_images", lambda *_: seen)
    for off_deg, kept in ((0.05, True), (0.2, False)):
        upright = set_lean(lean + np.radians([off_deg, 0.0]))
        adapted, measured = adapt_upright(upright, drive)
        assert measured == seen.upright and adapted == (upright if kept else seen.upright)


def test_the_wobble_is_found_by_pairs_of_images_of_which_some_are_wrong():
    rng = np.random.default_rng(0)
    one, two = rng.normal(scale=0.02, size=(2, 400, 2))
    relative = two - one
    relative[:20] = 0.5
    assert find_wobble(relative) == pytest.approx(0.02, rel=0.15)
    assert find_wobble(np.full((3, 2), np.nan)) == 0.0


def test_the_camera_of_a_level_floor_hardly_wobbles(small_recording: Path):
    recording = open_recording(small_recording)
    upright = compare_images(recording).upright
    assert upright.wobble < 0.05 * upright.lens.half_angle / recording.observation.shape[1]


def test_too_few_turns_in_deployment_leave_the_lean_of_training(small_recording: Path):
    upright, drive = set_lean(np.radians(TRAINING_LEAN)), open_recording(small_recording)
    turns = drive.turns
    assert turns is not None
    few = replace(drive, turns=Turns(*turns.array[find_in_place(turns)[: LAST_TURNS - 1]].T))
    for one in (few, replace(drive, turns=None, turn_observation=None)):
        assert adapt_upright(upright, one) == (upright, None)


@pytest.mark.slow
def test_a_positioner_sets_raw_images_upright_as_in_training_and_in_deployment_by_the_lean_there(
    leaning: Recording, deployment: Recording, tmp_path: Path
):
    learn = {**QUICK, "train": {**QUICK["train"], "steps": 20}}
    settings, folder = LearnSettings.model_validate(learn), tmp_path / "deepgps_compass"
    positioner = fit_method("deepgps_compass", leaning, settings, 0, folder)
    assert isinstance(positioner, NetworkPositioner) and positioner.upright is not None
    training = read_training(folder)
    measured = training["lean_roll_deg"], training["lean_pitch_deg"]
    np.testing.assert_allclose(np.degrees(positioner.upright.lean), measured, atol=1e-4)
    images = np.asarray(leaning.observation[:8])
    upright = replace(positioner, upright=None)(positioner.upright(images))
    np.testing.assert_array_equal(positioner(images), upright)
    assert not np.allclose(replace(positioner, upright=None)(images), upright, atol=1e-3)
    adapted, lean = adapt(positioner, deployment)
    assert lean["lean_roll_deg"] == pytest.approx(KNOCK[0], abs=0.6)
    assert isinstance(adapted, NetworkPositioner) and adapted.upright != positioner.upright
    knocked = predict(folder, leaning, deployment).poses.position
    cells, headings = leaning.test_observation.shape[:2]
    test = np.asarray(leaning.test_observation).reshape(cells * headings, *images.shape[1:])
    np.testing.assert_array_equal(knocked.reshape(-1, 2), adapted(test))


def test_errors_in_deployment_are_those_of_the_positions_there(small_recording: Path, tmp_path: Path):
    drive = open_recording(small_recording)
    place = open_truth(drive.folder).pose[:, :2]
    turned = Alignment(rotation=np.array([[0.0, -1.0], [1.0, 0.0]]), translation=np.array([1.0, 2.0]), scale=1.0)
    own = (place - turned.translation) @ turned.rotation
    own[0] += [0.3, 0.4]

    def know(observations: np.ndarray) -> np.ndarray:
        assert len(observations) == len(own)
        return own

    found = measure_deployment(cast(Positioner, know), turned, drive, tmp_path)
    assert found.truth.shape == (len(own), 2) and found.predicted.shape == (len(own), 1, 2)
    np.testing.assert_allclose(found.worst, [0.5, *np.zeros(len(own) - 1)], atol=1e-9)
