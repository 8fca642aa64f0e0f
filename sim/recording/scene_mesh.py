"""The room as one GLB file for viewers: what the camera can see, one node per geom, in the world frame.

Coordinates are written unchanged, z up, although glTF specifies y up: Rerun shows them unchanged. Nodes have the geoms'
names, so a viewer can hide the ceiling.
"""

from collections.abc import Callable
from functools import cache
from io import BytesIO
from pathlib import Path

import mujoco
import numpy as np
import trimesh
from PIL import Image
from trimesh.visual.material import PBRMaterial
from trimesh.visual.texture import TextureVisuals

from sim.files.atomic import write_bytes
from sim.rooms.spec import DRAWN_GROUPS, ROBOT_PREFIX

_JPEG_QUALITY = 85
_SECTIONS = 16
_COUNT = [_SECTIONS // 2, _SECTIONS]
_DEFAULT_RGBA = np.array([0.5, 0.5, 0.5, 1.0])  # MuJoCo's default, which means that the geom has its material's colour
_Geom = mujoco.mjtGeom


def write_scene(model: mujoco.MjModel, path: Path) -> None:
    """Write the visual geoms of a compiled room, in its initial state, as GLB; equal models give equal bytes.

    Boxes and planes have their textures, all other shapes their texture's mean colour. Height fields, signed distance
    fields and the robot are left out.
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    material = cache(lambda texture, rgba, textured: _make_material(model, texture, rgba, textured))
    scene = trimesh.Scene()
    for geom in range(model.ngeom):
        rgba = _colour(model, geom)
        if not _is_drawn(model, geom) or rgba[3] == 0:
            continue
        shape, coordinates = _SHAPES[_Geom(model.geom_type[geom])](model, geom)
        textured = coordinates is not None
        own = material(_texture(model, geom), tuple(rgba.tolist()), textured)
        shape.visual = TextureVisuals(uv=coordinates, material=own)
        name = model.geom(geom).name or f"geom_{geom}"
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom]
        scene.add_geometry(shape, node_name=name, geom_name=name, transform=pose)
    content = scene.export(file_type="glb")
    assert isinstance(content, bytes)
    write_bytes(path, content)


def _is_drawn(model: mujoco.MjModel, geom: int) -> bool:
    return (
        model.geom_group[geom] in DRAWN_GROUPS
        and _Geom(model.geom_type[geom]) in _SHAPES
        and not model.body(model.geom_bodyid[geom]).name.startswith(ROBOT_PREFIX)
    )


def _colour(model: mujoco.MjModel, geom: int) -> np.ndarray:
    """Colour (4,) of a geom: its own, or its material's if its own is the default."""
    own, material = model.geom_rgba[geom], model.geom_matid[geom]
    return model.mat_rgba[material] if material >= 0 and np.allclose(own, _DEFAULT_RGBA) else own


def _texture(model: mujoco.MjModel, geom: int) -> int:
    material = model.geom_matid[geom]
    return int(model.mat_texid[material, mujoco.mjtTextureRole.mjTEXROLE_RGB]) if material >= 0 else -1


def _make_material(model: mujoco.MjModel, texture: int, rgba: tuple[float, ...], textured: bool) -> PBRMaterial:
    colour, picture = np.array(rgba), None
    if texture >= 0:
        pixels = _pixels(model, texture)
        if textured and model.tex_type[texture] == mujoco.mjtTexture.mjTEXTURE_2D:
            picture = _compress(pixels)
        else:
            colour[:3] *= pixels.reshape(-1, 3).mean(axis=0) / 255
    return PBRMaterial(
        baseColorFactor=np.rint(np.clip(colour, 0, 1) * 255).astype(np.uint8),
        baseColorTexture=picture,
        metallicFactor=0.0,
        roughnessFactor=1.0,
        alphaMode="BLEND" if colour[3] < 1 else "OPAQUE",
    )


def _pixels(model: mujoco.MjModel, texture: int) -> np.ndarray:
    """Image of a texture (rows, columns, 3) uint8."""
    rows, columns, channels = (int(part[texture]) for part in (model.tex_height, model.tex_width, model.tex_nchannel))
    start = model.tex_adr[texture]
    pixels = model.tex_data[start : start + rows * columns * channels].reshape(rows, columns, channels)
    return pixels[..., :3] if channels >= 3 else np.repeat(pixels[..., :1], 3, axis=-1)


def _compress(pixels: np.ndarray) -> Image.Image:
    file = BytesIO()
    Image.fromarray(np.ascontiguousarray(pixels)).save(file, "JPEG", quality=_JPEG_QUALITY)
    return Image.open(file)  # trimesh keeps the format of an image that was read from a file


Shape = tuple[trimesh.Trimesh, np.ndarray | None]


def _box(model: mujoco.MjModel, geom: int) -> Shape:
    half = model.geom_size[geom]
    points, places = [], []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            across, along = (other for other in range(3) if other != axis)
            corners = np.zeros((4, 3))
            corners[:, axis] = sign
            corners[:, across], corners[:, along] = [-1, 1, 1, -1], [-1, -1, 1, 1]
            # counter-clockwise seen from outside
            order = [0, 1, 2, 3] if (sign > 0) != (axis == 1) else [3, 2, 1, 0]
            points.append(corners[order] * half)
            places.append(corners[order][:, [across, along]])
    quads = np.arange(24).reshape(6, 4)
    return _join(np.concatenate(points), quads), _coordinates(model, geom, np.concatenate(places))


def _plane(model: mujoco.MjModel, geom: int) -> Shape:
    half = model.geom_size[geom, :2].copy()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    away = np.linalg.norm(data.geom_xpos - data.geom_xpos[geom], axis=1)
    half[half == 0] = (away + model.geom_rbound).max() + 1.0  # an infinite plane extends beyond the rest
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1.0]])
    points = np.column_stack([corners * half, np.zeros(4)])
    return _join(points, np.arange(4)[None]), _coordinates(model, geom, corners)


