import numpy as np
import pytest

from sim.errors import InputError
from sim.files.checksums import read_json, write_array, write_json
from sim.geometry import FreeSpace, load_free_space, save_free_space
from sim.recording.format import check_recording, finish_recording, open_recording, open_truth
from sim.recording.manifest import name_sensors
from sim.settings import RoomSettings, SimSettings, TagCameraSettings


@pytest.fixture
def space() -> FreeSpace:
    free = np.zeros((4, 6), bool)
    free[1:3, 1:5] = True
    reachable = free.copy()
    reachable[:, 4] = False
    return FreeSpace(np.array([-1.0, 2.0]), 0.5, free, reachable, np.array([0.0, 2.5]), 1.0)


@pytest.fixture
def folder(tmp_path, space):
    rng = np.random.default_rng(0)
    arrays = {
        "observations/fisheye.npy": rng.integers(0, 256, (5, 4, 8, 3), np.uint8),
        "reading.npy": np.arange(28).reshape(7, 4),
        "time.npy": np.arange(7.0),
        "test/fisheye.npy": rng.integers(0, 256, (2, 4, 4, 8, 3), np.uint8),
        "truth/pose.npy": rng.normal(size=(5, 3)),
        "truth/reading.npy": np.arange(14).reshape(7, 2),
        "truth/wheel_angle.npy": rng.normal(size=(7, 2)),
        "truth/test_pose.npy": rng.normal(size=(2, 4, 3)),
    }
    for name, array in arrays.items():
        write_array(tmp_path / name, array)
    save_free_space(tmp_path / "truth" / "free_space.npz", space)
    finish_recording(tmp_path, {"seed": 3, "sensors": {"fisheye": "polar_image"}})
    return tmp_path


def test_a_recording_comes_back_as_it_was(folder):
    recording, truth = open_recording(folder), open_truth(folder)
    assert recording.manifest.seed == 3
    assert recording.reading[6].tolist() == [24, 25, 26, 27]
    assert isinstance(recording.observation, np.memmap)
    assert truth.wheel_angle.shape == (7, 2)
    check_recording(folder)


def test_what_is_sensed_does_not_hold_the_truth(folder):
    sensed = "folder manifest observation reading time test_observation observation_time turns turn_observation others"
    assert set(vars(open_recording(folder))) == set(sensed.split())


def test_free_space_is_looked_up_by_cell(space, tmp_path):
    save_free_space(tmp_path / "space.npz", space)
    again = load_free_space(tmp_path / "space.npz")
    row, column = np.mgrid[0:4, 0:6]
    points = np.stack([-1.0 + 0.5 * column, 2.0 + 0.5 * row], axis=-1)
    np.testing.assert_array_equal(again.is_free(points), space.free)
    np.testing.assert_array_equal(again.is_free(points + 0.24), space.free)
    np.testing.assert_array_equal(again.is_reachable(points - 0.24), space.reachable)
    assert not again.is_free(np.array([[-50.0, 2.5], [50.0, 2.5], [0.0, 90.0]])).any()


def test_a_flipped_bit_or_a_cut_is_found(folder):
    for name in ("observations/fisheye.npy", "test/fisheye.npy", "time.npy", "truth/pose.npy"):
        path = folder / name
        whole = path.read_bytes()
        for at in range(0, 1000, 137):
            data = bytearray(whole)
            data[at % len(data)] ^= 4
            path.write_bytes(data)
            with pytest.raises(InputError, match=rf"{name} is damaged: it differs from its checksum"):
                check_recording(folder)
        for left in (0, 100):
            path.write_bytes(whole[:left])
            with pytest.raises(InputError, match=rf"{name} is damaged"):
                check_recording(folder)
            if not name.startswith("truth"):
                with pytest.raises(InputError, match=rf"{name} is damaged"):
                    open_recording(folder)
        path.write_bytes(whole)


def test_what_is_wrong_is_named(folder, tmp_path_factory):
    with pytest.raises(InputError, match=r"is no finished recording: it has no manifest\.json"):
        open_recording(tmp_path_factory.mktemp("empty"))
    (folder / "time.npy").unlink()
    with pytest.raises(InputError, match=r"time\.npy is missing"):
        open_recording(folder)
    write_json(folder / "manifest.json", {**read_json(folder / "manifest.json"), "format": 99})
    with pytest.raises(InputError, match="format 99, but this version of deepgps reads format 2"):
        open_recording(folder)
    write_json(folder / "manifest.json", {"schema": 3})
    with pytest.raises(InputError, match=r"made by deepgps 0\.1\.0, format 1: make it again, or use deepgps 0\.1\.0"):
        open_recording(folder)
    (folder / "manifest.json").write_text('{"format"')
    with pytest.raises(InputError, match="is not JSON"):
        open_recording(folder)


def test_a_manifest_that_cannot_be_is_one_line(folder):
    manifest = read_json(folder / "manifest.json")
    for changes, message in (
        ({"settings": 3}, "manifest.json: settings cannot be used"),
        ({"odometry": [1]}, "manifest.json: odometry cannot be used"),
        ({"sensors": {"../../fisheye": "polar_image"}}, "manifest.json: sensors"),
        ({"sensors": {"fisheye": "smell"}}, "manifest.json: sensors.fisheye cannot be used"),
        ({"sensors": {"fisheye": "vector"}}, "fisheye.npy has 4 axes, and observations of kind vector have 2"),
        ({"sensors": {}}, "sensors must name at least one sensor"),
        ({"sensors": {"lidar": "scan"}}, "lidar.npy is missing"),
        ({"readings_lost": "many"}, "manifest.json: readings_lost cannot be used"),
    ):
        write_json(folder / "manifest.json", {**manifest, **changes})
        with pytest.raises(InputError) as caught:
            open_recording(folder)
        assert message in str(caught.value)
        assert "\n" not in str(caught.value)


def test_no_sensor_is_named_whose_images_are_not_kept():
    kept = SimSettings(tag_camera=TagCameraSettings(kept=True))
    both = SimSettings(room=RoomSettings(kind="lab"), tag_camera=TagCameraSettings(kept=True, mounted=True))
    assert name_sensors(kept) == {"fisheye": "polar_image"}
    assert name_sensors(both) == {"fisheye": "polar_image", "tag_camera": "image"}
