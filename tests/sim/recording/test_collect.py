"""Collecting: what a recording holds, and that damage, interruption and failing renderers change none of its bytes."""

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from sim.errors import InputError, WorkError
from sim.geometry import FreeSpace
from sim.recording import chunks, renderers
from sim.recording import collect as collecting
from sim.recording.chunks import sense_part
from sim.recording.collect import collect
from sim.recording.format import (
    Judge,
    Recording,
    check_recording,
    is_whole,
    open_recording,
    open_truth,
    read_manifest,
)
from sim.recording.renderers import Part, UnsteadyError
from sim.robot.world import RoomWorld
from sim.sensors.camera.faults import decode
from sim.sensors.camera.fisheye import Fisheye
from sim.sensors.encoder import ticks_to_distance
from sim.settings import GridSettings, SimSettings
from tests.helpers.recordings import change, quiet, read_files, small_chunks


@pytest.fixture(autouse=True, scope="module")
def drawn_here() -> Iterator[None]:
    with small_chunks():
        yield


def test_a_recording_is_whole(small_recording, small_settings):
    recording, truth = open_recording(small_recording), open_truth(small_recording)
    check_recording(small_recording)
    assert recording.observation.shape == (300, 8, 32, 3) and truth.pose.shape == (300, 3)
    assert recording.test_observation.shape == (*truth.test_pose.shape[:2], 8, 32, 3)
    assert [path.name for path in small_recording.parent.iterdir()] == ["recording"]
    assert recording.manifest.settings == small_settings.model_dump(mode="json")
    assert recording.manifest.gl_renderer
    assert set(recording.reading[:, 1]) == set(range(300))


def test_readings_run_in_order_turning_places_have_two_and_distances_are_true(small_recording):
    recording, truth = open_recording(small_recording), open_truth(small_recording)
    reading, odometry = recording.reading, recording.manifest.odometry
    assert (np.diff(reading[:, :2], axis=0) >= 0).all()
    assert (np.diff(recording.time) > 0).all()
    same_place = np.diff(reading[:, 1]) == 0
    assert same_place.any() and (np.diff(reading[:, 0])[same_place] == 1).all()
    wheels = ticks_to_distance(reading[:, 2:], odometry["wheel_radius_m"], odometry["ticks_per_rev"])
    travelled = wheels.mean(axis=1)
    for segment in np.unique(reading[:, 0]):
        row = np.flatnonzero(reading[:, 0] == segment)
        place = truth.pose[reading[row, 1], :2]
        driven = np.linalg.norm(place - place[0], axis=1)
        np.testing.assert_allclose(travelled[row] - travelled[row[0]], driven, atol=0.004)


def test_test_poses_are_reachable_and_on_the_grid(small_recording):
    truth = open_truth(small_recording)
    assert truth.free_space.is_reachable(truth.test_pose[..., :2]).all()
    np.testing.assert_allclose(truth.test_pose[..., :2] / 0.4, np.rint(truth.test_pose[..., :2] / 0.4), atol=1e-9)
    np.testing.assert_allclose(truth.test_pose[:, :, 2], np.broadcast_to([0.0, np.pi], truth.test_pose.shape[:2]))


def test_without_faults_an_image_is_what_the_camera_draws(small_settings, small_recording):
    recording = open_recording(small_recording)
    world = RoomWorld(small_settings)
    state = np.load(small_recording / "truth" / "state.npy")
    with Fisheye(world.model, small_settings.camera) as fisheye:
        for number in (0, 150, 299):
            world.data.qpos[:] = state[number]
            mujoco.mj_kinematics(world.model, world.data)
            np.testing.assert_array_equal(fisheye.polar(world.data), recording.observation[number])


@pytest.fixture(scope="module")
def short_settings(small_settings: SimSettings) -> SimSettings:
    return change(small_settings, drive={"samples": 60}, grid={"spacing_m": 0.6, "headings": 2})


