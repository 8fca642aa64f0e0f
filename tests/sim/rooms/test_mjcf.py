import os
import re
import struct
import zlib
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.errors import InputError
from sim.robot.model import wheel_speeds
from sim.robot.scene import AMBIENT, AMBIENT_WITHOUT_LAMPS, compile_scene
from sim.robot.world import RoomWorld
from sim.rooms.free_space import find_free_space
from sim.rooms.mjcf import list_notes, load_room, vet
from sim.settings import SimSettings

OUTSIDE = "lies outside the room's own folder"
RELATIVE = "must be a path relative to the room's own folder"
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
    ("floor", "planes"),
    [
        ('<geom type="plane" size="5 5 1"/>', 1),
        ('<geom type="plane" size="5 5 1"/><geom type="box" size="0.4 0.3 0.1" pos="0 0 -0.1"/>', 1),
        ('<geom type="box" size="3 3 0.1" pos="0 0 -0.1"/>', 1),
        ('<body pos="0 0 -1"><geom type="box" size="3 3 0.5" pos="0 0 0.5"/></body>', 1),
    ],
)
def test_its_own_floor_is_kept_and_carries_the_robot(tmp_path, floor, planes):
    model = load_room(_write(tmp_path, WALLS + floor)).compile()
    assert (model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE).sum() == planes
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


@pytest.mark.parametrize(
    ("body", "head", "text"),
    [
        ('<include file="../secret.xml"/>', "", f"include file ../secret.xml: {OUTSIDE}"),
        (
            '<include file="/etc/passwd"/>',
            "",
            f"include file /etc/passwd: {RELATIVE}",
        ),
        ("", '<asset><mesh file="../a.obj"/></asset>', f"mesh file ../a.obj: {OUTSIDE}"),
        (
            "",
            '<compiler meshdir=".."/><asset><mesh file="a.obj"/></asset>',
            f"meshdir ..: {OUTSIDE}",
        ),
        (
            "",
            '<compiler texturedir="/etc"/><asset><texture type="2d" file="a.png"/></asset>',
            f"texturedir /etc: {RELATIVE}",
        ),
        (
            "",
            '<compiler assetdir="../x"/><asset><hfield name="h" file="a.png"/></asset>',
            f"assetdir ../x: {OUTSIDE}",
        ),
        (
            "",
            '<asset><texture type="cube" fileright="../a.png"/></asset>',
            f"texture fileright ../a.png: {OUTSIDE}",
        ),
        (
            "",
            '<asset><model name="m" file="../m.xml"/></asset>',
            f"model file ../m.xml: {OUTSIDE}",
        ),
        ("", '<extension><plugin plugin="x"/></extension>', "extensions are not allowed (<extension>)"),
        ("", '<actuator><plugin plugin="x"/></actuator>', "plugins are not allowed (<plugin>)"),
        ('<include file="missing.xml"/>', "", "include file missing.xml: no such file"),
        ('<include file="room.xml"/>', "", "room.xml includes itself"),
    ],
)
def test_what_reaches_out_of_its_folder_is_refused(tmp_path, body, head, text):
    inner = tmp_path / "room"
    inner.mkdir()
    (tmp_path / "secret.xml").write_text("<mujocoinclude/>")
    assert _refusal(_write(inner, WALLS + body, head)) == text


def test_a_link_that_leads_out_is_refused(tmp_path):
    inner = tmp_path / "room"
    inner.mkdir()
    (tmp_path / "secret.xml").write_text("<mujocoinclude/>")
    (inner / "link.xml").symlink_to(tmp_path / "secret.xml")
    text = _refusal(_write(inner, '<include file="link.xml"/>'))
    assert text == f"include file link.xml: {OUTSIDE}"


def test_a_folder_named_by_an_included_file_is_vetted(tmp_path):
    inner = tmp_path / "room"
    inner.mkdir()
    (inner / "a.xml").write_text('<mujocoinclude><compiler meshdir=".."/></mujocoinclude>')
    head = '<include file="a.xml"/><asset><mesh file="secret.obj"/></asset>'
    assert _refusal(_write(inner, "", head)) == f"meshdir ..: {OUTSIDE}"


def test_an_included_file_is_vetted_as_well(tmp_path):
    inner = tmp_path / "room"
    inner.mkdir()
    (inner / "a.xml").write_text('<mujocoinclude><include file="../secret.xml"/></mujocoinclude>')
    text = _refusal(_write(inner, '<include file="a.xml"/>'))
    assert text == f"include file ../secret.xml: {OUTSIDE}"


@pytest.mark.parametrize(
    "head",
    [
        '<!DOCTYPE mujoco [<!ENTITY s SYSTEM "file:///etc/passwd">]><mujoco>&s;</mujoco>',
        '<?xml version="1.0"?>\n<!DOCTYPE mujoco>\n<mujoco/>',
    ],
)
def test_entities_are_refused(tmp_path, head):
    path = tmp_path / "room.xml"
    path.write_text(head)
    assert _refusal(path) == "a DOCTYPE or an entity is not allowed in room.xml"


