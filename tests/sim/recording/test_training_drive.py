"""A recording that differs only in deployment or test grid shares the training drive of another, to the byte."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from sim.errors import InputError
from sim.files.checksums import FORMAT, write_json
from sim.recording import collect as collecting
from sim.recording.collect import collect
from sim.recording.derive import explain_misfit, has_same_training_drive
from sim.recording.format import check_recording, open_recording, read_manifest
from sim.settings import SimSettings
from tests.helpers.recordings import change, quiet, read_files, read_what_must_agree, small_chunks


@pytest.fixture(autouse=True, scope="module")
def drawn_here() -> Iterator[None]:
    with small_chunks():
        yield


@pytest.fixture(scope="module")
def plain(small_settings: SimSettings) -> SimSettings:
    return change(small_settings, drive={"samples": 20}, grid={"spacing_m": 0.8, "headings": 1})


@pytest.fixture(scope="module")
def base(plain: SimSettings, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("base") / "recording"
    collect(plain, 0, folder, quiet, workers=1)
    return folder


@pytest.mark.parametrize(
    "groups",
    [
        pytest.param({"deployment": {"light": 0.3, "moved_m": 0.3}}, marks=pytest.mark.slow),
        {"grid": {"spacing_m": 0.6, "headings": 2}},
        pytest.param({"deployment": {"drive_samples": 16, "camera_mount": {"roll_deg": 4.0}}}, marks=pytest.mark.slow),
    ],
    ids=["light and furniture", "grid", "deployment drive"],
)
def test_the_shared_drive_has_the_bytes_of_one_of_its_own(groups, plain, base, tmp_path, monkeypatch):
    settings = change(plain, **groups)
    assert has_same_training_drive(base, settings, 0)
    collect(settings, 0, tmp_path / "alone", quiet, workers=1)
    driven, drive_chunk = [], collecting.drive_chunk
    monkeypatch.setattr(collecting, "drive_chunk", lambda *args: driven.append(args[1]) or drive_chunk(*args))
    collect(settings, 0, tmp_path / "shared", quiet, workers=1, base=base)
    assert not any(one.drive.samples == 20 for one in driven), "only the deployment drive is driven"
    check_recording(tmp_path / "shared")
    assert read_files(tmp_path / "shared") == read_files(tmp_path / "alone")
    assert read_what_must_agree(tmp_path / "shared") == read_what_must_agree(tmp_path / "alone")
    pose = "truth/pose.npy"
    assert (tmp_path / "shared" / pose).stat().st_ino == (base / pose).stat().st_ino
    assert (read_manifest(tmp_path / "shared").model_extra or {})["derived_from"] == base.parent.name


def test_only_what_is_drawn_needs_space_and_renderers(plain, base, tmp_path, monkeypatch):
    spaces, images = [], []
    monkeypatch.setattr(collecting, "check_space", lambda _, needed: spaces.append(needed))
    monkeypatch.setattr(collecting, "count_renderers", lambda count: images.append(count) or 1)
    collect(change(plain, deployment={"light": 0.3}), 0, tmp_path / "shared", quiet, base=base)
    tests = open_recording(tmp_path / "shared").test_observation
    assert images == [np.prod(tests.shape[:2])]
    assert spaces == [2 * tests.nbytes]  # in a part, and in the recording


def test_another_training_drive_seed_or_world_is_not_shared(plain, base):
    assert has_same_training_drive(base, plain, 0)
    assert not has_same_training_drive(base, plain, 1)
    assert not has_same_training_drive(base, plain.model_copy(update={"world": "landmarks"}), 0)
    for groups in (
        {"encoder": {"step_noise": 0.1}},
        {"drive": {"samples": 40}},
        {"camera_mount": {"roll_deg": 1.0}},
        {"image_faults": {"exposure": 0.5}},
        {"grid": {"held_out": 5}},
    ):
        assert not has_same_training_drive(base, change(plain, **groups), 0), groups


def test_settings_that_cannot_be_used_are_one_clear_line(plain, tmp_path):
    for settings, message in (
        ({"drive": {"samples": "many"}}, "manifest: settings.drive.samples cannot be used"),
        ({"world": "landmarks", "grid": {"held_out": 5}}, "manifest: settings cannot be used: .* needs world room"),
    ):
        write_json(tmp_path / "manifest.json", {"format": FORMAT, "seed": 0, "settings": settings})
        for compare in (has_same_training_drive, explain_misfit):
            with pytest.raises(InputError, match=message):
                compare(tmp_path, plain, 0)


def test_cut_off_it_continues_to_the_same_bytes(plain, base, tmp_path, monkeypatch):
    settings = change(plain, deployment={"light": 0.3})
    collect(settings, 0, tmp_path / "alone", quiet, workers=1)
    with monkeypatch.context() as patch:
        patch.setattr(collecting, "add_checksums", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            collect(settings, 0, tmp_path / "shared", quiet, workers=1, base=base)
    collect(settings, 0, tmp_path / "shared", quiet, workers=1, base=base)
    assert read_files(tmp_path / "shared") == read_files(tmp_path / "alone")
    check_recording(base)
