"""The drive in use: a recording of its own inside that of the training drive, which stays as it was."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from sim.errors import DamagedError, InputError
from sim.recording import chunks
from sim.recording import collect as collecting
from sim.recording.collect import collect
from sim.recording.derive import OF_IMAGES, derive, explain_misfit
from sim.recording.format import (
    OF_USE,
    check_recording,
    is_whole,
    open_recording,
    open_truth,
    read_manifest,
    remove_recording,
    work_folder,
)
from sim.recording.manifest import choose_drive_in_use, seed_in_use
from sim.settings import (
    CameraMountSettings,
    DeploymentMountSettings,
    DeploymentSettings,
    DriveSettings,
    EncoderSettings,
    GridSettings,
    ImageFaultSettings,
    SimSettings,
)

SAMPLES, IN_USE = 50, 40
FAULTY = EncoderSettings(ticks_per_rev=128, step_noise=0.1, dropout=0.2)
NOISY = ImageFaultSettings(exposure=0.5, read_noise=0.1)
MAKING = {"collect_s", "derived_from", "samples_dropped", "times_relocated", "renderer_deaths", *OF_IMAGES}
Make = Callable[..., tuple[SimSettings, Path]]


def quiet(label: str, done: int, total: int) -> None:
    pass


def change(settings: SimSettings, **deployment: object) -> SimSettings:
    return settings.model_copy(update={"deployment": DeploymentSettings.model_validate(deployment)})


def read_arrays(folder: Path) -> dict[str, bytes]:
    """All files but the manifests, by their paths in the recording."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != "manifest.json"
    }


def leave_out_use(files: dict[str, bytes]) -> dict[str, bytes]:
    return {name: data for name, data in files.items() if not name.startswith("use/")}


def read_what_must_agree(folder: Path) -> dict:
    """The manifest without what tells of the making."""
    manifest = {name: value for name, value in read_manifest(folder).model_dump().items() if name not in MAKING}
    manifest["sha256"].pop(OF_USE, None)  # which tells of the making, too
    return manifest


