from pathlib import Path

import mujoco
import pytest

from sim.errors import InputError
from sim.free_space import find_free_space
from sim.mjcf import load_room

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
    "floor",
    [
        '<geom type="plane" size="5 5 1"/>',
        '<geom type="box" size="3 3 0.1" pos="0 0 -0.1"/>',
        '<body pos="0 0 -1"><geom type="box" size="3 3 0.5" pos="0 0 0.5"/></body>',
    ],
)
def test_its_own_floor_is_kept(tmp_path, floor):
    bare = load_room(_write(tmp_path, WALLS)).compile()
    model = load_room(_write(tmp_path, WALLS + floor)).compile()
    assert model.ngeom == bare.ngeom
    assert "floor" not in [model.geom(i).name for i in range(model.ngeom)]
    assert find_free_space(model, 0.105, 0.37).shorter_side_m == pytest.approx(3.0, abs=0.02)


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
