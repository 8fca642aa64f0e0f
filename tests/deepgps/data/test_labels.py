"""Labels of a laboratory's tags: as the truth up to a motion, and what supervised methods take in their place."""

from pathlib import Path

import numpy as np
import pytest

import deepgps
from deepgps.config.learning import LearnSettings
from deepgps.data.labels import read_places
from deepgps.methods.fit import fit_method
from sim.alignment import fit_alignment
from sim.apriltag.bundle_adjustment import TagMap, find_level, flatten, write_labels
from sim.errors import WorkError
from sim.recording.collect import collect
from sim.recording.format import check_recording, open_labels, open_recording, open_truth
from sim.settings import CameraSettings, DriveSettings, GridSettings, RoomSettings, SimSettings, TagCameraSettings
from tests.helpers.synthetic_tags import CAMERA, make_scene
from tests.helpers.toy import make_toy

LAB = SimSettings(
    room=RoomSettings(kind="lab", seed=10),
    camera=CameraSettings(rings=8, sectors=32, face_px=16),
    tag_camera=TagCameraSettings(mounted=True, kept=True),
    drive=DriveSettings(samples=80, strategy="endpoint", lengths="random", longest_m=2.0),
    grid=GridSettings(held_out=20),
)


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("lab") / "recording"
    collect(LAB, 10, folder, lambda *_: None, workers=1)
    return folder


@pytest.mark.slow
def test_labels_agree_with_the_truth_up_to_a_motion_and_are_all_that_is_learned(lab: Path):
    labels, truth, recording = open_labels(lab), open_truth(lab), open_recording(lab)
    assert labels is not None
    check_recording(lab)
    known = np.isfinite(labels.pose[:, 0])
    assert 0.5 < known.mean() <= 1.0
    alignment = fit_alignment(labels.pose[known, :2], truth.pose[known, :2], "SE2")
    error = np.linalg.norm(alignment.apply(labels.pose[known, :2]) - truth.pose[known, :2], axis=1)
    assert np.median(error) < 0.005
    turn = np.exp(1j * (truth.pose[known, 2] - labels.pose[known, 2]))
    assert np.abs(np.angle(turn / turn.mean())).max() < 0.1
    test = labels.test_pose[:, 0]
    seen = np.isfinite(test[:, 0])
    error = np.linalg.norm(alignment.apply(test[seen, :2]) - truth.test_pose[seen, 0, :2], axis=1)
    assert np.median(error) < 0.01
    manifest = recording.manifest.model_dump()
    assert manifest["unlabelled"] == np.isnan(labels.pose[:, 0]).sum()
    assert manifest["test_unlabelled"] == np.isnan(labels.test_pose[..., 0]).sum()
    assert manifest["tags_placed"] <= 82
    index, place = read_places(recording)
    assert index.tolist() == np.flatnonzero(known).tolist()
    np.testing.assert_array_equal(place.numpy(), labels.pose[index.numpy(), :2])


@pytest.mark.slow
def test_test_samples_are_of_the_same_drive_and_the_images_are_kept(lab: Path):
    recording, truth = open_recording(lab), open_truth(lab)
    assert recording.observation.shape[0] == len(truth.pose) == 80
    assert recording.test_observation.shape[:2] == truth.test_pose.shape[:2] == (20, 1)
    assert recording.others["tag_camera"].shape == (80, 540, 960)
    assert np.load(lab / "test" / "tag_camera.npy", mmap_mode="r").shape == (20, 1, 540, 960)
    assert recording.reading[:, 1].max() < 80
    assert truth.free_space.is_free(truth.test_pose[:, 0, :2]).mean() > 0.9


def test_places_are_those_of_labels_where_there_are_any_and_else_of_the_truth(tmp_path: Path):
    toy = make_toy(tmp_path / "toy", samples=60)
    pose = open_truth(toy.folder).pose
    index, place = read_places(toy)
    assert index.tolist() == list(range(len(pose)))
    np.testing.assert_array_equal(place.numpy(), pose[:, :2])
    labels = pose + [1.0, 2.0, 0.0]
    labels[::3] = np.nan
    arrays = toy.observation, toy.reading, toy.time, toy.manifest.odometry
    folder = deepgps.write_recording(tmp_path / "lab", *arrays, kind="vector", pose=pose, labels=labels)
    index, place = read_places(open_recording(folder))
    assert index.tolist() == np.flatnonzero(np.arange(len(pose)) % 3).tolist()
    np.testing.assert_array_equal(place.numpy(), labels[index.numpy(), :2])
    learned = fit_method("knn", open_recording(folder), LearnSettings(), 0, tmp_path / "knn")
    np.testing.assert_allclose(learned(toy.observation[1:2]), labels[1:2, :2], atol=1e-3)


@pytest.mark.slow
def test_labels_of_made_up_views_place_all_tags_with_test_positions_or_without(tmp_path: Path):
    scene = make_scene(views=80)
    nothing = scene.detections.of(scene.detections.view < 0)
    counts = write_labels(tmp_path / "a", scene.detections, scene.detections, (80, 80, 1), CAMERA, np.eye(4))
    assert counts["tags_placed"] == 36
    counts = write_labels(tmp_path / "b", scene.detections, nothing, (80, 0, 1), CAMERA, np.eye(4))
    labels = open_labels(tmp_path / "b")
    assert labels is not None and labels.pose.shape == (80, 3) and labels.test_pose.shape == (0, 1, 3)
    assert counts["test_unlabelled"] == 0
    with pytest.raises(WorkError, match="labels: no test image shows tags enough to tell where it was taken"):
        write_labels(tmp_path / "c", scene.detections, nothing, (80, 1, 1), CAMERA, np.eye(4))


def test_in_the_level_frame_the_robot_stands_upright_on_the_floor():
    rng = np.random.default_rng(0)
    yaw, place = rng.uniform(-3.0, 3.0, 50), rng.uniform(-2.0, 2.0, (50, 2))
    robot = np.tile(np.eye(4), (50, 1, 1))
    robot[:, :2, :2] = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]).transpose(2, 0, 1)
    robot[:, :2, 3] = place
    leans = np.eye(4)  # how the tags' frame lies in the room
    leans[:3, :3], leans[:3, 3] = np.linalg.qr(rng.normal(size=(3, 3)))[0], rng.normal(size=3)
    leans[:3, 0] *= np.linalg.det(leans[:3, :3])
    scene = make_scene(views=1)
    level = find_level(TagMap(np.arange(36), leans @ scene.tag), leans @ robot)
    found = level @ leans @ robot
    np.testing.assert_allclose(found[:, :3, 2], np.tile([0.0, 0.0, 1.0], (50, 1)), atol=1e-9)
    np.testing.assert_allclose(found[:, 2, 3], 0.0, atol=1e-9)
    alignment = fit_alignment(flatten(found)[:, :2], place, "SE2")
    np.testing.assert_allclose(alignment.apply(flatten(found)[:, :2]), place, atol=1e-9)
    turn = np.exp(1j * (flatten(found)[:, 2] - yaw))
    np.testing.assert_allclose(turn, turn[0], atol=1e-9)
