"""The room's mesh holds what the camera sees, where it sees it."""

import json
import os
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any, cast

import mujoco
import numpy as np
import pytest
import trimesh
from trimesh.visual.texture import TextureVisuals

from sim.recording.scene_mesh import write_scene
from sim.sensors.camera.fisheye import Fisheye
from sim.sensors.camera.lens import Lens, polar_rays
from sim.settings import CameraSettings

# Textures are 64 x 64 ramps: red grows with the column, green with the row.
ROOM = """<mujoco>
<visual><headlight ambient="1 1 1" diffuse="0 0 0" specular="0 0 0"/><quality offsamples="0"/></visual>
<asset><texture name="ramp" type="2d" builtin="flat" width="64" height="64"/>
<texture name="sheen" type="cube" builtin="flat" width="8" height="8" rgb1="0.2 0.4 0.6" rgb2="0.2 0.4 0.6"/>
<material name="ramp" texture="ramp" specular="0"/><material name="part" texture="ramp" texrepeat="0.5 0.25"/>
<material name="sheen" texture="sheen" rgba="1 0.5 1 1"/><material name="glass" rgba="0 0 1 0.3"/>
<mesh name="wedge" vertex="0 0 0  1 0 0  0 1 0  0 0 1"/></asset>
<worldbody>
<geom name="floor" type="plane" size="0 0 1" rgba="0.25 0.5 0.75 1"/>
<geom name="east" type="box" pos="2 0 1" size="0.1 1.5 0.8" euler="0 0 20" material="ramp"/>
<geom name="north" type="box" pos="0 2 1" size="1.5 0.1 0.7" euler="0 10 -15" material="part"/>
<geom name="ceiling" type="plane" pos="0 0 2.5" size="1.2 0.9 1" euler="180 0 30" material="ramp"/>
<geom name="ball" type="sphere" pos="-2 0 1" size="0.3" material="sheen"/>
<geom name="egg" type="ellipsoid" pos="-2 2 1" size="0.1 0.2 0.3" material="glass"/>
<geom name="pill" type="capsule" pos="-2 -2 1" size="0.1 0.5" euler="30 0 0"/>
<geom name="drum" type="cylinder" pos="2 -2 1" size="0.2 0.4" euler="0 90 0"/>
<geom name="wedge" type="mesh" mesh="wedge" pos="0 -2 1" euler="0 0 45"/>
<geom name="block" type="box" size="9 9 9" group="3"/>
<geom name="ghost" type="box" size="9 9 9" rgba="1 0 0 0"/>
<geom type="box" pos="3 3 0.5" size="0.1 0.1 0.1"/>
<body name="robot/base"><geom name="robot/body" size="0.2"/><site name="robot/camera" pos="0 0 0.35"/></body>
</worldbody></mujoco>"""


def build_room() -> mujoco.MjModel:
    model = mujoco.MjModel.from_xml_string(ROOM)
    ramp, side = model.texture("ramp").id, np.arange(64) * 4
    picture = np.stack(np.broadcast_arrays(side[None, :], side[:, None], 128), axis=-1).astype(np.uint8)
    start = model.tex_adr[ramp]
    model.tex_data[start : start + picture.size] = picture.ravel()
    return model


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return build_room()