@pytest.mark.parametrize(
    ("content", "start"),
    [
        ("hello", "not XML: "),
        ("", "not XML: "),
        ("<robot/>", "not an MJCF file: its root is <robot>, and must be <mujoco>"),
        ("<mujoco><worldbody><geom sise='1'/></worldbody></mujoco>", "MuJoCo cannot read it: "),
        ("<mujoco><worldbody><geom size='-1'/></worldbody></mujoco>", "MuJoCo cannot read it: "),
    ],
)
def test_what_is_no_mjcf_is_refused(tmp_path, content, start):
    path = tmp_path / "room.xml"
    path.write_text(content)
    assert _refusal(path).startswith(start)


def test_text_in_another_encoding_is_refused(tmp_path):
    path = tmp_path / "room.xml"
    path.write_bytes('<?xml version="1.0" encoding="utf-16"?><mujoco/>'.encode("utf-16"))
    assert _refusal(path) == "room.xml is not UTF-8 text"


def test_a_missing_file_is_named(tmp_path):
    assert _refusal(tmp_path / "none.xml") == "no such file"
    assert _refusal(tmp_path) == f"{tmp_path.name} is a folder, not a file"


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def _picture(width: int, height: int, pixels: bytes, more: bytes = b"") -> bytes:
    head = _chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + head + more + _chunk(b"IDAT", zlib.compress(pixels)) + _chunk(b"IEND", b"")


GEOM = '<geom size="1"/>'
TEXTURE = '<asset><texture name="t" type="2d" file="a.png"/></asset>'


@pytest.mark.parametrize(
    ("body", "head", "text"),
    [
        (f'<replicate count="1000000000">{GEOM}</replicate>', "", "replicate count 1000000000 must be a whole number"),
        ('<replicate count="1000">' * 3 + GEOM + "</replicate>" * 3, "", "more than 200000 elements"),
        (f'<replicate count="9999">{GEOM}<site/></replicate>', "", "more than 10000 copies by replicate"),
        ('<replicate count="999999"><light/></replicate>', "", "more than 200000 elements"),
        (f'<replicate count="1e9">{GEOM}</replicate>', "", "replicate count 1e9 must be a whole number"),
        (GEOM, '<asset><texture builtin="flat" width="60000" height="60000"/></asset>', "at most 8192 pixels"),
        (GEOM, "<asset>" + '<texture builtin="flat" width="8000"/>' * 9 + "</asset>", "bytes of textures"),
        (
            GEOM,
            '<default><texture builtin="flat" width="8000"/></default><asset>' + "<texture/>" * 9 + "</asset>",
            "bytes of textures",
        ),
        (GEOM, '<asset><hfield nrow="100000" ncol="100000" size="1 1 1 1"/></asset>', "cells of terrain"),
        (GEOM, '<asset><mesh builtin="cone" params="1000000 1"/></asset>', "params 1000000 must be at most 256"),
        ("<body>" * 200 + "</body>" * 200, "", "more than 100 elements, one in the other"),
        ("<body/>" * 8001, "", "more than 8000 bodies"),
        (GEOM * 20_001, "", "more than 20000 geoms"),
        ("<light/>" * 1_001, "", "more than 1000 lights"),
        ('<replicate count="1001"><camera/></replicate>', "", "more than 1000 cameras"),
        ("<a/>" * 100_001, "", "more than 100000 elements"),
        ('<geom size="1" pos="nan 0 0"/>', "", "geom pos nan: a number must lie between"),
        ('<geom size="1" pos="0 -inf 0"/>', "", "geom pos -inf: a number must lie between"),
        ('<body quat="1e308 0 0 0"/>', "", "body quat 1e308: a number must lie between"),
        ('<geom size="1" mass="100e9"/>', "", "geom mass 100e9: a number must lie between"),
        ('<geom size="0x1p100"/>', "", "geom size 0x1p100: a number must lie between"),
        ('<body pos="9e9 0 0">' * 9 + GEOM + "</body>" * 9, "", "a geom is infinitely large or far away"),
        ('<body name="robot/base"/>', "", "the name 'robot/base' begins with robot/"),
        ("", '<include xmlns="u" file="../secret.xml"/>', "a namespace is not allowed in room.xml"),
        ("", '<asset><model name="m" file="room.xml"/></asset>', "room.xml includes itself"),
        ("", '<include file="a.xml"/><include file="a.xml"/>', "a.xml is included twice"),
        ('<attach model="m" prefix="x"/>', '<asset><model name="m"/></asset>', "no file has that model"),
    ],
)
def test_what_would_cost_too_much_or_is_no_number_is_refused_in_one_line(tmp_path, body, head, text):
    (tmp_path / "a.xml").write_text("<mujocoinclude/>")
    assert text in _refusal(_write(tmp_path, body, head))


