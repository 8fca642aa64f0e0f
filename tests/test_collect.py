import os

import numpy as np
import pytest

from sim import collect as collecting
from sim.collect import collect
from sim.encoder import ticks_to_distance
from sim.errors import WorkError
from sim.records import check_recording, open_recording, open_truth, read_manifest


def arrays(folder) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.suffix in {".npy", ".npz", ".glb"}
    }


def test_a_recording_is_whole(small_recording, small_settings):
    recording, truth = open_recording(small_recording), open_truth(small_recording)
    check_recording(small_recording)
    assert recording.observation.shape == (300, 8, 32, 3)
    assert truth.pose.shape == (300, 3)
    assert recording.test_observation.shape == (*truth.test_pose.shape[:2], 8, 32, 3)
    assert [path.name for path in small_recording.parent.iterdir()] == ["recording"]
    assert recording.manifest["settings"] == small_settings.model_dump(mode="json")
    assert recording.manifest["gl_renderer"]
    assert set(recording.reading[:, 1]) == set(range(300))


def test_readings_run_in_order_and_turning_places_have_two(small_recording):
    reading, time = open_recording(small_recording).reading, open_recording(small_recording).time
    assert (np.diff(reading[:, 0]) >= 0).all()
    assert (np.diff(reading[:, 1]) >= 0).all()
    assert (np.diff(time) > 0).all()
    same_place = np.diff(reading[:, 1]) == 0
    assert same_place.any()
    assert (np.diff(reading[:, 0])[same_place] == 1).all()


def test_encoder_distances_agree_with_the_truth(small_recording):
    recording, truth = open_recording(small_recording), open_truth(small_recording)
    odometry = recording.manifest["odometry"]
    wheels = ticks_to_distance(recording.reading[:, 2:], odometry["wheel_radius_m"], odometry["ticks_per_rev"])
    way = wheels.mean(axis=1)
    for segment in np.unique(recording.reading[:, 0]):
        row = np.flatnonzero(recording.reading[:, 0] == segment)
        place = truth.pose[recording.reading[row, 1], :2]
        driven = np.linalg.norm(place - place[0], axis=1)
        np.testing.assert_allclose(way[row] - way[row[0]], driven, atol=0.004)


def test_test_poses_are_reachable_and_on_the_grid(small_recording):
    truth = open_truth(small_recording)
    assert truth.free_space.is_reachable(truth.test_pose[..., :2]).all()
    np.testing.assert_allclose(truth.test_pose[..., :2] / 0.4, np.rint(truth.test_pose[..., :2] / 0.4), atol=1e-9)
    np.testing.assert_allclose(truth.test_pose[:, :, 2], np.broadcast_to([0.0, np.pi], truth.test_pose.shape[:2]))


@pytest.mark.slow
def test_cut_off_anywhere_it_continues_to_the_same_bytes(small_recording, small_settings, tmp_path, monkeypatch):
    """Stopped after the first chunk of the drive, then taken up by two workers."""
    folder = tmp_path / "recording"
    second_chunk = collecting.drive_chunk

    def stop_at_second(world, settings, rng, before):
        if before is not None:
            raise KeyboardInterrupt
        return second_chunk(world, settings, rng, before)

    monkeypatch.setattr(collecting, "drive_chunk", stop_at_second)
    with pytest.raises(KeyboardInterrupt):
        collect(small_settings, 0, folder, lambda *_: None, workers=1)
    assert (tmp_path / "recording.collecting" / "drive-000000.npz").is_file()
    assert not (folder / "manifest.json").exists()
    monkeypatch.undo()
    collect(small_settings, 0, folder, lambda *_: None, workers=2)
    assert arrays(folder) == arrays(small_recording)


@pytest.mark.slow
def test_another_seed_drives_elsewhere_and_lost_readings_are_counted(small_settings, small_recording, tmp_path):
    settings = small_settings.model_copy(
        update={
            "drive": small_settings.drive.model_copy(update={"samples": 60, "strategy": "endpoint"}),
            "encoder": small_settings.encoder.model_copy(update={"lost": 0.3}),
        }
    )
    collect(settings, 1, tmp_path / "other", lambda *_: None, workers=1)
    other, manifest = open_recording(tmp_path / "other"), read_manifest(tmp_path / "other")
    truth = open_truth(tmp_path / "other")
    assert len(other.reading) == manifest["readings"] - manifest["readings_lost"] < len(truth.reading)
    assert manifest["readings_lost"] > 0
    assert np.bincount(truth.reading[:, 0]).max() == 2
    assert not np.allclose(truth.pose[:50], open_truth(small_recording).pose[:50])


def test_a_renderer_that_dies_is_started_again(small_settings, small_recording, tmp_path, monkeypatch):
    executor = collecting.ProcessPoolExecutor
    pools = []

    class Mortal(executor):
        def submit(self, *args, **kwargs):
            jobs.append(args)
            if len(pools) == 1 and len(jobs) == 3:
                return super().submit(os.abort)
            return super().submit(*args, **kwargs)

    def start(*args, **kwargs):
        jobs.clear()
        pools.append(Mortal(*args, **kwargs))
        return pools[-1]

    jobs = []
    monkeypatch.setattr(collecting, "ProcessPoolExecutor", start)
    collect(small_settings, 0, tmp_path / "again", lambda *_: None)
    assert len(pools) == 2 and read_manifest(tmp_path / "again")["renderer_deaths"] == 1
    assert read_manifest(small_recording)["renderer_deaths"] == 0
    assert read_manifest(tmp_path / "again")["sha256"] == read_manifest(small_recording)["sha256"]


def test_a_renderer_that_always_dies_is_said_so(small_settings, tmp_path, monkeypatch):
    class Broken:
        def __init__(self, *_: object, **__: object) -> None: ...

        def submit(self, *_: object) -> None:
            raise collecting.BrokenProcessPool

        def shutdown(self, **_: object) -> None: ...

    monkeypatch.setattr(collecting, "ProcessPoolExecutor", Broken)
    with pytest.raises(WorkError, match="a rendering process died; deepgps doctor checks the renderer"):
        collect(small_settings, 0, tmp_path / "x", lambda *_: None)
