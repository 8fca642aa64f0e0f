"""Positions are those of the axle, wherever the camera is mounted on the robot."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from deepgps.config.learning import FeatureSettings
from deepgps.data.features import fit_features
from deepgps.data.segments import read_segments
from deepgps.initial_map.compass.compass_map import CompassMap
from deepgps.learning.batches import Inputs
from deepgps.learning.trainer import make_generator
from deepgps.learning.training_data import TrainingData
from deepgps.methods.appearance import learn
from deepgps.methods.compass import find_mount
from deepgps.methods.registration import find_headings
from deepgps.positioner.appearance import AppearanceMap
from deepgps.positioner.pose import find_poses
from deepgps.positioner.positioner import NetworkPositioner
from deepgps.positioner.stored_positioner import load_positioner, save_positioner
from sim.geometry import wrap
from sim.recording.format import Recording, open_recording, write_files
from tests.deepgps.positioner.test_positioner import images, spectral
from tests.helpers.synthetic_run import make_drive, make_free_space, make_images

MOUNT = (0.06, -0.03)
RINGS, SECTORS = 16, 64
ODOMETRY = {"wheel_radius_m": 0.033, "track_m": 0.16, "ticks_per_rev": 4096}


def record(folder: Path, camera: np.ndarray, pose: np.ndarray, reading: np.ndarray, time: np.ndarray) -> Recording:
    """The drive of an axle with these poses (N, 3), seen by a camera at other poses."""
    arrays = {
        "observations/fisheye.npy": make_images(camera, RINGS, SECTORS),
        "reading.npy": reading,
        "time.npy": time,
        "test/fisheye.npy": make_images(pose[:1, None], RINGS, SECTORS),
    }
    write_files(folder, arrays, {"sensors": {"fisheye": "polar_image"}, "odometry": ODOMETRY})
    return open_recording(folder)


def draw_queries(count: int = 200) -> np.ndarray:
    """Poses (n, 3) anywhere on the floor."""
    rng, space = np.random.default_rng(1), make_free_space()
    place = rng.uniform((-3.2, -1.9), (3.2, 1.9), (20 * count, 2))
    place = place[space.is_reachable(place)][:count]
    return np.column_stack([place, rng.uniform(-np.pi, np.pi, len(place))])


def see(axle: np.ndarray, mirror: float = 1.0) -> np.ndarray:
    """Positions of the camera (n, 2) [m] for poses of the axle (n, 3); in a mirrored map, with y negated."""
    cos, sin = np.cos(axle[:, 2]), np.sin(axle[:, 2])
    ahead, left = MOUNT
    return (axle[:, :2] + np.stack([cos * ahead - sin * left, sin * ahead + cos * left], axis=1)) * [1.0, mirror]


@dataclass(frozen=True)
class Known(NetworkPositioner):
    """Stands in for a network that makes no error."""

    camera: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))

    def locate_camera(self, observations: np.ndarray) -> np.ndarray:
        return self.camera


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> tuple[Recording, np.ndarray]:
    """A drive in the synthetic room by a camera off the axle, and the true poses of the axle (N, 3)."""
    pose, reading, time, _ = make_drive(make_free_space(), 900, np.random.default_rng(0))
    camera = np.column_stack([see(pose), pose[:, 2]])
    return record(tmp_path_factory.mktemp("mount") / "recording", camera, pose, reading, time), pose


def learn_room(recording: Recording, places: np.ndarray) -> AppearanceMap:
    settings, segments = FeatureSettings(principal=64, components=32), read_segments(recording)
    features, known = fit_features(recording.observation, segments, settings, make_generator(0, "features"))
    data = TrainingData(segments, features, known, Inputs(known), recording.observation)
    return learn(data, places, find_headings(recording, places))[0]


def know(drive: tuple[Recording, np.ndarray], camera: np.ndarray, mirror: float = 1.0) -> Known:
    """A positioner that knows where the camera is (n, 2) [m], and finds the yaw by what is seen where."""
    recording, pose = drive
    return Known(
        **{**vars(spectral()), "appearance": learn_room(recording, see(pose, mirror)), "mount": MOUNT},
        camera=camera,
    )


@pytest.mark.parametrize("mirror", [1.0, -1.0])
def test_the_axle_is_found_by_the_yaw(drive: tuple[Recording, np.ndarray], mirror: float) -> None:
    axle = draw_queries()
    seen = make_images(np.column_stack([see(axle), axle[:, 2]]), RINGS, SECTORS)
    positioner = know(drive, see(axle, mirror), mirror)
    found, poses = positioner(seen), find_poses(positioner, seen)
    np.testing.assert_array_equal(poses.position, found)
    error = np.linalg.norm(found * [1.0, mirror] - axle[:, :2], axis=1)
    assert poses.yaw is not None
    missed = np.abs(wrap(mirror * poses.yaw - axle[:, 2]))
    np.testing.assert_allclose(error, 2.0 * np.hypot(*MOUNT) * np.sin(missed / 2.0), atol=1e-6)
    assert np.median(error) < 0.002
    on_axle = replace(positioner, mount=(0.0, 0.0))
    np.testing.assert_array_equal(on_axle(seen), see(axle, mirror))
    np.testing.assert_array_equal(find_poses(on_axle, seen).position, see(axle, mirror))


def test_where_no_yaw_is_found_positions_are_those_of_the_camera(drive: tuple[Recording, np.ndarray]) -> None:
    camera = drive[1][:3, :2]
    np.testing.assert_array_equal(know(drive, camera).leave_camera(camera, np.full(3, np.nan)), camera)


def test_the_mount_is_saved_with_the_network(tmp_path: Path) -> None:
    positioner = replace(spectral(), mount=MOUNT)
    save_positioner(tmp_path / "aside", positioner, {})
    loaded = load_positioner(tmp_path / "aside")
    assert isinstance(loaded, NetworkPositioner) and loaded.mount == MOUNT
    np.testing.assert_array_equal(loaded(images(4)), positioner(images(4)))
    save_positioner(tmp_path / "on", spectral(), {})
    assert cast(Any, load_positioner(tmp_path / "on")).mount == (0.0, 0.0)


def test_a_mount_that_is_small_or_not_sure_is_left_out() -> None:
    for mount, std, kept in (((0.04, -0.01), 0.001, True), ((0.003, 0.002), 1e-4, False), ((0.04, 0.0), 0.02, False)):
        found = SimpleNamespace(shared=np.array([0.0, *mount]), shared_std=np.array([0.0, std, std]))
        assert find_mount(cast(CompassMap, found)) == (mount if kept else (0.0, 0.0))