@pytest.fixture(scope="module")
def path(model: mujoco.MjModel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("mesh") / "scene.glb"
    write_scene(model, file)
    return file


@pytest.fixture(scope="module")
def shapes(path: Path) -> dict[str, trimesh.Trimesh]:
    """Each node's shape in the world, with its material."""
    scene = trimesh.load_scene(path)
    shapes = {}
    for node in scene.graph.nodes_geometry:
        transform, name = scene.graph[node]
        shapes[node] = scene.geometry[name].copy().apply_transform(transform)
    return shapes


def test_it_holds_the_visual_geoms_by_name_and_nothing_else(shapes: dict[str, trimesh.Trimesh]) -> None:
    named = {"floor", "east", "north", "ceiling", "ball", "egg", "pill", "drum", "wedge"}
    assert set(shapes) == named | {"geom_11"}


def test_z_is_up_and_every_shape_stands_where_the_model_has_it(
    model: mujoco.MjModel, shapes: dict[str, trimesh.Trimesh]
) -> None:
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for name, shape in shapes.items():
        geom = int(name[5:]) if name.startswith("geom_") else model.geom(name).id
        if name == "floor":
            continue
        turn = data.geom_xmat[geom].reshape(3, 3)
        offset, half = model.geom_aabb[geom].reshape(2, 3)
        if name == "ceiling":  # MuJoCo's box about a plane is endless
            offset, half = np.zeros(3), np.array([1.2, 0.9, 0.0])
        middle = data.geom_xpos[geom] + turn @ offset
        corners = (shape.vertices - middle) @ turn  # back in the geom's own frame
        np.testing.assert_allclose(corners.min(axis=0), -half, atol=0.04 * half.max())
        np.testing.assert_allclose(corners.max(axis=0), half, atol=0.04 * half.max())
        assert shape.is_winding_consistent


def test_faces_look_outward_and_floors_up(shapes: dict[str, trimesh.Trimesh]) -> None:
    assert np.all(shapes["floor"].face_normals @ [0, 0, 1] > 0.99)
    assert np.all(shapes["ceiling"].face_normals @ [0, 0, -1] > 0.99)
    for name in ("east", "ball", "egg", "pill", "drum", "wedge"):
        shape = shapes[name]
        outward = np.einsum("fi,fi->f", shape.face_normals, shape.triangles_center - shape.bounds.mean(axis=0))
        assert outward.min() > (-0.2 if name == "wedge" else 0)


def test_an_endless_floor_ends_beyond_the_room(shapes: dict[str, trimesh.Trimesh]) -> None:
    extent = np.abs(shapes["floor"].vertices[:, :2])
    assert 4 < extent.min() == extent.max() < 40


@pytest.mark.parametrize("floor", ["", 'pos="-30 0 0"'])
def test_an_endless_floor_reaches_what_stands_in_bodies(floor: str, tmp_path: Path) -> None:
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><worldbody><geom name="floor" type="plane" size="0 0 1" {floor}/>
        <body pos="20 0 0"><body pos="0 30 0"><geom name="box" type="box" size="1 1 1"/></body></body>
        </worldbody></mujoco>"""
    )
    write_scene(model, tmp_path / "scene.glb")
    scene = trimesh.load_scene(tmp_path / "scene.glb")
    low, high = scene.geometry["floor"].copy().apply_transform(scene.graph["floor"][0]).bounds
    assert (low[:2] < (19, 29)).all() and (high[:2] > (21, 31)).all()


def material(shape: trimesh.Trimesh) -> Any:
    return cast(TextureVisuals, shape.visual).material


def test_plain_shapes_have_their_colours(shapes: dict[str, trimesh.Trimesh]) -> None:
    colour = {name: np.array(material(shape).baseColorFactor) for name, shape in shapes.items()}
    np.testing.assert_allclose(colour["floor"], [64, 128, 191, 255], atol=1)
    np.testing.assert_allclose(colour["ball"], [51, 51, 153, 255], atol=2)  # the cube texture's mean times the rgba
    np.testing.assert_allclose(colour["egg"], [0, 0, 255, 76], atol=1)
    assert material(shapes["egg"]).alphaMode == "BLEND"


def look_up(shape: trimesh.Trimesh, point: np.ndarray) -> np.ndarray:
    """Colour of a textured mesh at a point on it."""
    inside = trimesh.triangles.points_to_barycentric(shape.triangles, np.tile(point, (len(shape.faces), 1)))
    off = np.abs(np.einsum("fi,fi->f", shape.face_normals, point - shape.triangles[:, 0]))
    face = int(np.argmin(off + 10 * np.maximum(-inside.min(axis=1), 0)))
    u, v = inside[face] @ cast(TextureVisuals, shape.visual).uv[shape.faces[face]]
    picture = np.asarray(material(shape).baseColorTexture, float)
    row, column = int((1 - v) * len(picture)), int(u * picture.shape[1])
    return picture[np.clip(row, 0, 63), np.clip(column, 0, 63)]


def test_textures_lie_as_the_camera_sees_them(model: mujoco.MjModel, shapes: dict[str, trimesh.Trimesh]) -> None:
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    rays = polar_rays(Lens(np.radians(95)), 16, 64)
    with Fisheye(model, CameraSettings(rings=16, sectors=64, face_px=128)) as fisheye:
        image = fisheye.polar(data).astype(float)
    origin = data.site("robot/camera").xpos
    off = {"east": [], "north": [], "ceiling": []}
    for ray, seen in zip(rays.reshape(-1, 3), image.reshape(-1, 3), strict=True):
        hit = np.full((1, 1), -1, np.int32)
        distance = mujoco.mj_ray(model, data, origin, ray, np.array([1, 1, 1, 0, 0, 0], np.uint8), 1, 1, hit)
        name = model.geom(hit.item()).name if hit.item() >= 0 else ""
        if name in off:
            off[name].append(np.abs(look_up(shapes[name], origin + distance * ray) - seen).max())
    for name, errors in off.items():
        assert len(errors) > 30, name
        assert np.median(errors) < 8, name  # a texture turned or mirrored is off by 50 and more


def test_equal_models_give_equal_bytes_in_another_process(path: Path) -> None:
    code = "import sys; from tests.sim.recording.test_scene_mesh import *; write_scene(build_room(), Path(sys.argv[1]))"
    other = path.with_name("again.glb")
    subprocess.run([sys.executable, "-c", code, str(other)], env=os.environ | {"PYTHONHASHSEED": "7"}, check=True)
    assert other.read_bytes() == path.read_bytes()


def test_a_texture_is_stored_once(path: Path) -> None:
    content = path.read_bytes()
    (length,) = struct.unpack_from("<I", content, 12)
    assert len(json.loads(content[20 : 20 + length])["images"]) <= 2  # one for each material that has one