@pytest.fixture(autouse=True, scope="module")
def small_chunks() -> object:
    """Chunks so small that each drive has two."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(collecting, "CHUNK", 32)
        patch.setattr(chunks, "CHUNK", 32)
        yield


@pytest.fixture(scope="module")
def plain(small_settings: SimSettings) -> SimSettings:
    drive = DriveSettings(samples=SAMPLES, longest_m=0.5)  # so that each drive has two chunks
    return small_settings.model_copy(update={"drive": drive, "grid": GridSettings(spacing_m=0.8, headings=1)})


@pytest.fixture(scope="module")
def sound(plain: SimSettings, tmp_path_factory: pytest.TempPathFactory) -> tuple[SimSettings, Path]:
    """Settings and recording with a drive in use and no change between training and use."""
    settings, folder = change(plain, drive_samples=IN_USE), tmp_path_factory.mktemp("sound") / "recording"
    collect(settings, 0, folder, quiet, workers=1)
    return settings, folder


@pytest.mark.slow
def test_the_training_drive_is_the_same_with_and_without_a_drive_in_use(plain, sound, tmp_path):
    stages = dict.fromkeys(["drive", "render"])
    collect(plain, 0, tmp_path / "plain", lambda stage, *_: stages.pop(stage, None), workers=1)
    assert stages == {}
    assert leave_out_use(read_arrays(sound[1])) == read_arrays(tmp_path / "plain")
    assert not is_whole(tmp_path / "plain" / "use")


def test_the_drive_in_use_is_a_recording_of_its_own(sound):
    settings, folder = sound
    check_recording(folder)
    assert is_whole(folder) and not work_folder(folder).exists() and not (folder / "use.collecting").exists()
    recording, truth = open_recording(folder / "use"), open_truth(folder / "use")
    assert recording.observation.shape == (IN_USE, 8, 32, 3)
    assert recording.test_observation.shape == (0, 1, 8, 32, 3) and truth.test_pose.shape == (0, 1, 3)
    assert recording.turn_observation is not None and len(recording.turn_observation) > 0
    assert set(recording.reading[:, 1]) == set(range(IN_USE))
    assert truth.free_space.is_free(truth.pose[:, :2]).all()
    manifest = recording.manifest
    assert manifest.settings == choose_drive_in_use(settings).model_dump(mode="json")
    assert manifest.seed == seed_in_use(0) != seed_in_use(1)
    outer = read_manifest(folder).sha256
    assert [name for name in outer if name.startswith("use/")] == [OF_USE]
    driven = open_truth(folder).pose
    assert not np.isclose(truth.pose[:IN_USE, 2], driven[:IN_USE, 2]).any(), "its headings are drawn from other streams"


def test_it_is_the_recording_that_its_own_settings_and_seed_make(sound, tmp_path):
    """Nothing but settings and seed determines it, as long as the room is that of training."""
    settings, folder = sound
    own = choose_drive_in_use(settings)
    collect(own, seed_in_use(0), tmp_path / "own", quiet, workers=1)
    unlike = {"test/fisheye.npy", "truth/test_pose.npy"}
    alone, inner = read_arrays(tmp_path / "own"), read_arrays(folder / "use")
    assert {name for name in alone if alone[name] != inner[name]} == unlike


def test_damage_in_it_is_found(sound, tmp_path):
    settings, folder = sound
    derive(folder, settings, 0, tmp_path / "copy")
    path = tmp_path / "copy" / "use" / "reading.npy"
    path.write_bytes(path.read_bytes()[:-1])
    open_recording(tmp_path / "copy")
    with pytest.raises(DamagedError, match=r"use/reading\.npy is damaged"):
        check_recording(tmp_path / "copy")


def test_less_light_in_use_darkens_it_and_no_training_image(plain, sound, tmp_path):
    settings = change(plain, drive_samples=IN_USE, light=0.2)
    collect(settings, 0, tmp_path / "dark", quiet, workers=1)
    dark, light = read_arrays(tmp_path / "dark"), read_arrays(sound[1])
    differ = {name for name in light if dark[name] != light[name]}
    images = {"test/fisheye.npy", "use/observations/fisheye.npy", "use/observations/fisheye_turn.npy"}
    scenes = {name for name in differ if name.endswith("scene.glb")}
    assert differ - scenes == images and scenes <= {"use/scene.glb"}
    seen, before = (open_recording(folder / "use").observation for folder in (tmp_path / "dark", sound[1]))
    assert (seen.mean(axis=(1, 2, 3)) < 0.7 * before.mean(axis=(1, 2, 3))).all()


def test_a_camera_that_leans_in_use_leans_in_tests_and_in_the_drive_in_use_alone(plain, sound, tmp_path):
    settings = change(plain, drive_samples=IN_USE, camera_mount={"roll_deg": 5.0})
    collect(settings, 0, tmp_path / "leaning", quiet, workers=1)
    leaning, level = read_arrays(tmp_path / "leaning"), read_arrays(sound[1])
    images = {"test/fisheye.npy", "use/observations/fisheye.npy", "use/observations/fisheye_turn.npy"}
    assert {name for name in level if leaning[name] != level[name]} == images


def test_what_the_mount_leaves_open_is_as_in_training(plain):
    trained = plain.model_copy(update={"camera_mount": CameraMountSettings(roll_deg=1.0, pitch_deg=2.0)})
    change_to = DeploymentSettings(camera_mount=DeploymentMountSettings(pitch_deg=0.0), light=0.5, drive_samples=20)
    used = choose_drive_in_use(trained.model_copy(update={"deployment": change_to}))
    assert used.camera_mount == CameraMountSettings(roll_deg=1.0, pitch_deg=0.0)
    assert used.deployment == DeploymentSettings(light=0.5)
    assert used.drive.samples == 20


@pytest.mark.parametrize(("samples", "in_use"), [(SAMPLES, IN_USE), (20, 33)], ids=["whole", "shorter"])
def test_derived_is_as_collected(samples: int, in_use: int, sound, tmp_path):
    settings = sound[0].model_copy(
        update={
            "drive": sound[0].drive.model_copy(update={"samples": samples}),
            "encoder": FAULTY,
            "image_faults": NOISY,
            "deployment": DeploymentSettings(drive_samples=in_use),
        }
    )
    collect(settings, 0, tmp_path / "collected", quiet, workers=1)
    derive(sound[1], settings, 0, tmp_path / "derived")
    check_recording(tmp_path / "derived")
    assert read_arrays(tmp_path / "derived") == read_arrays(tmp_path / "collected")
    for part in (".", "use"):
        one, other = (read_what_must_agree(tmp_path / name / part) for name in ("derived", "collected"))
        assert one == other
    inner = read_manifest(tmp_path / "derived" / "use")
    assert inner.readings_lost > 0
    assert (inner.model_extra or {})["derived_from"] == sound[1].parent.name


def test_without_a_drive_in_use_none_is_derived(plain, sound, tmp_path):
    derive(sound[1], plain, 0, tmp_path / "derived")
    assert read_arrays(tmp_path / "derived") == leave_out_use(read_arrays(sound[1]))
    assert OF_USE not in read_manifest(tmp_path / "derived").sha256
    with pytest.raises(InputError, match=r"has no drive in use, and deployment\.drive_samples is 40"):
        derive(tmp_path / "derived", sound[0], 0, tmp_path / "again")


@pytest.mark.parametrize(
    ("deployment", "message"),
    [
        ({"drive_samples": 41}, "has a drive in use that has 40 samples, too few for deployment.drive_samples 41"),
        ({"drive_samples": IN_USE, "light": 0.5}, "is a recording of another drive"),
        ({"drive_samples": IN_USE, "camera_mount": {"roll_deg": 1.0}}, "is a recording of another drive"),
    ],
)
def test_what_does_not_fit_is_no_base(deployment, message, plain, sound):
    assert message in (explain_misfit(sound[1], change(plain, **deployment), 0) or "")


@pytest.mark.slow
@pytest.mark.parametrize("chunk", [2, 4], ids=["in use", "in training"])
def test_cut_off_anywhere_it_continues_to_the_same_bytes(chunk: int, sound, tmp_path, monkeypatch):
    """Stopped before a second chunk: of the drive in use, or of the training drive."""
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
    assert stages == {"drive", "render"} | ({"drive in use", "render in use"} if chunk == 2 else set())
    assert read_arrays(folder) == read_arrays(sound[1])
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


def test_a_lidar_has_a_drive_in_use_beside_held_out_tests(plain, tmp_path):
    settings = SimSettings.model_validate(
        plain.model_dump() | {"sensor": "lidar", "grid": {"held_out": 5}, "deployment": {"drive_samples": 20}}
    )
    collect(settings, 0, tmp_path / "lidar", quiet, workers=1)
    check_recording(tmp_path / "lidar")
    assert open_truth(tmp_path / "lidar").test_pose.shape == (5, 1, 3)
    recording = open_recording(tmp_path / "lidar" / "use")
    assert len(recording.observation) == 20 and recording.test_observation.shape[:2] == (0, 1)
