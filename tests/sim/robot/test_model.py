"""The robot: laws of its compiled model."""

from collections.abc import Callable

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.files import ROBOT
from sim.geometry import planar_pose
from sim.robot.calibrate import calibrate, run
from sim.robot.chassis import compile_scene
from sim.robot.model import RADIUS_M, TRACK_M, WHEEL_RADIUS_M, describe_body, load_robot, wheel_speeds
from sim.robot.world import RoomWorld
from sim.rooms.spec import empty_room
from sim.settings import CameraSettings, RobotSettings, SimSettings

SPEED_MPS = 0.22


def make_world(**groups) -> RoomWorld:
    world = RoomWorld(SimSettings(**groups), empty_room())
    world.place(np.zeros(3))
    return world


@given(st.floats(-0.5, 0.5), st.floats(-3.0, 3.0))
def test_wheel_speeds_are_those_of_a_speed_and_a_turn(speed, rate):
    left, right = wheel_speeds(speed, rate) * WHEEL_RADIUS_M
    assert np.allclose(((left + right) / 2, (right - left) / TRACK_M), (speed, rate))


@given(st.floats(-3.1, 3.1), st.floats(-0.05, 0.05))
def test_planar_pose_reads_the_yaw_of_a_tilted_body(yaw, tilt):
    quat = np.empty(4)
    mujoco.mju_euler2Quat(quat, np.array([yaw, tilt, 0.0]), "zyx")
    assert np.allclose(planar_pose(np.array([1.0, 2.0, 0.0, *quat, 5.0, 6.0])), (1.0, 2.0, yaw))


def test_calibration_is_the_stored_one():
    radius_m, track_m = calibrate(SimSettings())
    assert radius_m == pytest.approx(WHEEL_RADIUS_M, rel=1e-4)
    assert track_m == pytest.approx(TRACK_M, rel=1e-4)


@pytest.mark.parametrize(("speed_mps", "yaw"), [(0.22, 2.0), (0.4, 0.0)])
def test_encoders_measure_a_straight(speed_mps, yaw):
    world = make_world()
    world.place(np.array([0.0, 0.0, yaw]))
    run(world, speed_mps, 0.0, 5.0 / speed_mps)
    x, y, _ = world.pose()
    along, aside = np.cos(yaw) * x + np.sin(yaw) * y, np.cos(yaw) * y - np.sin(yaw) * x
    assert along > 4.9
    assert world.wheel_angle().mean() * WHEEL_RADIUS_M == pytest.approx(along, rel=1e-3)
    assert abs(aside) < 0.02


@pytest.mark.parametrize("rate_rps", [-2.8, 0.8, 1.8])
def test_encoders_measure_a_full_turn(rate_rps):
    world = make_world()
    yaw = np.unwrap(run(world, 0.0, rate_rps, 2 * np.pi / abs(rate_rps)))
    left, right = world.wheel_angle()
    assert abs(yaw[-1]) > 6.0
    assert (right - left) * WHEEL_RADIUS_M / TRACK_M == pytest.approx(yaw[-1], rel=0.01)


def note_each_step(world: RoomWorld, read: Callable[[], np.ndarray]) -> list[np.ndarray]:
    """What is read after each step that follows."""
    noted, step = [], world.step

    def noted_step(wheel_speed):
        step(wheel_speed)
        noted.append(read().copy())

    world.step = noted_step
    return noted


def test_camera_axis_stays_while_turning():
    world = make_world()
    place = note_each_step(world, lambda: world.data.site("robot/camera").xpos)
    run(world, 0.0, 1.8, 2 * np.pi / 1.8)
    assert len(place) > 100
    assert np.ptp(place, axis=0).max() < 0.003


def test_dead_reckoning_follows_an_arc():
    world = make_world()
    angles = note_each_step(world, world.wheel_angle)
    run(world, 0.2, 0.7, 10.0)
    distance = np.diff(np.array([np.zeros(2), *angles]) * WHEEL_RADIUS_M, axis=0)
    yaw = np.cumsum((distance[:, 1] - distance[:, 0]) / TRACK_M)
    place = distance.mean(axis=1) @ np.stack([np.cos(yaw), np.sin(yaw)], axis=1)  # along the heading at each step's end
    x, y, turned = world.pose()
    assert np.allclose(place, (x, y), atol=0.01)
    assert np.exp(1j * yaw[-1]) == pytest.approx(np.exp(1j * turned), abs=0.01)


