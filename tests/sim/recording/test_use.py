"""The deployment drive: a recording of its own inside the training drive's, which stays as it was; changing light."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from sim.errors import DamagedError, InputError
from sim.recording import collect as collecting
from sim.recording.collect import collect
from sim.recording.derive import derive, explain_misfit
from sim.recording.format import (
    DEPLOYMENT_MANIFEST,
    check_recording,
    is_whole,
    open_recording,
    open_truth,
    read_manifest,
    remove_recording,
    work_folder,
)
from sim.recording.manifest import LIGHT_STATES, choose_deployment, light_part, seed_deployment
from sim.settings import CameraMountSettings, DeploymentSettings, DriveSettings, GridSettings, SimSettings
from tests.helpers.recordings import change, quiet, read_files, read_what_must_agree, small_chunks

SAMPLES, DRIVE_SAMPLES = 26, 20
IMAGES = {"test/fisheye.npy", "use/observations/fisheye.npy", "use/observations/fisheye_turn.npy"}
Sound = tuple[SimSettings, Path]


def leave_out_use(files: dict[str, bytes]) -> dict[str, bytes]:
    return {name: data for name, data in files.items() if not name.startswith("use/")}


@pytest.fixture(autouse=True, scope="module")
def drawn_here() -> Iterator[None]:
    with small_chunks(16):
        yield


@pytest.fixture(scope="module")
def plain(small_settings: SimSettings) -> SimSettings:
    drive = DriveSettings(samples=SAMPLES, longest_m=0.5)  # so that each drive has two chunks
    return change(small_settings, drive=drive, grid=GridSettings(spacing_m=0.8, headings=1))


@pytest.fixture(scope="module")
def sound(plain: SimSettings, tmp_path_factory: pytest.TempPathFactory) -> Sound:
    """Settings and recording with a deployment drive and no change between training and deployment."""
    settings = change(plain, deployment={"drive_samples": DRIVE_SAMPLES})
    folder = tmp_path_factory.mktemp("sound") / "recording"
    collect(settings, 0, folder, quiet, workers=1)
    return settings, folder


@pytest.mark.slow  # quick: derived without a deployment drive
def test_the_training_drive_is_the_same_with_and_without_a_deployment_drive(plain, sound, tmp_path):
    stages = dict.fromkeys(["drive", "render"])
    collect(plain, 0, tmp_path / "plain", lambda stage, *_: stages.pop(stage, None), workers=1)
    assert stages == {}
    assert leave_out_use(read_files(sound[1])) == read_files(tmp_path / "plain")
    assert not is_whole(tmp_path / "plain" / "use")


def test_the_deployment_drive_is_a_recording_of_its_own(sound):
    settings, folder = sound
    check_recording(folder)
    assert is_whole(folder) and not work_folder(folder).exists() and not (folder / "use.collecting").exists()
    recording, truth = open_recording(folder / "use"), open_truth(folder / "use")
    assert recording.observation.shape == (DRIVE_SAMPLES, 8, 32, 3)
    assert recording.test_observation.shape == (0, 1, 8, 32, 3) and truth.test_pose.shape == (0, 1, 3)
    assert recording.turn_observation is not None and len(recording.turn_observation) > 0
    assert set(recording.reading[:, 1]) == set(range(DRIVE_SAMPLES))
    assert truth.free_space.is_free(truth.pose[:, :2]).all()
    manifest = recording.manifest
    assert manifest.settings == choose_deployment(settings).model_dump(mode="json")
    assert manifest.seed == seed_deployment(0) != seed_deployment(1)
    outer = read_manifest(folder).sha256
    assert [name for name in outer if name.startswith("use/")] == [DEPLOYMENT_MANIFEST]
    driven = open_truth(folder).pose
    assert not np.isclose(truth.pose[:DRIVE_SAMPLES, 2], driven[:DRIVE_SAMPLES, 2]).any(), (
        "its headings are drawn from other streams"
    )


def test_it_is_the_recording_that_its_own_settings_and_seed_make(sound, tmp_path):
    """Nothing but settings and seed determines it, as long as the room is that of training."""
    settings, folder = sound
    collect(choose_deployment(settings), seed_deployment(0), tmp_path / "own", quiet, workers=1)
    alone, inner = read_files(tmp_path / "own"), read_files(folder / "use")
    assert {name for name in alone if alone[name] != inner[name]} == {"test/fisheye.npy", "truth/test_pose.npy"}


def test_damage_in_it_is_found(sound, tmp_path):
    settings, folder = sound
    derive(folder, settings, 0, tmp_path / "copy")
    path = tmp_path / "copy" / "use" / "reading.npy"
    path.write_bytes(path.read_bytes()[:-1])
    open_recording(tmp_path / "copy")
    with pytest.raises(DamagedError, match=r"use/reading\.npy is damaged"):
        check_recording(tmp_path / "copy")


def test_less_light_and_a_lean_in_deployment_change_its_images_and_no_training_image(plain, sound, tmp_path):
    changes = {"drive_samples": DRIVE_SAMPLES, "light": 0.2, "camera_mount": {"roll_deg": 5.0}}
    collect(change(plain, deployment=changes), 0, tmp_path / "dark", quiet, workers=1)
    dark, light = read_files(tmp_path / "dark"), read_files(sound[1])
    differ = {name for name in light if dark[name] != light[name]}
    scenes = {name for name in differ if name.endswith("scene.glb")}
    assert differ - scenes == IMAGES and scenes <= {"use/scene.glb"}
    seen, before = (open_recording(folder / "use").observation for folder in (tmp_path / "dark", sound[1]))
    assert (seen.mean(axis=(1, 2, 3)) < 0.7 * before.mean(axis=(1, 2, 3))).all()


def test_faults_of_images_in_deployment_alone_change_no_training_image(plain, sound, tmp_path):
    for name, faults, more in (
        ("derived", {"read_noise": 0.1, "hidden_deg": 45.0}, {}),
        ("rendered", {"glare": 0.1, "jpeg_kb": 10.0}, {"person": 3, "camera_mount": {"wobble_deg": 2.0}}),
    ):
        settings = change(plain, deployment={"drive_samples": DRIVE_SAMPLES, "image_faults": faults, **more})
        collect(settings, 0, tmp_path / name, quiet, workers=1)
        faulty, clean = read_files(tmp_path / name), read_files(sound[1])
        assert {file for file in clean if faulty[file] != clean[file] and not file.endswith("scene.glb")} == IMAGES
        assert (explain_misfit(sound[1], settings, 0) is None) == (not more)
    assert "cannot be taken away" in (explain_misfit(tmp_path / "derived", plain, 0) or "")


def test_what_the_mount_leaves_open_is_as_in_training(plain):
    changes = {"camera_mount": {"pitch_deg": 0.0}, "image_faults": {"glare": 0.0}, "light": 0.5, "drive_samples": 20}
    training = {"camera_mount": {"roll_deg": 1.0, "pitch_deg": 2.0}, "image_faults": {"glare": 0.1, "jpeg_kb": 9.0}}
    used = choose_deployment(change(plain, **training, deployment=changes))
    assert used.camera_mount == CameraMountSettings(roll_deg=1.0, pitch_deg=0.0)
    assert used.image_faults == plain.image_faults.model_copy(update={"jpeg_kb": 9.0})
    assert used.deployment == DeploymentSettings(light=0.5)
    assert used.drive.samples == 20


@pytest.mark.parametrize(
    ("samples", "deployed"),
    [(17, 18), pytest.param(SAMPLES, DRIVE_SAMPLES, marks=pytest.mark.slow)],
    ids=["shorter", "whole"],
)
def test_derived_is_as_collected(samples: int, deployed: int, sound, tmp_path):
    settings = change(
        sound[0],
        drive={"samples": samples},
        encoder={"ticks_per_rev": 128, "step_noise": 0.1, "dropout": 0.2},
        image_faults={"exposure": 0.5, "read_noise": 0.1},
        deployment={"drive_samples": deployed, "image_faults": {"read_noise": 0.2, "hidden_deg": 45.0}},
    )
    collect(settings, 0, tmp_path / "collected", quiet, workers=1)
    derive(sound[1], settings, 0, tmp_path / "derived")
    check_recording(tmp_path / "derived")
    assert read_files(tmp_path / "derived") == read_files(tmp_path / "collected")
    for part in (".", "use"):
        one, other = (read_what_must_agree(tmp_path / name / part) for name in ("derived", "collected"))
        assert one == other
    inner = read_manifest(tmp_path / "derived" / "use")
    assert inner.readings_lost > 0
    assert (inner.model_extra or {})["derived_from"] == sound[1].parent.name


def test_without_a_deployment_drive_none_is_derived(plain, sound, tmp_path):
    derive(sound[1], plain, 0, tmp_path / "derived")
    assert read_files(tmp_path / "derived") == leave_out_use(read_files(sound[1]))
    assert DEPLOYMENT_MANIFEST not in read_manifest(tmp_path / "derived").sha256
    with pytest.raises(InputError, match=r"has no deployment drive, and deployment\.drive_samples is 20"):
        derive(tmp_path / "derived", sound[0], 0, tmp_path / "again")


def test_what_does_not_fit_is_no_base(plain, sound):
    another = "is a recording of another drive"
    for deployment, message in (
        ({"drive_samples": 21}, "has a deployment drive that has 20 samples, too few for deployment.drive_samples 21"),
        ({"drive_samples": DRIVE_SAMPLES, "light": 0.5}, another),
        ({"drive_samples": DRIVE_SAMPLES, "camera_mount": {"roll_deg": 1.0}}, another),
    ):
        assert message in (explain_misfit(sound[1], change(plain, deployment=deployment), 0) or "")


@pytest.mark.slow  # quick: test_collect's cut off
@pytest.mark.parametrize("chunk", [2, 4], ids=["in deployment", "in training"])
def test_cut_off_anywhere_it_continues_to_the_same_bytes(chunk: int, sound, tmp_path, monkeypatch):
    """Stopped before a second chunk: of the deployment drive, or of the training drive."""
    settings, folder = sound[0], tmp_path / "recording"
    drive_chunk, calls = collecting.drive_chunk, iter(range(1, 100))

    def stop(*args):
        if next(calls) == chunk:
            raise KeyboardInterrupt
        return drive_chunk(*args)

    with monkeypatch.context() as patch:
        patch.setattr(collecting, "drive_chunk", stop)
        with pytest.raises(KeyboardInterrupt):
            collect(settings, 0, folder, quiet, workers=1)
    kept = [folder / "use" / "manifest.json", work_folder(folder) / "use" / "drive-000000.npz"][chunk == 2]
    made = kept.stat().st_mtime_ns
    stages, driven = set(), []

    def drive_on(*args):
        driven.append(kept.exists() and kept.stat().st_mtime_ns)
        return drive_chunk(*args)

    monkeypatch.setattr(collecting, "drive_chunk", drive_on)
    collect(settings, 0, folder, lambda stage, *_: stages.add(stage), workers=1)
    assert driven[0] == made, "what was made is kept"
    assert len(driven) == {2: 3, 4: 1}[chunk]
    assert stages == {"drive", "render"} | ({"drive in deployment", "render in deployment"} if chunk == 2 else set())
    assert read_files(folder) == read_files(sound[1])
    assert not work_folder(folder).exists()


def test_removing_takes_our_files_and_leaves_others(sound, tmp_path):
    folder = tmp_path / "recording"
    derive(sound[1], sound[0], 0, folder)
    parts = work_folder(folder) / "use" / "drive-000000.npz"
    parts.parent.mkdir(parents=True)
    parts.write_bytes(b"a part")
    theirs = folder / "use" / "thesis.npy"
    theirs.write_text("a user's")
    remove_recording(folder)
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == [theirs]


def test_a_lidar_has_a_deployment_drive_beside_held_out_tests(plain, tmp_path):
    settings = change(
        plain, sensor="lidar", drive={"samples": 16}, grid={"held_out": 5}, deployment={"drive_samples": 16}
    )
    collect(settings, 0, tmp_path / "lidar", quiet, workers=1)
    check_recording(tmp_path / "lidar")
    assert open_truth(tmp_path / "lidar").test_pose.shape == (5, 1, 3)
    recording = open_recording(tmp_path / "lidar" / "use")
    assert len(recording.observation) == 16 and recording.test_observation.shape[:2] == (0, 1)


@pytest.mark.slow  # quick: light takes turns
def test_the_same_drive_is_seen_in_changing_light(small_settings, tmp_path):
    plain = change(small_settings, drive={"samples": 60, "longest_m": 0.5}, grid={"spacing_m": 1.0, "headings": 1})
    with small_chunks(16):
        collect(plain, 0, tmp_path / "plain", quiet, workers=1)
        collect(change(plain, drive={"mixed_light": True}), 0, tmp_path / "mixed", quiet, workers=1)
    steady, changing = open_recording(tmp_path / "plain"), open_recording(tmp_path / "mixed")
    assert np.array_equal(steady.reading, changing.reading)
    same = (steady.observation == changing.observation).all(axis=(1, 2, 3))
    assert same[:16].all() and 0.1 < same.mean() < 0.6
    assert np.array_equal(steady.test_observation, changing.test_observation)  # tests are in the light of use


def test_light_takes_turns_in_a_room_with_a_camera(plain):
    mixed = change(plain, drive={"mixed_light": True})
    assert [light_part(mixed, number).deployment for number in range(6)] == [*LIGHT_STATES, *LIGHT_STATES[:2]]
    assert light_part(plain, 1) is plain
    assert not choose_deployment(mixed).drive.mixed_light
    crowd = change(plain, drive={"mixed_light": True, "person": 2})
    assert [light_part(crowd, part).deployment.person for part in (0, 1)] == [2, 2]
    assert choose_deployment(crowd).drive == choose_deployment(plain).drive
    for settings, message in (
        ({"drive": {"mixed_light": True}}, r"drive\.mixed_light needs world room and sensor fisheye"),
        ({"drive": {"person": 1}}, r"drive\.person needs world room and sensor fisheye"),
        ({"deployment": {"person": True}}, "deployment changes what a camera sees"),
    ):
        with pytest.raises(ValidationError, match=message):
            SimSettings.model_validate({"sensor": "lidar", **settings})
