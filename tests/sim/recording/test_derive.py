"""Deriving: the same bytes as collecting, in every world; and what does not fit is refused by its text."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from sim.errors import InputError
from sim.planar.drive import collect as collect_plane
from sim.recording import chunks
from sim.recording import collect as collecting
from sim.recording.collect import collect
from sim.recording.derive import OF_IMAGES, can_be_cut, choose_drive, derive
from sim.recording.format import check_recording, read_manifest
from sim.settings import (
    CameraMountSettings,
    DriveSettings,
    EncoderSettings,
    GridSettings,
    ImageFaultSettings,
    LandmarksSettings,
    SimSettings,
)

FAULTY = EncoderSettings(
    ticks_per_rev=128,
    radius_error_left=0.02,
    radius_error_right=-0.01,
    track_error=0.03,
    slip_per_m=0.01,
    step_noise=0.1,
    dropout=0.2,
)
PLANE = SimSettings(
    world="landmarks",
    landmarks=LandmarksSettings(count=20, segments=12),
    drive=DriveSettings(spacing_m=0.05, samples=400),
    grid=GridSettings(spacing_m=0.25, headings=2),
)
COLLECT = {"room": collect, "landmarks": collect_plane}


def quiet(label: str, done: int, total: int) -> None:
    pass


def change(settings: SimSettings, samples: int, encoder: EncoderSettings) -> SimSettings:
    drive = settings.drive.model_copy(update={"samples": samples})
    return settings.model_copy(update={"drive": drive, "encoder": encoder})


@pytest.fixture(scope="module")
def plane(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("plane") / "base"
    collect_plane(choose_drive(PLANE, 400), 0, folder, quiet)
    return folder


@pytest.fixture(scope="module")
def room(small_settings: SimSettings, tmp_path_factory: pytest.TempPathFactory) -> tuple[SimSettings, Path]:
    """Settings and recording of a drive in a room, whose chunks are small while these tests run."""
    settings = change(small_settings, 90, EncoderSettings())
    settings = settings.model_copy(update={"grid": GridSettings(spacing_m=0.6, headings=2)})
    folder = tmp_path_factory.mktemp("room") / "base"
    collect(settings, 0, folder, quiet, workers=1)
    return settings, folder


@pytest.fixture(autouse=True, scope="module")
def small_chunks() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(collecting, "CHUNK", 32)
        patch.setattr(chunks, "CHUNK", 32)
        yield


def read_what_must_agree(folder: Path) -> dict:
    """The manifest without what tells of the making."""
    manifest = read_manifest(folder).model_dump()
    making = {"collect_s", "derived_from", "samples_dropped", "times_relocated", "renderer_deaths", *OF_IMAGES}
    return {name: value for name, value in manifest.items() if name not in making}


@pytest.mark.parametrize("samples", [64, 128, 400])
@pytest.mark.parametrize("encoder", [EncoderSettings(), FAULTY], ids=["sound", "faulty"])
def test_derived_is_as_collected_in_the_plane(samples: int, encoder: EncoderSettings, plane: Path, tmp_path: Path):
    settings = change(PLANE, samples, encoder)
    collect_plane(settings, 0, tmp_path / "collected", quiet)
    derive(plane, settings, 0, tmp_path / "derived")
    assert read_what_must_agree(tmp_path / "derived") == read_what_must_agree(tmp_path / "collected")
    check_recording(tmp_path / "derived")


DARK = ImageFaultSettings(exposure=0.5, vignetting=0.3, read_noise=0.1, shot_noise=0.1, turn_deg=8.0)


@pytest.mark.slow
@pytest.mark.parametrize("samples", [70, 90])
def test_faults_of_images_are_derived_as_they_are_collected(
    samples: int, room: tuple[SimSettings, Path], tmp_path: Path
):
    drawn, base = room
    settings = change(drawn, samples, FAULTY).model_copy(update={"image_faults": DARK})
    collect(settings, 0, tmp_path / "collected", quiet, workers=1)
    derive(base, settings, 0, tmp_path / "derived")
    assert read_what_must_agree(tmp_path / "derived") == read_what_must_agree(tmp_path / "collected")
    check_recording(tmp_path / "derived")
    sound, faulty = (read_manifest(folder).sha256 for folder in (base, tmp_path / "derived"))
    assert all(sound[name] != faulty[name] for name in ("observations/fisheye.npy", "test/fisheye.npy"))
    with pytest.raises(InputError, match="has faults in its images, which cannot be taken away"):
        derive(tmp_path / "derived", change(settings, 20, FAULTY), 0, tmp_path / "again")
    with pytest.raises(InputError, match="only encoder"):
        leaning = settings.model_copy(update={"camera_mount": CameraMountSettings(roll_deg=1.0)})
        derive(base, leaning, 0, tmp_path / "again")


@pytest.mark.slow
@pytest.mark.parametrize(("samples", "encoder"), [(20, EncoderSettings()), (70, FAULTY)])
def test_derived_is_as_collected_in_a_room(
    samples: int, encoder: EncoderSettings, room: tuple[SimSettings, Path], tmp_path: Path
):
    """Of one and of several chunks, cut in the middle of a segment."""
    settings, base = change(room[0], samples, encoder), room[1]
    collect(settings, 0, tmp_path / "collected", quiet, workers=1)
    derive(base, settings, 0, tmp_path / "derived")
    assert read_what_must_agree(tmp_path / "derived") == read_what_must_agree(tmp_path / "collected")
    check_recording(tmp_path / "derived")


def test_what_is_the_same_takes_no_room_and_outlives_the_other(plane: Path, tmp_path: Path):
    collect_plane(choose_drive(PLANE, 400), 0, tmp_path / "base", quiet)
    derive(tmp_path / "base", change(PLANE, 400, FAULTY), 0, tmp_path / "derived")
    for name in ("observations/landmarks.npy", "test/landmarks.npy", "truth/pose.npy"):
        assert (tmp_path / "base" / name).samefile(tmp_path / "derived" / name)
    for path in sorted((tmp_path / "base").rglob("*.np?")):
        path.unlink()
    check_recording(tmp_path / "derived")


def test_what_a_killed_process_left_is_replaced_and_what_stands_stays(plane: Path, tmp_path: Path):
    settings, folder = change(PLANE, 64, FAULTY), tmp_path / "derived"
    (folder / "truth").mkdir(parents=True)
    (folder / "observations").mkdir()
    (folder / "observations" / "landmarks.npy").write_bytes(b"half")
    derive(plane, settings, 0, folder)
    check_recording(folder)
    written = (folder / "manifest.json").stat().st_mtime_ns
    derive(plane, settings, 0, folder)
    assert (folder / "manifest.json").stat().st_mtime_ns == written


@pytest.mark.parametrize(
    ("changes", "seed", "message"),
    [
        ({"landmarks": LandmarksSettings(count=21, segments=12)}, 0, "is a recording of another drive: only"),
        ({}, 1, "is a recording of another drive"),
        ({"drive": DriveSettings(spacing_m=0.05, samples=401)}, 0, "has 400 samples, too few for drive.samples 401"),
    ],
)
def test_what_does_not_fit_is_refused(changes: dict, seed: int, message: str, plane: Path, tmp_path: Path):
    with pytest.raises(InputError, match=message):
        derive(plane, PLANE.model_copy(update=changes), seed, tmp_path / "derived")
    assert not (tmp_path / "derived").exists()


def test_a_recording_with_losses_is_no_base(tmp_path: Path):
    collect_plane(change(PLANE, 400, FAULTY), 0, tmp_path / "base", quiet)
    with pytest.raises(InputError, match="has lost readings, whose times are not known"):
        derive(tmp_path / "base", PLANE, 0, tmp_path / "derived")


def test_a_drive_whose_tests_follow_it_is_shared_at_its_own_length_alone(tmp_path: Path):
    for name, field, value in (("grid", "held_out", 10), ("tag_camera", "mounted", True), ("lidar", "noise_m", 0.01)):
        group = getattr(PLANE, name).model_copy(update={field: value})
        assert not can_be_cut(PLANE.model_copy(update={name: group}))
    noisy = PLANE.model_copy(update={"lidar": PLANE.lidar.model_copy(update={"noise_m": 0.01})})
    collect_plane(choose_drive(noisy, 400), 0, tmp_path / "base", quiet)
    with pytest.raises(InputError, match="has 400 samples, of which 64 are no recording of their own"):
        derive(tmp_path / "base", change(noisy, 64, FAULTY), 0, tmp_path / "derived")
    derive(tmp_path / "base", change(noisy, 400, FAULTY), 0, tmp_path / "derived")
    check_recording(tmp_path / "derived")
