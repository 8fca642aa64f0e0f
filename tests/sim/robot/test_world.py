"""The world: forced physics, exact states, sensors against geometry."""

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.errors import WorkError
from sim.robot.chassis import compile_scene
from sim.robot.model import RADIUS_M, wheel_speeds
from sim.robot.range_finder import REACH_M, SIDE_TOLERANCE_M, RangeFinder, clear_length, fan_heights, lay_fan
from sim.robot.world import RoomWorld
from sim.rooms.spec import empty_room
from sim.settings import RoomSettings, SimSettings
from tests.helpers.small_room import HALF_X, HALF_Y, add_box, furnished, walls

ANGLE = lay_fan(RADIUS_M).angle
HOSTILE_MODEL = """
<mujoco>
  <compiler settotalmass="50" boundmass="3"/>
  <option timestep="0.02" gravity="1 2 -3" integrator="RK4" density="1000" viscosity="5" wind="9 0 0" cone="pyramidal"
    impratio="7" o_margin="0.2" iterations="1">
    <flag contact="disable" override="enable" gravity="disable"/>
  </option>
  <default><geom friction="0.01 0 0" priority="9" margin="0.05" solref="0.5 1" condim="1"/></default>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 .1"/>
    <body pos="0 0 3" name="bomb" gravcomp="1"><freejoint/><geom name="bomb" size=".2" mass="99"/></body>
    <body pos="3 3 1"><joint name="swing" axis="0 1 0"/><geom name="swing" size=".1"/></body>
  </worldbody>
  <actuator><motor name="swing" joint="swing"/></actuator>
  <sensor><jointpos joint="swing"/></sensor>
  <keyframe><key name="start" qpos="0 0 3 1 0 0 0 1"/></keyframe>
</mujoco>
"""


def drive_a_little(world: RoomWorld, periods: int = 60) -> np.ndarray:
    for i in range(periods):
        world.step(wheel_speeds(0.004 * min(i, 40), 0.5))
    return world.state()


def test_room_cannot_change_the_robots_physics():
    plain = RoomWorld(SimSettings(), empty_room())
    hostile = RoomWorld(SimSettings(), mujoco.MjSpec.from_string(HOSTILE_MODEL))
    for world in (plain, hostile):
        world.place(np.array([0.5, -0.5, 1.0]))
        drive_a_little(world)
    assert np.array_equal(plain.snapshot(), hostile.snapshot())
    assert np.array_equal(plain.data.qvel, hostile.data.qvel)
    assert not np.allclose(plain.pose()[:2], (0.5, -0.5), atol=0.1)
    assert hostile.model.opt.disableflags == mujoco.mjtDisableBit.mjDSBL_AUTORESET


def test_compiling_leaves_the_room_as_it_was():
    room = furnished()
    before = room.to_xml()
    compile_scene(room, SimSettings())
    RangeFinder(room, 0.35)
    assert room.to_xml() == before


def test_placed_robot_is_at_rest():
    world = RoomWorld(SimSettings(), walls())
    pose = np.array([0.4, -0.7, 2.5])
    world.place(pose)
    assert np.allclose(world.pose(), pose)
    assert not world.wheel_angle().any()
    for _ in range(100):
        world.step(np.zeros(2))
    assert np.allclose(world.pose(), pose, atol=1e-6)
    assert np.allclose(world.snapshot(), world.rest_states(pose[None])[0], atol=1e-6)


def test_state_returns_exactly():
    world = RoomWorld(SimSettings(), furnished())
    world.place(np.zeros(3))
    middle = drive_a_little(world)
    end = drive_a_little(world)
    fresh = RoomWorld(SimSettings(), furnished())
    for other in (world, fresh):
        other.set_state(middle)
        assert np.array_equal(other.state(), middle)
        assert np.array_equal(drive_a_little(other), end)