def test_files_that_name_the_next_one_twice_are_refused(tmp_path):
    for number in range(25):
        following = f'<include file="f{number + 1}.xml"/>' * 2
        (tmp_path / f"f{number}.xml").write_text(f"<mujocoinclude>{following}</mujocoinclude>")
        twice = "".join(f'<attach model="n" body="b" prefix="{prefix}"/>' for prefix in "xy")
        head = f'<asset><model name="n" file="m{number + 1}.xml"/></asset>'
        _write(tmp_path, f'<body name="b">{twice}</body>', head, f"m{number}.xml")
    (tmp_path / "f25.xml").write_text("<mujocoinclude/>")
    _write(tmp_path, f'<body name="b">{GEOM}</body>', name="m25.xml")
    assert "is included twice" in _refusal(_write(tmp_path, "", '<include file="f0.xml"/>'))
    attached = _write(tmp_path, '<attach model="n" prefix="x"/>', '<asset><model name="n" file="m0.xml"/></asset>')
    assert ": more than" in ": " + _refusal(attached)


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (_picture(60_000, 60_000, b""), "a side of a texture has at most 8192 pixels"),
        (_picture(1, 1, bytes(1_000_000)), "the PNG file has more pixels than its header says"),
        (_picture(1, 1, bytes(4), _chunk(b"zTXt", bytes(70_000))), "more than 64 KiB of text in it"),
        (_picture(1, 1, bytes(4))[:20], "the PNG file has no header"),
    ],
)
def test_a_picture_that_would_grow_is_refused(tmp_path, content, text):
    (tmp_path / "a.png").write_bytes(content)
    assert text in _refusal(_write(tmp_path, GEOM, TEXTURE))


def test_a_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "a.png")
    assert _refusal(_write(tmp_path, GEOM, TEXTURE)) == "texture file a.png is a pipe or a device"
    os.mkfifo(tmp_path / "pipe.xml")
    assert _refusal(tmp_path / "pipe.xml") == "pipe.xml is a pipe or a device, not a file"


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


def test_honest_rooms_are_below_every_limit(tmp_path):
    """Two million triangles, 5,000 geoms, a hundred textures of 2048 pixels."""
    (tmp_path / "m.obj").write_text("v 0 0 0\n" * 100_000 + "f 1 2 3\n" * 200_000)
    (tmp_path / "t.png").write_bytes(
        _picture(2048, 2048, bytes(2048 * (3 * 2048 + 1)), _chunk(b"eXIf", bytes(12_000_000)))
    )
    meshes = "".join(f'<mesh name="m{number}" file="m.obj"/>' for number in range(10))
    textures = "".join(f'<texture name="t{number}" type="2d" file="t.png"/>' for number in range(100))
    geoms = "".join(f'<geom name="g{number}" size="0.1" pos="{number / 7} 0 1e-12"/>' for number in range(5000))
    vet(_write(tmp_path, geoms, f"<asset>{meshes}{textures}</asset>"))
    model = load_room(_write(tmp_path, f'<replicate count="5000">{GEOM}</replicate>')).compile()
    assert model.ngeom == 5001


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
        assert load_room(path).compile().ngeom >= 1
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
    open_room = load_room(_write(tmp_path, '<geom type="box" size="1 1 1" pos="0 0 1"/>')).compile()
    with pytest.raises(InputError, match=r"no free space is enclosed by walls$"):
        find_free_space(open_room, 0.105, 0.37)


@pytest.mark.parametrize(
    ("lamps", "ambient", "notes"),
    [
        ("", AMBIENT_WITHOUT_LAMPS, 0),
        ('<light type="point" pos="0 0 2"/>', AMBIENT_WITHOUT_LAMPS, 1),
        ('<light type="point" pos="0 0 2"/><light pos="0 0 2"/>', AMBIENT, 1),
        ('<light pos="0 0 2"/>', AMBIENT, 0),
    ],
)
def test_lamps_that_are_not_drawn_do_not_count(lamps, ambient, notes, tmp_path):
    room = load_room(_write(tmp_path, WALLS + lamps))
    model = compile_scene(room, SimSettings())
    assert model.vis.headlight.ambient == pytest.approx([ambient] * 3)
    assert len(list_notes(room.compile())) == notes


def test_many_triangles_are_named(tmp_path, monkeypatch):
    model = load_room(_write(tmp_path, WALLS)).compile()
    monkeypatch.setattr("sim.rooms.mjcf._count_triangles", lambda _: 146_000)
    assert list_notes(model) == ["room: its meshes draw 146,000 triangles, which set the time of each picture"]
