"""Where a room's light comes from: its lamps and its windows, as lights that MuJoCo draws with.

A glowing material of one colour belongs to a lamp; one with a picture belongs to a window or a screen.
"""

from dataclasses import dataclass
from typing import Literal, get_args

import mujoco
import numpy as np

Source = Literal["lamps", "windows"]
LAMPLIGHT = (1.0, 0.88, 0.7)
"""Colour of the light of lamps, warmer than that of the sky."""
KINDS: tuple[Source, ...] = get_args(Source)
COLOURS: dict[Source, tuple[float, float, float]] = {"lamps": LAMPLIGHT, "windows": (0.85, 0.93, 1.0)}
MOST = 7
"""OpenGL has eight lights, of which MuJoCo keeps one for the view."""


@dataclass(frozen=True)
class Sources:
    """Lights of one kind in a room.

    Attributes:
        geoms: Geoms that glow (G,).
        place: Where the lights are (L, 3) [m]; of windows a little in front of the pane.
        facing: Direction that each shines in (L, 3); zero: all around.
        strength: Share of each in the light of its kind (L,); the shares add up to 1.
        colour: Colour of the light.
    """

    geoms: np.ndarray
    place: np.ndarray
    facing: np.ndarray
    strength: np.ndarray
    colour: tuple[float, float, float]


def find_sources(model: mujoco.MjModel, source: Source) -> Sources:
    """Find the lamps or the windows of a compiled room: a light for each that glows, the ``MOST`` largest at most.

    What glows in one body is one lamp or window; what is fixed to the world itself is one for each geom.

    Args:
        model: The room, with or without a robot.
        source: ``lamps`` or ``windows``; screens count as windows, by their size.
    """
    material, has = model.geom_matid, model.geom_matid >= 0
    glows, pictured = has.copy(), np.zeros_like(has)
    glows[has] = model.mat_emission[material[has]] > 0.0
    pictured[has] = (model.mat_texid[material[has]] >= 0).any(axis=1)
    geoms = np.flatnonzero(glows & (pictured == (source == "windows")))
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    body = model.geom_bodyid[geoms]
    fitting = np.where(body > 0, body, -1 - geoms)
    lights = [_place_light(model, data, geoms[fitting == one], source) for one in np.unique(fitting)]
    lights = sorted(lights, key=lambda light: -light[2])[:MOST]
    place, facing, size = (np.array([light[k] for light in lights]) for k in range(3))
    strength = size / max(size.sum(), 1e-12)
    return Sources(geoms, place.reshape(-1, 3), facing.reshape(-1, 3), strength, COLOURS[source])


def hang_lamp(place: np.ndarray) -> Sources:
    """A lamp at a place (3,) [m] that the room's model does not have."""
    return Sources(np.empty(0, int), place[None], np.zeros((1, 3)), np.ones(1), LAMPLIGHT)


def _place_light(
    model: mujoco.MjModel, data: mujoco.MjData, geoms: np.ndarray, source: Source
) -> tuple[np.ndarray, np.ndarray, float]:
    """Place (3,), direction (3,) and surface [m2] of the light of a body's glowing geoms."""
    plane = model.geom_type[geoms, None] == mujoco.mjtGeom.mjGEOM_PLANE  # its bounding box is endless
    half = np.where(plane, model.geom_size[geoms], model.geom_aabb[geoms, 3:])
    surface = np.sort(half, axis=1)[:, 1:].prod(axis=1) * 4.0
    place = np.average(data.geom_xpos[geoms], axis=0, weights=surface)
    if source == "lamps":
        return place, np.zeros(3), float(surface.sum())
    pane = surface.argmax()
    thinnest = int(half[pane].argmin())
    inward = -data.geom_xmat[geoms[pane]].reshape(3, 3)[:, thinnest]  # our fittings have the room towards -y
    if thinnest != 1 and inward @ (model.stat.center - place) < 0.0:
        inward = -inward
    return place + 0.1 * inward, inward, float(surface.sum())
