"""A robot of one's own: measured, driven and refused; the testbed's own robot stays as it is, byte for byte."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from deepgps.config.scenario import load_scenario
from deepgps.runs.inputs import digest
from sim.errors import InputError
from sim.robot.calibrate import calibrate_own, run
from sim.robot.drive import TOUCH_ENDINGS, next_segment
from sim.robot.headings import DriveMode, Visits
from sim.robot.model import CAMERA, CAMERA_SITE, RADIUS_M, TRACK_M, WHEEL_RADIUS_M
from sim.robot.own import describe_own, load_own_robot
from sim.robot.range_finder import clear_length
from sim.robot.world import RoomWorld
from sim.robot_log.log import check_log
from sim.rooms.mjcf_files import list_files
from sim.rooms.spec import ROBOT_PREFIX, empty_room
from sim.settings import RobotSettings, RoomSettings, SimSettings

EXAMPLE = Path(__file__).parents[3] / "docs" / "examples" / "my_robot.xml"
NAMES = {"left_joint": "left_drive", "right_joint": "right_drive", "camera_site": "eye"}


def robot(path: Path = EXAMPLE, **names: str) -> RobotSettings:
    return RobotSettings.model_validate({"mjcf": str(path), **NAMES, **names})


@pytest.fixture(scope="module")
def world() -> RoomWorld:
    return RoomWorld(SimSettings(robot=robot()), empty_room())


def test_the_page_shows_the_example():
    page = (EXAMPLE.parents[1] / "how-to" / "room-and-robot.md").read_text()
    assert EXAMPLE.name in page and all(name in page for name in NAMES.values())


def test_a_robot_twice_as_large_is_measured_as_such(world: RoomWorld):
    assert world.body.radius_m == pytest.approx(0.2, abs=1e-4)
    assert world.body.height_m == pytest.approx(0.5)
    assert world.body.wheel_radius_m == pytest.approx(2 * 0.033, rel=2e-3)
    assert world.body.track_m == pytest.approx(2 * 0.16, rel=2e-3)


def test_its_encoder_distances_and_turns_are_right_to_a_thousandth(world: RoomWorld):
    world.place(np.zeros(3))
    run(world, 0.15, 0.0, 10.0)
    distance_m = np.hypot(*world.pose()[:2])
    assert world.wheel_angle().mean() * world.body.wheel_radius_m == pytest.approx(distance_m, rel=1e-3)
    world.place(np.zeros(3))
    yaw = run(world, 0.0, 0.8, 10.0)
    left, right = world.wheel_angle()
    turned = (right - left) * world.body.wheel_radius_m / world.body.track_m
    assert turned == pytest.approx(np.unwrap(yaw)[-1], rel=1e-3)
    assert not world.bumped()


def test_it_drives_in_a_room_and_keeps_its_own_distance_from_walls():
    settings = SimSettings(room=RoomSettings(width_m=5.0, depth_m=4.0), robot=robot())
    world, rng = RoomWorld(settings, drawn=False), np.random.default_rng(0)
    world.start(rng)
    mode, visits = DriveMode(), Visits(world.body, world.wheel_angle())
    for _ in range(4):
        segment = next_segment(world, settings.drive, rng, mode, visits)
        mode = segment.mode
        assert world.is_free(segment.pose[:, :2]).all()
        distance_m = np.linalg.norm(segment.pose[-1, :2] - segment.pose[0, :2])
        wheels = segment.wheel_angle[-1] - segment.wheel_angle[0]
        lead_m = 1e-3 if segment.ended in TOUCH_ENDINGS else 2e-4  # a sample taken in motion runs ahead of the wheels
        assert wheels.mean() * world.body.wheel_radius_m == pytest.approx(distance_m, rel=2e-3, abs=lead_m)
    ours = RoomWorld(SimSettings(room=settings.room), drawn=False)
    assert world.free_space.reachable.sum() < ours.free_space.reachable.sum()
    assert clear_length(world.ranges(), world.body.radius_m) < clear_length(world.ranges(), 0.01)


def changed(tmp_path: Path, *changes: tuple[str, str]) -> Path:
    text = EXAMPLE.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (tmp_path / "robot.xml").write_text(text)
    return tmp_path / "robot.xml"


WORLD = ("<worldbody>", '<worldbody><body name="another"/>')
REFUSED_ROBOTS = [
    ([("<option", '<include file="../other.xml"/><option')], {}, r"robot\.mjcf"),
    ([("<option", "<extension/><option")], {}, "extensions"),
    ([("</mujoco>", "")], {}, "not XML"),
    ((), {"left_joint": "wheel"}, r"robot\.left_joint wheel.* left_drive, right_drive"),
    ((), {"right_joint": "left_drive"}, r"robot\.right_joint left_drive"),
    ((), {"camera_site": "lens"}, r"robot\.camera_site lens.* eye"),
    ((), {"left_joint": "right_drive", "right_joint": "left_drive"}, "the middle of its wheel axle"),
    ([('kv="0.6"', 'kv="0.06" gear="10"')], {}, "left_drive has gear 10"),
    ([WORLD], {}, "holds 2"),
    ([('kv="0.6"', 'kv="0"')], {}, "no velocity actuator .*left_drive"),
    ([('name="left_drive" axis="0 1 0"', 'name="left_drive" axis="0 -1 0"')], {}, "axis 0 1 0"),
    ([('name="eye" pos="0 0 0.5"', 'name="eye" pos="0.05 0 0.5"')], {}, "camera_mount"),
]
TRIED_CASES = 3
"""Number of the first cases, which the trial refuses; the others pass it."""


def test_what_is_wrong_with_it_is_said_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    for number, (changes, names, message) in enumerate(REFUSED_ROBOTS):
        if number == TRIED_CASES:
            monkeypatch.setattr("sim.rooms.mjcf_files.list_files", lambda *_: [])
        with pytest.raises(InputError, match=message) as error:
            describe_own(robot(changed(tmp_path, *changes), **names))
        assert "\n" not in str(error.value) and "robot." in str(error.value)


EYE = '<site name="eye" pos="0 0 0.5"/>'
LOWER_BODIES = [
    *((f'pos="0 {side} 0.066"', f'pos="0 {side} 0.046"') for side in ("0.16", "-0.16")),
    ('pos="-0.15 0 0.02"', 'pos="-0.15 0 0.0"'),
]
RIGHT_WHEEL = (
    'name="right_drive" axis="0 1 0" damping="0.0004" armature="0.004"/>\n        <geom type="ellipsoid" size='
)
SMALLER_WHEEL = [
    ("0 -0.16 0.066", "0 -0.16 0.064"),
    (RIGHT_WHEEL + '"0.066 0.018 0.066"', RIGHT_WHEEL + '"0.064 0.018 0.064"'),
]
FLAT_WHEELS = [('type="ellipsoid" size="0.066 0.018 0.066"', 'type="cylinder" size="0.066 0.018" euler="1.5708 0 0"')]
SKIRT = '<geom name="skirt" type="cylinder" size="0.1 0.01" pos="0 0 0.01" mass="0"/>'
TWO_LOW_CASTERS = [('pos="-0.15 0 0.02"', 'pos="-0.15 0 0.017"')]
TWO_LOW_CASTERS += [(EYE, EYE + '<geom type="sphere" size="0.02" pos="0.15 0 0.017" mass="0" condim="1"/>')]
REFUSED_DRIVES = [
    ([('pos="-0.15 0 0.02"', 'pos="-0.15 0 0.30"')], "does not stay level on a level floor: a caster is missing"),
    (LOWER_BODIES, r"0\.02 m above the floor"),
    (FLAT_WHEELS, r"its left wheel is not round about the axis, .* to 68.* mm: is its euler in radians"),
    ([('kv="0.6"', 'kv="0.6" ctrlrange="-0.5 0.5"')], r"turn at 3\.33 rad/s, and their ctrlrange ends at 0\.5"),
    ([('forcerange="-8 8"', 'forcerange="-0.0001 0.0001"')], r"rolled 0\.\d+ m: its motors are too weak"),
    (
        [('pos="-0.05 0 0.12"', 'pos="-0.005 0 0.3"')],
        r"tips forward when it brakes, by 1\d degrees: .*4\.2 kg .* in front",
    ),
    ([('friction="1 0.005', 'friction="0.005 0.005')], r"drove 4\.\d+ m: its wheels slip by 1\d\.\d % .*mass"),
    (
        [('friction="1 0.005', 'friction="0.04 0.005')],
        r"wheels slip by \d\d mm within 1 s, as it starts or brakes .*friction",
    ),
    (SMALLER_WHEEL, r"turned by -2\d degrees: its wheels differ \(axis, radius\)"),
    ([(EYE, EYE + SKIRT)], r"its body \(geom skirt\) touches the floor: a caster"),
    (TWO_LOW_CASTERS, r"its left wheel is off the floor for 2\d s: a caster is too low"),
]


def test_one_that_tips_slips_or_curves_is_refused_before_it_drives_with_the_likely_cause(tmp_path: Path):
    for changes, message in REFUSED_DRIVES:
        with pytest.raises(InputError, match=rf"robot\.mjcf \S+: [^\n]*{message}"):
            calibrate_own(SimSettings(robot=robot(changed(tmp_path, *changes))))


def test_meshes_and_textures_for_looks_are_left_out_unread_and_those_that_collide_are_named(tmp_path: Path):
    assets = '<mesh name="shell" file="/nowhere/shell.stl"/><texture name="t" type="2d" file="none.png"/>'
    assets = f'<asset>{assets}<material name="m" texture="t"/></asset><worldbody>'
    look = '<geom type="mesh" mesh="shell" material="m" contype="0" conaffinity="0"/>'
    changes = ("<worldbody>", assets), (EYE, EYE + look), ('size="0.20 0.15"', 'size="0.2 0.15" material="m"')
    pair = ("<contact>", '<contact><pair geom1="skirt" geom2="floor" condim="1" friction="0.05"/>')
    skirt = load_own_robot(robot(changed(tmp_path, (EYE, EYE + SKIRT), pair))).geom("skirt")
    assert (skirt.condim, skirt.friction[0]) == (1, 0.05)
    path = changed(tmp_path, *changes)
    assert list_files(path, "robot") == [path]
    assert describe_own(robot(path)) == describe_own(robot())
    solid = changed(tmp_path, ("<worldbody>", assets), (EYE, EYE + '<geom name="top" type="mesh" mesh="shell"/>'))
    with pytest.raises(InputError, match=r"^robot\.mjcf \S+: its geom top is a mesh that collides"):
        describe_own(robot(solid))


def test_the_camera_that_dm_env_shows_is_where_the_eye_is(tmp_path: Path):
    mast = f'<body name="mast" pos="0.1 0 0.2" euler="0 0 90">{EYE.replace("0 0 0.5", "0 0.1 0.3", 1)}</body>'
    turned = mast.replace('0.3"/>', '0.3" euler="0 0 -90"/>')
    for path in (EXAMPLE, changed(tmp_path, (EYE, turned))):
        world = RoomWorld(SimSettings(robot=robot(path)), empty_room())
        world.place(np.zeros(3))
        data = world.data
        assert data.cam(ROBOT_PREFIX + CAMERA).xpos == pytest.approx(data.site(ROBOT_PREFIX + CAMERA_SITE).xpos)
        assert data.cam(ROBOT_PREFIX + CAMERA).xmat.reshape(3, 3)[2] == pytest.approx([0.0, 0.0, -1.0], abs=0.01)


def test_springs_are_at_rest_where_it_is_placed(tmp_path: Path):
    spring = '<joint name="spring" type="slide" axis="0 0 1" stiffness="100" damping="10"/>'
    load = f'<body name="load" pos="0 0 0.45">{spring}<geom type="sphere" size="0.01" mass="0.5" contype="0"/></body>'
    world = RoomWorld(SimSettings(robot=robot(changed(tmp_path, (EYE, load + EYE)))), empty_room())
    world.place(np.zeros(3))
    settled_m = world.data.joint(f"{ROBOT_PREFIX}spring").qpos[0]
    assert settled_m == pytest.approx(-0.5 * 9.81 / 100, rel=0.02)
    world.advance(200)
    assert world.data.joint(f"{ROBOT_PREFIX}spring").qpos[0] == pytest.approx(settled_m, abs=1e-4)


SHELL = (
    '<geom type="cylinder" size="0.20 0.15" pos="0 0 0.19" mass="0" friction="0.2 0.005 0.0001" rgba="0.2 0.3 0.5 1"/>'
)


SMALL_SHELL = ('size="0.20 0.15" pos="0 0 0.19"', 'size="0.05 0.15" pos="0 0 0.19"')


@pytest.mark.parametrize(
    "change",
    [(SHELL, SHELL), (SHELL, f'<body name="shell" pos="0 0.01 0" euler="0 0 30">{SHELL}</body>'), SMALL_SHELL],
    ids=["its body", "a part that is fixed to it", "its wheels"],
)
def test_it_feels_what_it_pushes_against(change: tuple[str, str], tmp_path: Path):
    room = empty_room()
    room.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=(0.1, 1.0, 0.5), pos=(0.5, 0.0, 0.5))
    room.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=(0.1, 1.0, 0.002), pos=(0.25, 0.0, 0.002))
    world = RoomWorld(SimSettings(robot=robot(changed(tmp_path, change))), room)
    world.place(np.zeros(3))
    felt = [world.bumped()]
    while not felt[-1] and len(felt) < 100:
        world.step(np.full(2, 3.0))
        felt.append(world.bumped())
    reach_m = 0.066 if change is SMALL_SHELL else 0.2
    assert felt[-1], "it drove against a wall for seconds and felt nothing"
    assert world.pose()[0] == pytest.approx(0.4 - reach_m, abs=0.01), "rolling over 4 mm is no contact"


def test_settings_that_contradict_it_and_a_log_of_it_are_refused(tmp_path: Path):
    for overrides, message in (
        ({"robot.wheel_radius_error": 0.01}, "wheel_radius_error 0.01 must be 0"),
        ({"camera.height_m": 0.4}, "camera.height_m 0.4 must be left out"),
    ):
        with pytest.raises(InputError, match=message):
            load_scenario("tiny", {"robot.mjcf": str(EXAMPLE), **overrides})
    with pytest.raises(InputError, match="logs are of the testbed's own robot"):
        check_log(tmp_path / "drive.mcap", SimSettings(robot=robot()))


def test_without_one_nothing_changes_and_with_one_its_file_counts(tmp_path: Path):
    assert RobotSettings().model_dump() == {"wheel_radius_error": 0.0}
    world = RoomWorld(SimSettings(), empty_room())
    assert (world.body.radius_m, world.body.wheel_radius_m, world.body.track_m) == (RADIUS_M, WHEEL_RADIUS_M, TRACK_M)
    path = changed(tmp_path)
    first = digest(load_scenario("tiny", {"robot.mjcf": str(path)}))
    path.write_text(path.read_text() + "\n")
    assert digest(load_scenario("tiny", {"robot.mjcf": str(path)})) != first