@pytest.fixture(scope="module")
def short_recording(short_settings: SimSettings, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of a short drive, made at one go, whose parts are still there."""
    folder = tmp_path_factory.mktemp("short") / "recording"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(collecting, "remove_files", quiet)
        collect(short_settings, 0, folder, quiet, workers=1)
    return folder


@pytest.fixture
def unfinished(short_recording: Path, tmp_path: Path) -> Path:
    """A folder with the same recording under way, all of whose parts are made."""
    shutil.copytree(short_recording.parent, tmp_path, dirs_exist_ok=True)
    (tmp_path / "recording" / "manifest.json").unlink()
    return tmp_path


def sums(folder: Path) -> dict[str, str]:
    return dict(read_manifest(folder).sha256)


@pytest.mark.parametrize("workers", [None, pytest.param(2, marks=pytest.mark.slow)])
def test_cut_off_anywhere_it_continues_to_the_same_bytes(workers, short_recording, short_settings, tmp_path):
    """Stopped after the first chunk of the drive, then taken up in this process, or by two workers."""
    folder = tmp_path / "recording"
    second_chunk = collecting.drive_chunk

    def stop_at_second(world, settings, rng, before, least):
        if before is not None:
            raise KeyboardInterrupt
        return second_chunk(world, settings, rng, before, least)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(collecting, "drive_chunk", stop_at_second)
        with pytest.raises(KeyboardInterrupt):
            collect(short_settings, 0, folder, quiet, workers=1)
    assert (tmp_path / "recording.collecting" / "drive-000000.npz").is_file()
    assert not (folder / "manifest.json").exists()
    with pytest.MonkeyPatch.context() as patch:
        if workers:
            patch.setattr(collecting, "Renderers", renderers.Renderers)
        collect(short_settings, 0, folder, quiet, workers=workers)
    assert read_files(folder) == read_files(short_recording)


@pytest.mark.slow
def test_another_seed_drives_elsewhere_and_lost_readings_are_counted(small_settings, small_recording, tmp_path):
    settings = change(small_settings, drive={"samples": 60, "strategy": "endpoint"}, encoder={"dropout": 0.3})
    collect(settings, 1, tmp_path / "other", quiet, workers=1)
    other, manifest = open_recording(tmp_path / "other"), read_manifest(tmp_path / "other").model_dump()
    truth = open_truth(tmp_path / "other")
    assert len(other.reading) == manifest["readings"] - manifest["readings_lost"] < len(truth.reading)
    assert manifest["readings_lost"] > 0
    assert np.bincount(truth.reading[:, 0]).max() == 2
    assert not np.allclose(truth.pose[:50], open_truth(small_recording).pose[:50])


def flip(path: Path) -> None:
    """Flip a bit of a part's first array."""
    data = bytearray(path.read_bytes())
    data[len(data) // 10] ^= 1
    path.write_bytes(data)


def collect_again(settings: SimSettings, folder: Path) -> dict[str, Any]:
    """Make a recording from what there is of its parts; returns its manifest."""
    collect(settings, 0, folder / "recording", quiet, workers=1)
    assert not any(name.name != "thesis.npy" for name in (folder / "recording.collecting").glob("*"))
    return read_manifest(folder / "recording").model_dump()


def test_damaged_parts_are_made_again_to_the_same_bytes_and_files_of_others_stay(
    unfinished, short_settings, short_recording, tmp_path, caplog
):
    theirs = [tmp_path / name for name in ("recording/thesis.npy", "recording.collecting/thesis.npy")]
    for path in theirs:
        path.write_text("a user's")
    parts = tmp_path / "recording.collecting"
    flip(parts / "drive-000000.npz")
    (parts / "image-000001.npz").write_bytes((parts / "image-000001.npz").read_bytes()[:-1])
    flip(parts / "turn-000000.npz")
    (parts / "test-000000.npz").unlink()
    manifest = collect_again(short_settings, tmp_path)
    assert manifest["sha256"] == sums(short_recording) and is_whole(tmp_path / "recording")
    assert manifest["images_drawn_twice"] == read_manifest(short_recording).model_dump()["images_drawn_twice"] == 5
    told = [record.message for record in caplog.records]
    assert len(told) == 3, "what is missing is no damage"
    assert all("\n" not in line and "is damaged" in line and "is made again" in line for line in told)
    for name in ("drive-000000", "image-000001", "turn-000000"):
        assert any(name in line for line in told)
    assert [path.read_text() for path in theirs] == ["a user's"] * 2


def test_a_part_that_changes_after_it_was_checked_is_found_when_it_is_assembled(
    unfinished, short_settings, short_recording, tmp_path, monkeypatch, caplog
):
    write_drive = collecting.write_drive
    late = ["test-000000.npz", "image-000000.npz"]

    def flip_one(*args):
        if late:
            flip(tmp_path / "recording.collecting" / late.pop())
        return write_drive(*args)

    monkeypatch.setattr(collecting, "write_drive", flip_one)
    assert collect_again(short_settings, tmp_path)["sha256"] == sums(short_recording)
    told = [record.message for record in caplog.records]
    assert len(told) == 2 and "image-000000.npz" in told[0] and "test-000000.npz" in told[1]


def test_a_disk_that_damages_all_it_is_given_is_one_clear_line(unfinished, short_settings, tmp_path, monkeypatch):
    count = collecting.count_drawn

    def flip_always(settings, paths):
        flip(paths[0])
        return count(settings, paths)

    monkeypatch.setattr(collecting, "count_drawn", flip_always)
    with pytest.raises(WorkError, match=r"image-000000\.npz is damaged: .*, 3 times: what is written here"):
        collect(short_settings, 0, tmp_path / "recording", quiet, workers=1)


def test_what_cannot_fit_is_refused_before_anything_is_driven(unfinished, short_settings, tmp_path, monkeypatch):
    def report_free(free: int) -> None:
        usage = shutil.disk_usage(tmp_path)._replace(free=free)
        monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)

    images = 8 * 32 * 3 * (60 + np.prod(np.load(unfinished / "recording" / "truth" / "test_pose.npy").shape[:2]))
    monkeypatch.setattr(collecting, "_make_parts", lambda *_: pytest.fail("driven"))
    report_free(int(1.9 * images))
    with pytest.raises(WorkError, match=rf"{tmp_path}/x cannot be written: No space left on device; at least .* free"):
        collect(short_settings, 0, tmp_path / "x", quiet)
    monkeypatch.undo()
    report_free(int(1.3 * images))  # parts that exist need no space
    collect(short_settings, 0, tmp_path / "recording", quiet, workers=1)


def test_an_image_that_comes_out_different_when_it_is_drawn_twice_is_never_kept(
    short_settings, short_recording, tmp_path, monkeypatch
):
    state, draw = np.load(short_recording / "truth" / "state.npy")[:3], chunks.observe
    monkeypatch.setattr(chunks, "observe", lambda *given: draw(*given) ^ (len(given[2]) > 1))
    with pytest.raises(UnsteadyError, match=r"image \d of 3 was drawn twice and came out different"):
        sense_part(Part(short_settings, state, tmp_path / "image-000000.npz"), lambda: None)
    assert not any(tmp_path.iterdir())


def test_a_grid_without_a_position_is_one_clear_line(small_settings):
    world = RoomWorld(small_settings, drawn=False)
    low = np.ceil(world.bounds[0] / 0.8) * 0.8
    world.free_space.reachable[:] = False
    row, column = np.rint((low + 0.2 - world.free_space.origin) / world.free_space.cell_m).astype(int)[::-1]
    world.free_space.reachable[row, column] = True  # all that can be reached lies between two positions
    with pytest.raises(InputError, match=r"grid\.spacing_m 0\.8 m must be smaller: it leaves no test position"):
        collecting.lay_grid(world, change(small_settings, grid=GridSettings(spacing_m=0.8)))


def test_the_grid_has_all_that_can_be_reached_up_to_the_last_row(small_settings):
    world, settings = RoomWorld(small_settings, drawn=False), change(small_settings, grid={"spacing_m": 0.08})
    reachable = np.ones((11, 16), bool)
    for cell_m in (0.02, 0.016):
        world.free_space = FreeSpace(np.array([0.08, -0.16]), cell_m, reachable, reachable, np.zeros(2), 0.2)
        pose = collecting.lay_grid(world, settings)
        last = np.array([0.08, -0.16]) + cell_m * (np.array(reachable.shape[::-1]) - 1)
        for axis, (low, high) in enumerate(zip((0.08, -0.16), last, strict=True)):
            assert pose[..., axis].min() == pytest.approx(low)
            assert pose[..., axis].max() == pytest.approx(0.08 * np.floor(high / 0.08 + 1e-9))


def test_a_drive_that_is_done_before_its_last_image_is_whole(short_settings, tmp_path):
    settings = change(short_settings, drive={"samples": 500, "headings": "map", "until": {"unseen": 0.4}})
    collect(settings, 0, tmp_path / "done", quiet, workers=1)
    done, longer = open_recording(tmp_path / "done"), tmp_path / "longer"
    count = len(done.observation)
    assert count < 500 and done.manifest.samples == count == len(open_truth(done.folder).pose)
    assert (done.manifest.model_extra or {})["unseen"][0] <= 0.4
    collect(change(settings, drive={"samples": count, "until": {}}), 0, longer, quiet, workers=1)
    ours, theirs = read_files(done.folder), read_files(longer)
    assert ours == theirs


def stop(*_: object) -> None:
    raise KeyboardInterrupt


@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_drive_goes_on_while_it_is_not_enough_to_the_same_bytes_however_it_is_cut_off(
    workers: int, short_settings: SimSettings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    settings = change(short_settings, drive={"samples": 400, "headings": "map", "until": {"unseen": 0.5}})
    asked: list[int] = []

    def is_enough(recording: Recording) -> bool:
        asked.append(len(recording.observation))
        return asked[-1] > asked[0]

    def make(name: str, judge: Judge = is_enough) -> dict[str, bytes]:
        collect(settings, 0, tmp_path / name, quiet, workers, is_enough=judge)
        return read_files(tmp_path / name)

    whole, (first, last) = make("whole"), asked
    assert 1.5 * first <= last == len(open_recording(tmp_path / "whole").observation) < 400
    with pytest.raises(KeyboardInterrupt):
        make("asked", lambda recording: False if len(recording.observation) == first else stop() is None)
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(collecting, "find_least", stop)
        make("driving")
    if workers > 1:
        monkeypatch.setattr(collecting, "Renderers", renderers.Renderers)
    del asked[1:]
    assert make("asked") == whole and asked == [first, last], "what was found too little is not asked again"
    assert make("driving") == whole and asked[2:] == [first, last]


@pytest.mark.slow  # quick: test_use, whose deployment drive and tests are darkened
def test_what_changes_between_training_and_use_leaves_training_as_it_was(small_settings, tmp_path):
    plain = change(small_settings, drive={"samples": 30}, grid={"spacing_m": 0.15, "headings": 1})
    settings = change(plain, deployment={"light": 0.5, "moved_m": 0.5})
    for name, group in (("plain", plain), ("used", settings)):
        collect(group, 0, tmp_path / name, quiet, workers=1)
    ours, before = read_files(tmp_path / "used"), read_files(tmp_path / "plain")
    tests = {"test/fisheye.npy", "truth/test_pose.npy"}
    assert {name for name in before if ours[name] != before[name]} == tests
    truth, old = open_truth(tmp_path / "used"), open_truth(tmp_path / "plain")
    known, now = ({tuple(pose) for pose in one.test_pose[:, 0]} for one in (old, truth))
    assert now < known, "some are blocked by what was moved, none is new"
    assert RoomWorld(settings).is_free(truth.test_pose[..., :2]).all()
    kept = [number for number, pose in enumerate(old.test_pose[:, 0]) if tuple(pose) in now]
    changed, was = (open_recording(tmp_path / name).test_observation for name in ("used", "plain"))
    # codes are about a root of light: in a dark room, half of it is a little more than half
    assert decode(changed).mean() == pytest.approx(decode(was[kept]).mean() / 2, rel=0.2)