def test_broken_state_is_an_error(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its log where it stands
    world = RoomWorld(SimSettings(), walls())
    for value in (np.nan, np.inf, 1e12):
        world.place(np.zeros(3))
        world.data.qvel[0] = value
        with pytest.raises(WorkError, match=r"physics failed at .* s: MuJoCo warned .*mjWARN_BADQVEL"):
            world.step(np.zeros(2))


def test_wheel_sensors_are_read_where_the_robot_is():
    world = RoomWorld(SimSettings(), empty_room())
    world.place(np.zeros(3))
    drive_a_little(world)
    joints = [world.data.joint(f"robot/{name}").qpos[0] for name in ("left_wheel", "right_wheel")]
    assert np.array_equal(world.wheel_angle(), joints)
    assert min(joints) > 0


@given(st.floats(-1.8, 1.8), st.floats(-1.3, 1.3), st.floats(-3.1, 3.1))
def test_ranges_are_the_distances_to_the_walls(x, y, yaw):
    angle = yaw + ANGLE
    with np.errstate(divide="ignore", over="ignore"):
        to_x = (np.copysign(HALF_X, np.cos(angle)) - x) / np.cos(angle)
        to_y = (np.copysign(HALF_Y, np.sin(angle)) - y) / np.sin(angle)
    expected = np.minimum(np.minimum(to_x, to_y), REACH_M)
    measured = BARE_RAYS.measure(x, y, yaw, REACH_M).reshape(len(BARE_RAYS.heights_m), -1)
    assert np.allclose(measured, expected, atol=1e-9)


BARE_RAYS = RangeFinder(walls(), 0.35)


@given(st.floats(0.0, 0.5), st.floats(-0.5, 0.5))
def test_clear_length_to_a_wall(gap, slant):
    """The round body touches a slanted wall when its middle is a radius from it."""
    distance = (gap + RADIUS_M) / np.maximum(np.cos(ANGLE - slant), 1e-6)
    clear = clear_length(np.minimum(distance, REACH_M))
    # Where the touching point lies between two rays, they see the wall a little later.
    assert clear == pytest.approx(gap / np.cos(slant), abs=0.006)
    assert clear >= gap / np.cos(slant) - 1e-9


@given(st.floats(-0.2, 0.2), st.floats(0.15, 0.35))
def test_clear_length_to_a_pole(aside, ahead):
    """A pole of 4 cm is never missed when it is near, and never counts where the body passes it."""
    room = empty_room()
    half = 0.02
    add_box(room, "pole", (ahead + half, aside, 0.5), (half, half, 0.5))
    clear = clear_length(RangeFinder(room, 0.35).measure(0.0, 0.0, 0.0, REACH_M))
    nearest = max(abs(aside) - half, 0.0)
    if nearest > RADIUS_M + SIDE_TOLERANCE_M:
        assert clear > 3.0
    elif nearest < RADIUS_M - 0.025:
        assert clear == pytest.approx(ahead - np.sqrt(RADIUS_M**2 - nearest**2), abs=0.035)


def test_rays_see_what_collides_and_nothing_else():
    room = empty_room()
    add_box(room, "hidden", (1.0, 0, 0.5), (0.1, 0.5, 0.5))
    add_box(room, "curtain", (0.5, 0, 0.5), (0.01, 0.5, 0.5))
    curtain = room.geom("curtain")
    curtain.contype, curtain.conaffinity, curtain.rgba = 0, 0, (1, 1, 1, 1)
    world = RoomWorld(SimSettings(), room)
    world.place(np.zeros(3))
    assert clear_length(world.ranges()) == pytest.approx(0.9 - RADIUS_M, abs=1e-3)
    world.place(np.array([0.0, 0.0, np.pi]))
    # Nothing is there: the robot does not see itself either.
    assert (world.ranges() == REACH_M).all()
    assert clear_length(world.ranges(0.7)) == pytest.approx(0.7 - RADIUS_M)


def test_fans_reach_from_floor_to_top():
    for height_m in (0.06, 0.11, 0.2, 0.35, 1.5):
        heights = fan_heights(height_m)
        assert heights[0] < 0.02 and height_m - 0.02 < heights[-1] < height_m
        assert (np.diff(heights) > 0).all() and np.diff(heights).max() < 0.3


@pytest.mark.parametrize("height_m", [0.05, 0.25, 0.3])
def test_bumper_feels_what_the_body_and_the_mast_touch(height_m):
    room = empty_room()
    add_box(room, "bar", (0.5, 0, height_m), (0.02, 0.5, 0.01))
    world = RoomWorld(SimSettings(), room)
    world.place(np.zeros(3))
    felt = []
    for i in range(150):
        world.step(wheel_speeds(min(0.2, 0.01 * i), 0.0))
        felt.append(world.bumped())
        if felt[-1]:
            break
    assert felt[-1] and not any(felt[:-1])
    depth_m = RADIUS_M if height_m < 0.19 else 0.018
    assert world.pose()[0] == pytest.approx(0.48 - depth_m, abs=0.006)


def test_starts_in_free_space_of_a_built_room():
    world = RoomWorld(SimSettings(room=RoomSettings(kind="bedroom", seed=3)))
    world.start(np.random.default_rng(0))
    assert world.is_free(world.pose()[:2])
    low, high = world.bounds
    assert (low < world.pose()[:2]).all() and (world.pose()[:2] < high).all()
    assert not world.is_free(np.array([100.0, 0.0]))
    for _ in range(20):
        world.step(np.zeros(2))
    assert not world.bumped()