def test_stands_still_without_command():
    world = make_world()
    for _ in range(500):
        world.step(np.zeros(2))
    assert np.abs(world.pose()).max() < 1e-6
    assert np.abs(world.wheel_angle()).max() < 1e-5


def test_does_not_fall_when_it_stops_dead():
    world = make_world()
    for _ in range(50):
        world.step(wheel_speeds(SPEED_MPS, 0.0))
    tilt = []
    for _ in range(50):
        world.step(np.zeros(2))
        tilt.append(np.degrees(np.arccos(np.clip(world.data.body("robot/base").xmat[8], -1, 1))))
    assert max(tilt) < 5.0
    assert tilt[-1] < 0.02


@pytest.mark.parametrize("error", [-0.1, 0.05])
def test_larger_left_wheel_curves_the_robot(error):
    world = make_world(robot=RobotSettings(wheel_radius_error=error))
    yaw = np.unwrap(run(world, SPEED_MPS, 0.0, 5.0))
    # Both wheels turn by the same angle a: the left one goes (1 + e) R a, the right one R a.
    distance = world.wheel_angle() * WHEEL_RADIUS_M
    assert yaw[-1] == pytest.approx((distance[1] - (1 + error) * distance[0]) / TRACK_M, rel=0.01)
    assert abs(yaw[-1]) > 0.2


@pytest.mark.parametrize("height_m", [0.2, 0.35, 1.5])
def test_lens_does_not_see_its_own_robot(height_m):
    settings = SimSettings(camera=CameraSettings(height_m=height_m))
    model = compile_scene(empty_room(), settings)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    lens = data.site("robot/camera").xpos
    assert lens[2] == pytest.approx(height_m, abs=1e-3)
    assert describe_body(settings.camera).height_m == height_m
    azimuth, angle = np.meshgrid(np.linspace(0, 2 * np.pi, 181), np.radians(np.linspace(0.0, 95.0, 96)))
    rays = np.stack([np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)], axis=-1)
    geom, distance = np.empty(angle.size, np.int32), np.empty(angle.size)
    mujoco.mj_multiRay(model, data, lens, rays.ravel(), None, 1, -1, geom, distance, None, angle.size, mujoco.mjMAXVAL)
    seen = {model.geom(g).name for g in set(geom[geom >= 0])}
    assert seen == {"floor"}


def test_camera_looks_up_with_the_front_at_the_top_of_the_picture():
    world = make_world()
    right, up, back = world.data.camera("robot/fisheye").xmat.reshape(3, 3).T
    assert np.allclose([back, up, right], [(0, 0, -1), (1, 0, 0), (0, 1, 0)], atol=1e-3)


def test_mass_and_size_are_the_burgers():
    model = load_robot(RobotSettings(), CameraSettings()).compile()
    assert model.body_mass.sum() == pytest.approx(1.0, abs=0.01)
    drawn = model.geom_group == 2
    assert not model.geom_contype[drawn].any() and not model.geom_conaffinity[drawn].any()
    bumper = model.geom("bumper")
    assert bumper.size[0] == RADIUS_M
    # All that is drawn of the body stays within its round outline, so that turning sweeps nothing new.
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for geom in np.flatnonzero(drawn | (model.geom_group == 3)):
        rotation = data.geom_xmat[geom].reshape(3, 3)
        corners = np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1).T * model.geom_aabb[geom, 3:]
        place = data.geom_xpos[geom] + corners @ rotation.T
        round_upright = model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CYLINDER and abs(rotation[2, 2]) > 0.99
        reach = model.geom_size[geom, 0] + np.hypot(*data.geom_xpos[geom, :2])
        assert (reach if round_upright else np.hypot(*place[:, :2].T).max()) <= RADIUS_M + 5e-4


def test_scene_for_people_loads():
    model = mujoco.MjModel.from_xml_path(str(ROBOT / "scene.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 200)
    assert data.ncon == 3
