"""Building blocks of furniture: a footprint, a look (materials), drawn shapes and shapes that collide.

A piece is one function ``(body, rng, look, ...) -> Footprint`` that fills a body. The frame of a piece has its origin
on the floor in the middle of the footprint; the front faces -y, the back +y.
"""

from dataclasses import dataclass
from typing import TypeAlias

import mujoco
import numpy as np

from sim.rooms.furniture import pictures, textures
from sim.rooms.furniture.textures import Colour

VISUAL_GROUP = 2
COLLISION_GROUP = 3
Body: TypeAlias = mujoco.MjsBody
Rng: TypeAlias = np.random.Generator
Point = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
NO_TURN: Quaternion = (1.0, 0.0, 0.0, 0.0)
WOODS = ((0.62, 0.42, 0.24), (0.45, 0.28, 0.16), (0.76, 0.58, 0.38), (0.3, 0.19, 0.13), (0.68, 0.5, 0.34))


@dataclass(frozen=True)
class Footprint:
    """What the placer knows about a piece."""

    width_m: float  # Extent along x [m]
    depth_m: float  # Extent along y [m]
    height_m: float  # Extent along z from the floor [m]
    front_m: float = 0.0  # Depth of the floor before the piece that must stay open [m]


@dataclass(frozen=True)
class Look:
    """The materials of one room, by name, and the spec into which further ones go."""

    spec: mujoco.MjSpec
    wood: str
    dark_wood: str
    fabric: str
    second_fabric: str
    cushion: str
    cabinet: str
    metal: str
    white: str
    black: str
    glow: str
    leaves: str


def make_look(spec: mujoco.MjSpec, rng: np.random.Generator) -> Look:
    """Choose a room's woods, fabrics and paints."""
    size = (128, 128)
    woods = rng.permutation(len(WOODS))
    calm, other, strong = textures.muted(rng), textures.muted(rng), textures.vivid(rng)
    return Look(
        spec=spec,
        wood=paper(spec, textures.wood(rng, size, WOODS[woods[0]])),
        dark_wood=paper(spec, textures.wood(rng, size, np.multiply(WOODS[woods[1]], 0.8))),
        fabric=paper(spec, textures.fabric(rng, size, calm, other)),
        second_fabric=paper(spec, textures.fabric(rng, size, other, strong)),
        cushion=paper(spec, textures.fabric(rng, size, strong, calm)),
        cabinet=paint(spec, 0.35 * textures.muted(rng) + 0.6),
        metal=paint(spec, np.ones(3) * rng.uniform(0.4, 0.65)),
        white=paint(spec, (0.93, 0.92, 0.88)),
        black=paint(spec, (0.08, 0.08, 0.09)),
        glow=paint(spec, (1.0, 0.96, 0.84), glow=0.9),
        leaves=paper(spec, pictures.leaves(rng, size)),
    )


def paint(spec: mujoco.MjSpec, colour: Colour, glow: float = 0.0) -> str:
    """Add a plain material; ``glow`` is the fraction of its colour that is emitted."""
    name = f"paint_{len(spec.materials)}"
    spec.add_material(name=name, rgba=(*colour, 1.0), emission=glow, specular=0.0, shininess=0.0)
    return name


def paper(spec: mujoco.MjSpec, image: np.ndarray, glow: float = 0.0) -> str:
    """Add a material from a picture (rows, columns, 3) uint8 that covers every face once."""
    name = f"paper_{len(spec.materials)}"
    rows, columns = image.shape[:2]
    texture = spec.add_texture(name=name, type=mujoco.mjtTexture.mjTEXTURE_2D, width=columns, height=rows, nchannel=3)
    texture.data = np.ascontiguousarray(image).tobytes()
    material = spec.add_material(name=name, emission=glow, specular=0.0, shininess=0.0)
    roles = material.textures
    roles[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
    material.textures = roles
    return name


def box(body: Body, middle: Point, size: Point, material: str, solid: bool = False, quat: Quaternion = NO_TURN) -> None:
    """Draw a box of full ``size`` [m]; a solid one collides as well."""
    half = tuple(side / 2 for side in size)
    _draw(body, mujoco.mjtGeom.mjGEOM_BOX, middle, half, material, quat)
    if solid:
        block(body, middle, size, quat)


def block(body: Body, middle: Point, size: Point, quat: Quaternion = NO_TURN) -> None:
    """Add a box of full ``size`` [m] that collides and is not drawn."""
    half = tuple(side / 2 for side in size)
    _collide(body, mujoco.mjtGeom.mjGEOM_BOX, middle, half, quat)


def pole(body: Body, middle: Point, radius_m: float, height_m: float, material: str, solid: bool = False) -> None:
    """Draw an upright cylinder; a solid one collides as well."""
    size = (radius_m, height_m / 2, 0.0)
    _draw(body, mujoco.mjtGeom.mjGEOM_CYLINDER, middle, size, material)
    if solid:
        _collide(body, mujoco.mjtGeom.mjGEOM_CYLINDER, middle, size, NO_TURN)


def ball(body: Body, middle: Point, radii: tuple[float, float, float], material: str) -> None:
    """Draw an ellipsoid; used rarely because it is expensive to render."""
    _draw(body, mujoco.mjtGeom.mjGEOM_ELLIPSOID, middle, radii, material)


def legs(body: Body, width_m: float, depth_m: float, top_m: float, side_m: float, material: str) -> None:
    """Draw four legs under the corners of a ``width_m`` x ``depth_m`` plate at height ``top_m``; they collide."""
    x, y = (width_m - side_m) / 2, (depth_m - side_m) / 2
    for at in ((-x, -y), (x, -y), (-x, y), (x, y)):
        box(body, (*at, top_m / 2), (side_m, side_m, top_m), material, solid=True)


def turned(angle_rad: float, axis: tuple[float, float, float] = (0.0, 0.0, 1.0)) -> Quaternion:
    """Return the quaternion (w, x, y, z) of a rotation about a unit axis."""
    s = float(np.sin(angle_rad / 2))
    return float(np.cos(angle_rad / 2)), s * axis[0], s * axis[1], s * axis[2]


def multiply(a: Quaternion, b: Quaternion) -> np.ndarray:
    """Return the quaternion (4,) of the rotation ``b`` and then ``a``."""
    product = np.empty(4)
    mujoco.mju_mulQuat(product, np.array(a), np.array(b))
    return product


def _draw(body, shape, middle, size, material, quat=(1.0, 0.0, 0.0, 0.0)) -> None:
    size, unseen = (*size, 0.0, 0.0)[:3], {"contype": 0, "conaffinity": 0}
    body.add_geom(type=shape, pos=middle, size=size, quat=quat, material=material, group=VISUAL_GROUP, **unseen)


def _collide(body, shape, middle, size, quat) -> None:
    body.add_geom(
        type=shape, pos=middle, size=(*size, 0.0, 0.0)[:3], quat=quat, group=COLLISION_GROUP, rgba=(0.5, 0.5, 0.5, 0.0)
    )
