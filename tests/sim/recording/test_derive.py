"""Deriving: the same bytes as collecting, here in a plane; and what does not fit is refused by its text."""

from pathlib import Path

import pytest

from sim.errors import InputError
from sim.planar.drive import collect as collect_plane
from sim.recording.derive import can_be_cut, choose_drive, derive
from sim.recording.format import check_recording
from sim.settings import DriveSettings, GridSettings, LandmarksSettings, SimSettings
from tests.helpers.recordings import change, quiet, read_what_must_agree

FAULTY_CHANGES = {
    **{"ticks_per_rev": 128, "radius_error_left": 0.02, "radius_error_right": -0.01, "track_error": 0.03},
    **{"slip_per_m": 0.01, "step_noise": 0.1, "dropout": 0.2},
}
PLANE = SimSettings(
    world="landmarks",
    landmarks=LandmarksSettings(count=20, segments=12),
    drive=DriveSettings(spacing_m=0.05, samples=400),
    grid=GridSettings(spacing_m=0.25, headings=2),
)


def drive(settings: SimSettings, samples: int, **encoder: float) -> SimSettings:
    return change(settings, drive={"samples": samples}, encoder=encoder)


@pytest.fixture(scope="module")
def plane(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("plane") / "base"
    collect_plane(choose_drive(PLANE, 400), 0, folder, quiet)
    return folder


def assert_derived_is_as_collected(base: Path, settings: SimSettings, folder: Path) -> None:
    collect_plane(settings, 0, folder / "collected", quiet)
    derive(base, settings, 0, folder / "derived")
    assert read_what_must_agree(folder / "derived") == read_what_must_agree(folder / "collected")
    check_recording(folder / "derived")


@pytest.mark.parametrize("samples", [64, 128, 400])
def test_derived_is_as_collected_in_the_plane(samples: int, plane: Path, tmp_path: Path):
    assert_derived_is_as_collected(plane, drive(PLANE, samples), tmp_path / "sound")
    assert_derived_is_as_collected(plane, drive(PLANE, samples, **FAULTY_CHANGES), tmp_path / "faulty")


def test_what_is_the_same_takes_no_room_and_outlives_the_other(plane: Path, tmp_path: Path):
    collect_plane(choose_drive(PLANE, 400), 0, tmp_path / "base", quiet)
    derive(tmp_path / "base", drive(PLANE, 400, **FAULTY_CHANGES), 0, tmp_path / "derived")
    for name in ("observations/landmarks.npy", "test/landmarks.npy", "truth/pose.npy"):
        assert (tmp_path / "base" / name).samefile(tmp_path / "derived" / name)
    for path in sorted((tmp_path / "base").rglob("*.np?")):
        path.unlink()
    check_recording(tmp_path / "derived")


def test_what_a_killed_process_left_is_replaced_and_what_stands_stays(plane: Path, tmp_path: Path):
    settings, folder = drive(PLANE, 64, **FAULTY_CHANGES), tmp_path / "derived"
    (folder / "truth").mkdir(parents=True)
    (folder / "observations").mkdir()
    (folder / "observations" / "landmarks.npy").write_bytes(b"half")
    derive(plane, settings, 0, folder)
    check_recording(folder)
    written = (folder / "manifest.json").stat().st_mtime_ns
    derive(plane, settings, 0, folder)
    assert (folder / "manifest.json").stat().st_mtime_ns == written


def test_what_does_not_fit_is_refused(plane: Path, tmp_path: Path):
    for changes, seed, message in (
        ({"landmarks": {"count": 21}}, 0, "is a recording of another drive: only"),
        ({}, 1, "is a recording of another drive"),
        ({"drive": {"samples": 401}}, 0, "has 400 samples, too few for drive.samples 401"),
    ):
        with pytest.raises(InputError, match=message):
            derive(plane, change(PLANE, **changes), seed, tmp_path / "derived")
        assert not (tmp_path / "derived").exists()


def test_a_recording_with_losses_is_no_base(tmp_path: Path):
    collect_plane(drive(PLANE, 400, **FAULTY_CHANGES), 0, tmp_path / "base", quiet)
    with pytest.raises(InputError, match="has lost readings, whose times are not known"):
        derive(tmp_path / "base", PLANE, 0, tmp_path / "derived")


def test_a_drive_whose_tests_follow_it_is_shared_at_its_own_length_alone(tmp_path: Path):
    noisy = change(PLANE, lidar={"noise_m": 0.01})
    held_out = SimSettings(grid=GridSettings(held_out=10))
    tags = SimSettings.model_validate({"room": {"kind": "lab"}, "tag_camera": {"mounted": True}})
    assert can_be_cut(PLANE) and not any(map(can_be_cut, (noisy, held_out, tags)))
    collect_plane(choose_drive(noisy, 400), 0, tmp_path / "base", quiet)
    with pytest.raises(InputError, match="has 400 samples, of which 64 are no recording of their own"):
        derive(tmp_path / "base", drive(noisy, 64, **FAULTY_CHANGES), 0, tmp_path / "derived")
    derive(tmp_path / "base", drive(noisy, 400, **FAULTY_CHANGES), 0, tmp_path / "derived")
    check_recording(tmp_path / "derived")
