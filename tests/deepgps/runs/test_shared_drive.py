"""Runs beside each other share a drive where they may, with the bytes of a drive of their own."""

from pathlib import Path

import pytest

from deepgps.config.scenario import load_scenario
from deepgps.config.spelling import from_option
from deepgps.runs.collect import list_undriven
from deepgps.runs.inputs import digest_drive
from deepgps.runs.run_folder import default_folder
from deepgps.runs.shared_drive import find_base
from sim.files.checksums import read_json
from sim.recording.format import check_recording
from tests.helpers.command import deepgps_here

SMALL_DRIVE = ("--landmarks.segments", "30", "--grid.spacing-m", "0.5", "--drive.samples", "300")
FAULTS = ("--encoder.step-noise", "0.1", "--encoder.ticks-per-rev", "64", "--encoder.dropout", "0.1")
MAKING = ("manifest.json", "scene.glb")


def collect(*words: str, home: Path) -> Path:
    """Collect, and return the folder of the recording."""
    done = deepgps_here("collect", *words, cwd=home)
    assert done.returncode == 0, done.stderr
    return home / done.stdout.split()[-1] / "recording"


def read_files(recording: Path) -> dict[str, bytes]:
    """The files that must be equal: all but what tells of the making."""
    return {
        path.relative_to(recording).as_posix(): path.read_bytes()
        for path in recording.rglob("*")
        if path.is_file() and path.name not in MAKING
    }


@pytest.mark.parametrize(
    "change",
    [FAULTS, ("--drive.samples", "120"), ("--drive.samples", "120", *FAULTS), ("--methods", "knn")],
    ids=["encoder", "shorter", "both", "methods"],
)
def test_a_derived_drive_has_the_bytes_of_a_fresh_one(change, tmp_path, monkeypatch):
    words = ("landmarks", *SMALL_DRIVE, *change)
    fresh = collect(*words, "--out", "alone", home=tmp_path)
    base = collect("landmarks", *SMALL_DRIVE, home=tmp_path)
    with monkeypatch.context() as patch:
        patch.setattr("sim.planar.drive.collect", None)
        derived = collect(*words, home=tmp_path)
    assert derived.parent != base.parent
    assert read_files(derived) == read_files(fresh)
    own, other = read_json(fresh / "manifest.json"), read_json(derived / "manifest.json")
    assert other.pop("derived_from") in {path.name for path in tmp_path.glob("runs/drives/*/*")}
    for name in ("collect_s", "samples_dropped", "times_relocated"):
        own.pop(name, None)
        other.pop(name, None)
    assert other == own
    check_recording(derived)
    if "--drive.samples" not in change:
        pose = "truth/pose.npy"
        assert (derived / pose).stat().st_ino == (base / pose).stat().st_ino


@pytest.mark.slow
def test_a_room_is_derived_without_a_renderer_and_with_the_same_bytes(tmp_path, monkeypatch):
    room = ("tiny", "--drive.samples", "60", "--grid.spacing-m", "0.8", "--deployment.drive-samples", "30")
    change = ("--encoder.step-noise", "0.1", "--image-faults.read-noise", "0.1")
    fresh = collect(*room, *change, "--out", "alone", home=tmp_path)
    collect(*room, home=tmp_path)
    monkeypatch.setattr("deepgps.runs.collect.choose_renderer", None)
    assert read_files(collect(*room, *change, home=tmp_path)) == read_files(fresh)


def test_a_damaged_base_is_not_used(tmp_path):
    collect("landmarks", *SMALL_DRIVE, home=tmp_path)
    (stored,) = tmp_path.glob("runs/drives/*/*/reading.npy")
    stored.write_bytes(b"damaged")
    done = deepgps_here("collect", "landmarks", *SMALL_DRIVE, *FAULTS, cwd=tmp_path)
    assert done.returncode == 0
    assert "the drive is made again" in done.stderr
    (again,) = tmp_path.glob("runs/drives/*/*/manifest.json")
    check_recording(again.parent)
    check_recording(tmp_path / done.stdout.split()[-1] / "recording")


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ((), ("--seed", "1")),
        ((), ("--drive.samples", "301")),
        ((), ("--landmarks.count", "20")),
        (("--encoder.dropout", "0.1"), ()),
        (("--encoder.track-error", "0.1"), ()),
    ],
)
def test_another_drive_is_no_base(first, second, tmp_path, monkeypatch):
    collect("landmarks", *SMALL_DRIVE, *first, home=tmp_path)
    monkeypatch.chdir(tmp_path)
    words = (*SMALL_DRIVE, *second)
    overrides = {from_option(name): value for name, value in zip(words[::2], words[1::2], strict=True)}
    scenario = load_scenario("landmarks", overrides)
    assert find_base(scenario, default_folder(scenario)) is None
    assert list_undriven(scenario, default_folder(scenario), fresh=False) == [scenario]


def test_only_runs_of_the_same_folder_are_bases_and_fresh_drives_again(tmp_path, monkeypatch):
    base = collect("landmarks", *SMALL_DRIVE, home=tmp_path)
    monkeypatch.chdir(tmp_path)
    own = collect("landmarks", *SMALL_DRIVE, *FAULTS, "--out", "elsewhere", home=tmp_path)
    assert "derived_from" not in read_json(own / "manifest.json")
    again = collect("landmarks", *SMALL_DRIVE, "--fresh", home=tmp_path)
    assert again == base
    assert "derived_from" not in read_json(again / "manifest.json")


def test_a_changed_room_of_the_users_own_is_another_drive(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    digests = set()
    for text in ("<mujoco/>", "<mujoco />"):
        (tmp_path / "room.xml").write_text(text)
        digests.add(digest_drive(load_scenario("tiny", {"room.mjcf": "room.xml"}), ""))
    assert len(digests) == 2


def test_the_store_is_measured_and_emptied_and_the_runs_stay(tmp_path):
    recording = collect("landmarks", *SMALL_DRIVE, home=tmp_path)
    (tmp_path / "runs" / "drives" / "mine.txt").touch()
    assert "in runs/drives, which later runs share" in deepgps_here("runs", cwd=tmp_path).stdout
    assert deepgps_here("runs", "--empty-drives", cwd=tmp_path).returncode == 0
    assert [path.name for path in (tmp_path / "runs" / "drives").rglob("*")] == ["mine.txt"]
    check_recording(recording)
