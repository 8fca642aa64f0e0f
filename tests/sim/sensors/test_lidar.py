"""The lidar in a room: rays agree with rays cast one by one, and turning the robot shifts a scan in a circle."""

import os
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest

from deepgps.runs.run_folder import VIEWED
from deepgps.viewer.drive import ROBOT
from deepgps.viewer.stream import open_rrd
from sim.recording.collect import collect
from sim.recording.format import check_recording, open_recording, open_truth
from sim.robot.chassis import compile_scene
from sim.robot.world import RoomWorld
from sim.sensors.lidar import LIDAR_HEIGHT_M, Lidar
from sim.sensors.lidar_scan import LIDAR_REACH_M
from sim.settings import DriveSettings, LidarSettings, SimSettings
from tests.helpers.small_room import furnished

LIDAR = LidarSettings(rays=90, headings=2)
SETTINGS = SimSettings(sensor="lidar", lidar=LIDAR)
POSES = np.array([[-0.9, 0.0, 0.4], [1.5, -1.0, -2.0], [0.8, 0.3, 1.0], [0.0, 1.2, 3.0]])


@pytest.fixture(scope="module")
def world() -> RoomWorld:
    return RoomWorld(SETTINGS, furnished())


@pytest.fixture(scope="module")
def lidar() -> Lidar:
    return Lidar(furnished(), LIDAR)


def cast_one(model: mujoco.MjModel, data: mujoco.MjData, point: np.ndarray, ray: np.ndarray) -> float:
    """Distance to the first geom of the scene with the robot in it that is none of the robot's own."""
    way, step = 0.0, 1e-6
    while True:
        geom = np.array([-1], np.int32)
        distance = mujoco.mj_ray(model, data, point + way * ray, ray, None, 1, -1, geom, None)
        if distance < 0:
            return np.inf
        way += distance
        if not model.body(model.geom_bodyid[geom[0]]).name.startswith("robot/"):
            return way
        way += step


def test_rays_agree_with_rays_cast_one_by_one_past_the_robot(world: RoomWorld, lidar: Lidar) -> None:
    spec = furnished()
    for geom in spec.geoms:
        geom.rgba[3] = 1.0  # rays pass through what is transparent
    model = compile_scene(spec, SETTINGS)
    data = mujoco.MjData(model)
    for state, pose in zip(world.rest_states(POSES), POSES, strict=True):
        data.qpos[:] = state
        mujoco.mj_kinematics(model, data)
        scan, rotation = lidar.scan(state), data.body("robot/base").xmat.reshape(3, 3)
        point = data.body("robot/base").xpos + LIDAR_HEIGHT_M * rotation[:, 2]
        for heading, ray in [(0, 0), (0, 31), (1, 12), (1, 77), (0, 60)]:
            angle = 2 * np.pi * (ray + heading / 2) / 90
            expected = cast_one(model, data, point, rotation @ [np.cos(angle), np.sin(angle), 0.0])
            assert scan[heading, ray] == pytest.approx(min(expected, LIDAR_REACH_M), abs=1e-4)
        ahead = np.hypot(*(data.body("robot/base").xpos[:2] - pose[:2]))
        assert ahead < 1e-6


def test_turning_left_shifts_the_scan_in_a_circle(world: RoomWorld, lidar: Lidar) -> None:
    for turn in (1, 2, 17, 90):
        turned = world.rest_states(POSES + [0, 0, 2 * np.pi * turn / 180])
        for before, after in zip(world.rest_states(POSES), turned, strict=True):
            shifted = np.roll(lidar.scan(before).T.ravel(), -turn)
            assert (np.abs(lidar.scan(after).T.ravel() - shifted) < 2e-3).mean() > 0.97  # edges may be hit or missed


def test_it_agrees_with_the_range_finder_and_tells_its_reach(
    world: RoomWorld, lidar: Lidar, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sim.sensors.lidar.LIDAR_REACH_M", 2.5)
    assert max(lidar.scan(state).max() for state in world.rest_states(POSES)) == np.float32(2.5)
    monkeypatch.setattr("sim.sensors.lidar.LIDAR_REACH_M", 3.5)
    monkeypatch.setattr("sim.sensors.lidar.LIDAR_HEIGHT_M", 0.1)
    low = Lidar(furnished(), LidarSettings(rays=8))
    world.place(POSES[0])
    ahead = world.ranges().reshape(-1, 29)[1, 14]
    assert low.scan(world.snapshot())[0, 0] == pytest.approx(ahead, abs=2e-3)


@pytest.mark.slow
def test_a_recording_of_scans_is_whole_and_repeats_with_its_noise(tmp_path: Path, small_settings: SimSettings) -> None:
    lidar = LidarSettings(rays=32, noise_m=0.01)
    settings = small_settings.model_copy(update={"sensor": "lidar", "lidar": lidar, "drive": DriveSettings(samples=80)})
    exact = settings.model_copy(update={"lidar": LidarSettings(rays=32)})
    for name, chosen, workers in (("one", settings, 1), ("two", settings, 2), ("exact", exact, 1)):
        collect(chosen, 0, tmp_path / name, lambda *_: None, workers=workers)
    check_recording(tmp_path / "one")
    one, two, still = (open_recording(tmp_path / name) for name in ("one", "two", "exact"))
    assert one.observation.shape == (80, 1, 32)
    assert one.observation.dtype == np.float32
    assert one.test_observation.shape == (*open_truth(tmp_path / "one").test_pose.shape[:2], 1, 32)
    assert one.manifest.gl_renderer == "none"
    assert one.manifest.sha256 == two.manifest.sha256
    assert np.std(one.observation - still.observation) == pytest.approx(0.01, rel=0.1)
    assert (tmp_path / "one" / "scene.glb").is_file()


@pytest.mark.slow
def test_a_room_is_run_with_a_lidar_and_without_a_renderer(tmp_path: Path) -> None:
    words = ["run", "tiny", "--sensor", "lidar", "--methods", "deepgps", "pca_knn", "--drive.samples", "200"]
    small = ["--learn.train.steps", "40", "--grid.spacing-m", "0.5", "--lidar.rays", "64", "--out", "one"]
    command = [sys.executable, "-m", "deepgps.commands.main", *words, *small]
    environment = {**os.environ, "MUJOCO_GL": "nothing"}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "PCA + nearest" in done.stdout
    paths = {chunk.entity_path for chunk in open_rrd(tmp_path / "one" / VIEWED).stream()}
    assert f"/{ROBOT}/scan" in paths
    assert "/world/room" in paths
    assert "/drive/polar" not in paths
