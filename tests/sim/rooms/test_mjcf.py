import os
import re
import time
from itertools import islice
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.errors import InputError
from sim.robot.chassis import AMBIENT_LIGHT, LAMPLESS_AMBIENT_LIGHT, compile_scene
from sim.robot.model import RADIUS_M, wheel_speeds
from sim.robot.world import RoomWorld
from sim.rooms.free_space import find_free_space
from sim.rooms.mjcf import list_notes, load_room
from sim.rooms.mjcf_files import list_files, try_out
from sim.settings import DriveSettings, SimSettings
from tests.helpers.small_room import drive

WALLS = """
<geom type="box" size="0.1 2 1" pos="2.1 0 1"/><geom type="box" size="0.1 2 1" pos="-2.1 0 1"/>
<geom type="box" size="2 0.1 1" pos="0 1.6 1"/><geom type="box" size="2 0.1 1" pos="0 -1.6 1"/>
"""


def _write(folder: Path, body: str, head: str = "", name: str = "room.xml") -> Path:
    path = folder / name
    path.write_text(f"<mujoco>{head}<worldbody>{body}</worldbody></mujoco>")
    return path


def _refusal(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        load_room(path)
    text = str(caught.value)
    assert "\n" not in text
    assert text.startswith(f"room.mjcf {path}: ")
    return text.removeprefix(f"room.mjcf {path}: ")


def test_a_room_without_a_floor_gets_one_and_its_free_space_is_found(tmp_path):
    model = load_room(_write(tmp_path, WALLS)).compile()
    assert model.geom("floor").type == mujoco.mjtGeom.mjGEOM_PLANE
    space = find_free_space(model, 0.105, 0.37)
    assert space.shorter_side_m == pytest.approx(3.0, abs=0.02)


@pytest.mark.parametrize(
    "floor",
    [
        '<geom type="plane" size="5 5 1"/>',
        '<geom type="plane" size="5 5 1"/><geom type="box" size="0.4 0.3 0.1" pos="0 0 -0.1"/>',
        '<geom type="box" size="3 3 0.1" pos="0 0 -0.1"/>',
        '<body pos="0 0 -1"><geom type="box" size="3 3 0.5" pos="0 0 0.5"/></body>',
    ],
)
def test_its_own_floor_is_kept_and_carries_the_robot(tmp_path, floor):
    model = load_room(_write(tmp_path, WALLS + floor)).compile()
    assert (model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE).sum() == 1
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    assert mujoco.mj_ray(model, data, np.array([0.2, 0.1, 1.0]), np.array([0.0, 0, -1]), None, 1, -1, None) == 1.0
    assert find_free_space(model, 0.105, 0.37).shorter_side_m == pytest.approx(3.0, abs=0.02)


def test_a_robot_that_drives_off_a_box_that_is_the_only_floor_does_not_fall(tmp_path):
    path = _write(tmp_path, WALLS + '<geom name="doormat" type="box" size="0.3 0.3 0.01" pos="0 0 -0.01"/>')
    world = RoomWorld(SimSettings(), load_room(path))
    world.place(np.zeros(3))
    for period in range(200):
        world.step(wheel_speeds(min(0.004 * period, 0.3), 0.0))
    assert world.pose()[0] > 0.5  # the doormat ends at 0.3 m
    assert world.snapshot()[2] == pytest.approx(-0.002, abs=0.001)


def test_a_hole_between_boxes_is_no_floor_and_stops_the_robot_but_a_crack_is_floor(tmp_path):
    pit = '<geom type="plane" size="9 9 1" pos="0 0 -10"/>'
    sides = "".join(
        f'<geom type="box" size="2 {size} 0.1" pos="0 {y} -0.1"/>' for y, size in ((-1.1, 0.5), (0.5, 1.09))
    )
    assert list_notes(load_room(_write(tmp_path, WALLS + pit + sides)).compile()) == []
    gap = "".join(f'<geom type="box" size="{size} 1.6 0.1" pos="{x} 0 -0.1"/>' for x, size in ((-0.5, 1.5), (1.7, 0.3)))
    room = load_room(_write(tmp_path, WALLS + pit + gap))
    assert list_notes(room.compile()) == [
        "room: holes in its floor, of 1.3 m2 in all, are no floor: they stop the robot"
    ]
    world, rng = RoomWorld(SimSettings(), room), np.random.default_rng(0)
    world.start(rng)
    for segment in islice(drive(world, DriveSettings(), rng), 8):
        assert (segment.pose[:, 0] < 1.0 - RADIUS_M).all()
        assert world.is_free(segment.pose[:, :2]).all()


PIT = '<geom type="box" size="9 9 0.1" pos="0 0 -1"/>'
STAGE = '<geom type="box" size="1 2 0.1" pos="-1 0 -0.1"/>'


@pytest.mark.parametrize(
    ("body", "said"),
    [("", None), (PIT, "over what lies below it"), (STAGE, "beyond the ends of its boxes")],
)
def test_a_floor_that_is_added_over_something_is_noted(body: str, said: str | None, tmp_path: Path):
    notes = list_notes(load_room(_write(tmp_path, WALLS + body)).compile())
    assert notes == ([f"room: a plane at z = 0 is added as its floor, also {said}"] if said else [])


def test_a_floor_at_another_height_is_named(tmp_path: Path):
    high = load_room(_write(tmp_path, WALLS + '<geom type="plane" size="5 5 1" pos="0 0 0.2"/>'))
    with pytest.raises(InputError, match=r"it has a floor at z = 0\.2 m, which must be at 0"):
        find_free_space(high.compile(), 0.105, 0.37)


def test_a_floor_that_is_only_drawn_is_no_floor(tmp_path):
    drawn = '<geom name="floor" type="plane" size="5 5 1" contype="0" conaffinity="0"/>'
    model = load_room(_write(tmp_path, WALLS + drawn)).compile()
    assert model.geom("floor_below").contype == 1


def test_nothing_in_it_moves_or_acts(tmp_path):
    head = '<option gravity="0 0 9" timestep="0.1"/><actuator><motor joint="slide"/></actuator>'
    head += '<sensor><jointpos joint="slide"/></sensor><equality><weld body1="ball" body2="cart"/></equality>'
    head += '<tendon><fixed><joint joint="slide" coef="1"/></fixed></tendon>'
    head += '<keyframe><key qpos="1 2 3 4 5 6 7 8"/></keyframe>'
    body = '<body name="cart"><joint name="slide" type="slide"/><geom size="0.1" pos="1 0 0.2"/></body>'
    body += '<body name="ball"><freejoint/><geom size="0.1" pos="0 1 0.3"/></body>'
    body += '<body name="ghost" mocap="true"><geom size="0.1" pos="0 -1 0.3"/></body>'
    spec = load_room(_write(tmp_path, WALLS + body, head))
    model = spec.compile()
    counts = (model.nq, model.nv, model.nu, model.nsensor, model.neq, model.ntendon, model.nkey, model.nmocap)
    assert counts == (0,) * 8
    assert {"cart", "ball", "ghost"} <= {model.body(body).name for body in range(model.nbody)}


def test_compiler_settings_and_own_assets_work(tmp_path):
    (tmp_path / "meshes").mkdir()
    (tmp_path / "parts.xml").write_text('<mujocoinclude><geom name="part" size="0.1" pos="0 0 2"/></mujocoinclude>')
    (tmp_path / "meshes" / "tent.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
    )
    head = '<compiler angle="radian" meshdir="meshes"/><asset><mesh name="tent" file="tent.obj"/></asset>'
    body = '<geom type="mesh" mesh="tent" euler="0 0 1.5707963"/><include file="parts.xml"/>'
    model = load_room(_write(tmp_path, WALLS + body, head)).compile()
    assert model.nmesh == 1
    assert model.geom("part").pos[2] == 2.0
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    tent = next(i for i in range(model.ngeom) if model.geom_type[i] == mujoco.mjtGeom.mjGEOM_MESH)
    # Turned by a quarter: its corner at x = 1 has come to y = 1, so its middle lies at negative x.
    assert data.geom_xpos[tent, 0] < 0 < data.geom_xpos[tent, 1]


GEOM = '<geom size="1"/>'
OUTSIDE = {
    "include file ../secret.xml": '<include file="../secret.xml"/>',
    "include file /etc/passwd": '<include file="/etc/passwd"/>',
    "include file link.xml": '<include file="link.xml"/>',
    "mesh file ../secret.obj": '<asset><mesh file="../secret.obj"/></asset>',
    "mesh file secret.obj": '<compiler meshdir="linked"/><asset><mesh file="secret.obj"/></asset>',
    "compiler meshdir ..": '<compiler meshdir=".."/><asset><mesh file="secret.obj"/></asset>',
    "compiler texturedir /etc": '<compiler texturedir="/etc"/><asset><texture type="2d" file="a.png"/></asset>',
    "texture fileright ../a.png": '<asset><texture type="cube" fileright="../a.png"/></asset>',
    "model file ../secret.xml": '<asset><model name="m" file="../secret.xml"/></asset>',
    "compiler assetdir ../x": '<include file="inner.xml"/>',
}


def test_nothing_outside_its_own_folder_is_opened(tmp_path):
    inner = tmp_path / "room"
    inner.mkdir()
    for name in ("secret.xml", "secret.obj"):
        (tmp_path / name).write_text("<mujocoinclude/>")
    (inner / "link.xml").symlink_to(tmp_path / "secret.xml")
    (inner / "linked").symlink_to(tmp_path)
    (inner / "inner.xml").write_text('<mujocoinclude><compiler assetdir="../x"/></mujocoinclude>')
    for start, head in OUTSIDE.items():
        with pytest.raises(InputError, match="its own folder") as caught:
            try_out(_write(inner, WALLS, head), "room")
        assert str(caught.value).startswith(start)
    assert _refusal(_write(inner, "", OUTSIDE["mesh file secret.obj"])).startswith("mesh file secret.obj: lies outside")


def test_what_is_no_room_is_refused_in_one_line(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "broken.obj").write_text("v 0 0 0\nv nan 1 0\nf 1 2 9\n")
    for content, reason in (
        ("hello", "not XML: "),
        ("<robot/>", "not an MJCF file: its root is <robot>, and must be <mujoco>"),
        ("<mujoco><worldbody><geom sise='1'/></worldbody></mujoco>", "MuJoCo cannot read it: "),
        ("<mujoco><extension><plugin plugin='x'/></extension></mujoco>", "extensions are not allowed"),
        ("<mujoco><include file='missing.xml'/></mujoco>", "MuJoCo cannot read it: .*missing.xml"),
        ("<mujoco><asset><mesh file='broken.obj'/></asset></mujoco>", "MuJoCo cannot read it: .*broken"),
        ("<mujoco><asset><mesh file='pipe'/></asset></mujoco>", "mesh file pipe is a pipe or a device"),
        (f"<mujoco><worldbody><geom size='1' pos='1e308 0 0'/>{GEOM}</worldbody></mujoco>", "far away"),
        ('<!DOCTYPE mujoco [<!ENTITY s SYSTEM "file:///etc/passwd">]><mujoco>&s;</mujoco>', "a DOCTYPE, an entity"),
        ("<mujoco xmlns='u'/>", "a namespace is not allowed"),
        ("<mujoco>\xe4</mujoco>".encode("latin-1"), "is not UTF-8 text"),
    ):
        (tmp_path / "room.xml").write_bytes(content if isinstance(content, bytes) else content.encode())
        with pytest.raises(InputError, match=reason) as caught:
            try_out(tmp_path / "room.xml", "room")
        assert "\n" not in str(caught.value)


def test_a_machine_without_mujoco_lists_the_files_of_a_room(tmp_path, monkeypatch):
    path = _write(tmp_path, WALLS + '<include file="parts.xml"/>')
    (tmp_path / "parts.xml").write_text(f"<mujocoinclude>{GEOM}</mujocoinclude>")
    hidden = tmp_path / "hidden"
    hidden.mkdir()
    (hidden / "mujoco.py").write_text("raise ModuleNotFoundError(name=__name__)")
    monkeypatch.syspath_prepend(hidden)
    assert list_files(path) == [path, tmp_path / "parts.xml"]
    assert _refusal(_write(tmp_path, "", '<include file="../secret.xml"/>')).startswith("include file ../secret.xml")


def test_a_path_that_is_no_file_is_named(tmp_path):
    os.mkfifo(tmp_path / "pipe.xml")
    for name, reason in (("none.xml", ": no such file"), ("", " is a folder"), ("pipe.xml", " is a pipe or a device")):
        with pytest.raises(InputError, match=reason) as caught:
            load_room(tmp_path / name)
        assert str(caught.value).startswith(f"room.mjcf {tmp_path / name}")


BOMBS = {
    "deep": (8, "<body>" * 200_000 + "</body>" * 200_000, ""),
    "huge": (0, GEOM, '<asset><texture builtin="flat" width="60000" height="60000"/></asset>'),
    "many": (0, '<replicate count="1000">' * 3 + GEOM + "</replicate>" * 3, ""),
    "twice": (25, "", '<asset><model name="n" file="m0.xml"/></asset>'),
}


@pytest.mark.parametrize(
    "name", ["huge", *(pytest.param(name, marks=pytest.mark.slow) for name in ("deep", "many", "twice"))]
)
def test_a_bomb_ends_in_one_line(tmp_path, name):
    files, body, head = BOMBS[name]
    for number in range(files):
        twice = "".join(f'<attach model="n" body="b" prefix="{prefix}"/>' for prefix in "xy")
        following = f'<asset><model name="n" file="m{number + 1}.xml"/></asset>'
        _write(tmp_path, f'<body name="b">{twice}</body>', following, f"m{number}.xml")
    _write(tmp_path, f'<body name="b">{GEOM}</body>', name=f"m{files}.xml")
    before = time.perf_counter()
    _refusal(_write(tmp_path, body, head))
    assert time.perf_counter() - before < 60.0


def test_sizes_that_claim_memory_are_left_out_and_no_warning_is_written(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    head = '<size memory="1T" nuser_body="1000000000" nkey="2000000000" nuserdata="2000000000"/>'
    head += '<visual><global offwidth="100000" offheight="100000"/></visual>'
    model = load_room(_write(tmp_path, WALLS, head)).compile()
    assert (model.nuser_body, model.nkey, model.nuserdata, model.vis.global_.offwidth) == (0, 0, 0, 640)
    data = mujoco.MjData(compile_scene(load_room(_write(tmp_path, WALLS)), SimSettings()))
    data.qpos[:] = float("nan")
    mujoco.mj_step(data.model, data)
    assert data.warning.number.any()
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()
    assert capfd.readouterr() == ("", "")


SEED = (
    '<mujoco><compiler angle="radian"/><default><geom rgba="1 0 0 1"/></default><asset><texture name="t" type="2d" '
    'builtin="flat" width="8" height="8"/><mesh name="m" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/></asset><worldbody>'
    '<replicate count="3" offset="1 0 0"><geom type="box" size="1 1 1" pos="0 0 1"/></replicate><body name="b" '
    'quat="1 0 0 0"><geom type="mesh" mesh="m"/></body></worldbody></mujoco>'
)
WORDS = re.findall(r'[\w.]+|[<>/="]', SEED)
OTHERS = ["nan", "inf", "1e308", "-1", "999999999", "0x1p999", "", "robot/base", "include", "file", "..", "model", "é"]


@given(st.lists(st.tuples(st.integers(0, len(WORDS) - 1), st.sampled_from([*OTHERS, *WORDS])), min_size=1, max_size=3))
def test_any_change_of_a_room_is_a_room_or_one_line(tmp_path_factory, changes):
    text = SEED
    for number, word in changes:
        places = [match.span() for match in re.finditer(r'[\w.]+|[<>/="]', text)]
        start, end = places[number % len(places)]
        text = text[:start] + word + text[end:]
    path = tmp_path_factory.getbasetemp() / "any.xml"
    path.write_text(text)
    try:
        assert try_out(path, "room") == [path]
    except InputError as error:
        assert str(error).isprintable()
        assert len(str(error)) < 1000


def _mesh(name: str, points: str) -> str:
    return f'<mesh name="{name}" vertex="{points}"/>'


def test_walls_of_one_mesh_are_explained(tmp_path):
    corners = " ".join(f"{x} {y} {z}" for x in (-2, 2) for y in (-2, 2) for z in (0, 1))
    head = f"<asset>{_mesh('walls', corners)}</asset>"
    model = load_room(_write(tmp_path, '<geom type="mesh" mesh="walls"/>', head)).compile()
    with pytest.raises(
        InputError, match="no free space is enclosed by walls; MuJoCo collides a mesh as its convex hull"
    ):
        find_free_space(model, 0.105, 0.37)
    drawn = WALLS.replace("/>", ' contype="0" conaffinity="0" name="a"/>', 1)
    with pytest.raises(InputError, match=r"walls; these of its geoms are only drawn \(contype and conaffinity 0\): a$"):
        find_free_space(load_room(_write(tmp_path, drawn)).compile(), 0.105, 0.37)
    open_room = load_room(_write(tmp_path, '<geom type="box" size="1 1 1" pos="0 0 1"/>')).compile()
    with pytest.raises(InputError, match=r"no free space is enclosed by walls$"):
        find_free_space(open_room, 0.105, 0.37)


def test_lamps_that_are_not_drawn_do_not_count_and_many_triangles_are_named(tmp_path, monkeypatch):
    point, spot = '<light type="point" pos="0 0 2"/>', '<light pos="0 0 2"/>'
    for lamps, ambient, notes in (
        ("", LAMPLESS_AMBIENT_LIGHT, 0),
        (point, LAMPLESS_AMBIENT_LIGHT, 1),
        (point + spot, AMBIENT_LIGHT, 1),
        (spot, AMBIENT_LIGHT, 0),
    ):
        room = load_room(_write(tmp_path, WALLS + lamps))
        model = compile_scene(room, SimSettings())
        assert model.vis.headlight.ambient == pytest.approx([ambient] * 3)
        assert len(list_notes(room.compile())) == notes
    monkeypatch.setattr("sim.rooms.mjcf._count_triangles", lambda _: 146_000)
    assert "146,000 triangles" in list_notes(model)[-1]