def _join(points: np.ndarray, quads: np.ndarray) -> trimesh.Trimesh:
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return trimesh.Trimesh(points, faces, process=False)


def _coordinates(model: mujoco.MjModel, geom: int, places: np.ndarray) -> np.ndarray | None:
    """Texture coordinates (n, 2) of places in [-1, 1] on a face, as MuJoCo maps a texture onto boxes and planes."""
    if _texture(model, geom) < 0:
        return None
    material = model.geom_matid[geom]
    repeat = model.mat_texrepeat[material].astype(float)
    if model.mat_texuniform[material]:
        repeat = repeat * np.where(model.geom_size[geom, :2] > 0, model.geom_size[geom, :2], 1.0)
    across, down = (places[:, 0] + 1) / 2, (1 - places[:, 1]) / 2
    return np.column_stack([across * repeat[0], 1 - down * repeat[1]])


def _round(make: Callable[[np.ndarray], trimesh.Trimesh]) -> Callable[[mujoco.MjModel, int], Shape]:
    """Makes a shape without texture coordinates from the size of its geom (3,)."""
    return lambda model, geom: (make(model.geom_size[geom]), None)


def _ellipsoid(size: np.ndarray) -> trimesh.Trimesh:
    return trimesh.creation.uv_sphere(1.0, count=_COUNT).apply_scale(size)


def _mesh(model: mujoco.MjModel, geom: int) -> Shape:
    mesh = model.geom_dataid[geom]
    vertex, face = model.mesh_vertadr[mesh], model.mesh_faceadr[mesh]
    points = model.mesh_vert[vertex : vertex + model.mesh_vertnum[mesh]]
    return trimesh.Trimesh(points, model.mesh_face[face : face + model.mesh_facenum[mesh]], process=False), None


_SHAPES: dict[mujoco.mjtGeom, Callable[[mujoco.MjModel, int], Shape]] = {
    _Geom.mjGEOM_PLANE: _plane,
    _Geom.mjGEOM_BOX: _box,
    _Geom.mjGEOM_SPHERE: _round(lambda size: trimesh.creation.uv_sphere(size[0], count=_COUNT)),
    _Geom.mjGEOM_ELLIPSOID: _round(_ellipsoid),
    _Geom.mjGEOM_CAPSULE: _round(lambda size: trimesh.creation.capsule(2 * size[1], size[0], count=_COUNT)),
    _Geom.mjGEOM_CYLINDER: _round(lambda size: trimesh.creation.cylinder(size[0], 2 * size[1], sections=_SECTIONS)),
    _Geom.mjGEOM_MESH: _mesh,
}
