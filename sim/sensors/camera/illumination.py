"""Light that reaches each pixel from the lamps and from the windows, each drawn apart, and mixtures of the two.

A picture's linear light is reflectance times illumination. In a white copy of the room, MuJoCo draws the illumination
by one kind of source alone. The quotient of a mixture of these and their sum holds no reflectance, and the picture is
multiplied by it (Riklin-Raviv and Shashua, "The quotient image", IEEE PAMI 23(2), 2001). Lamps and windows at full
strength give the picture as it is, and the light of several sources adds up. There are no shadows. A glowing material
of one colour belongs to a lamp; one with a picture belongs to a window or a screen.
"""

import copy
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Literal, get_args

import mujoco
import numpy as np

from sim.sensors.camera.fisheye import Dress, Fisheye
from sim.settings import CameraMountSettings, CameraSettings

Source = Literal["lamps", "windows"]
LAMPLIGHT = (1.0, 0.88, 0.7)  # Colour of the light of lamps, warmer than that of the sky
KINDS: tuple[Source, ...] = get_args(Source)
COLOURS: dict[Source, tuple[float, float, float]] = {"lamps": LAMPLIGHT, "windows": (0.85, 0.93, 1.0)}
MAX_LIGHTS = 7  # OpenGL has eight lights, of which MuJoCo keeps one for the view


@dataclass(frozen=True)
class Sources:
    """Lights of one kind in a room."""

    geoms: np.ndarray  # Geoms that glow (G,)
    place: np.ndarray  # Where the lights are (L, 3) [m]; of windows a little in front of the pane
    facing: np.ndarray  # Direction that each shines in (L, 3); zero: all around
    strength: np.ndarray  # Share of each in the light of its kind (L,); the shares add up to 1
    colour: tuple[float, float, float]  # Colour of the light


def find_sources(model: mujoco.MjModel, source: Source) -> Sources:
    """Find the lamps or the windows of a compiled room: a light for each that glows, of the ``MAX_LIGHTS`` largest.

    What glows in one body is one lamp or window; what is fixed to the world itself is one for each geom. Screens count
    as windows, by their size.
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
    lights = sorted(lights, key=lambda light: -light[2])[:MAX_LIGHTS]
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


SCATTERED_LIGHT = 0.1  # Light from walls, the same everywhere, as a fraction of white; no corner is black
DIRECT_LIGHT = 1.2  # Light of all sources of a kind on a surface that faces them close by, as a fraction of white
FADING_M2 = 4.0  # A light fades to 1 / (1 + distance^2 / FADING_M2) [m2]
QUADS = 8  # Parts of a box's face along each side; MuJoCo computes light at their corners alone


Draw = Callable[[mujoco.MjData, np.ndarray | None, Dress], dict[str, np.ndarray]]
"""(state with its kinematics, lean of the camera (2,) [rad], what is added to the scene) -> illumination by each kind
of source (rows, columns, 3), as a fraction of white."""
UNLIT_REFLECTANCE = 0.15  # Reflectance of lamps and panes that do not shine
MIN_ILLUMINATION = 1e-3  # Least illumination by which is divided, as a fraction of white


def open_illumination(
    model: mujoco.MjModel,
    camera: CameraSettings,
    mount: CameraMountSettings,
    sources: Mapping[str, Sources],
    look: Callable = Fisheye.polar,
) -> Draw:
    """Open what draws the illumination by each kind of source as the fisheye camera sees it, an OpenGL context each.

    What ``dress`` adds to the scene, and the room does not have, becomes white too.
    """
    cameras = {kind: Fisheye(_whiten(model, sources, kind), camera, mount) for kind in sources}

    def light(scene: mujoco.MjvScene, dress: Dress, kind: str) -> None:
        before = scene.ngeom
        dress(scene)
        for geom in scene.geoms[before : scene.ngeom]:
            geom.rgba = np.ones(4, np.float32)
        _set_lights(scene, sources[kind])

    def draw(data: mujoco.MjData, lean: np.ndarray | None, dress: Dress) -> dict[str, np.ndarray]:
        return {
            kind: look(one, data, lean=lean, dress=partial(light, dress=dress, kind=kind)) / np.float32(255.0)
            for kind, one in cameras.items()
        }

    return draw


def mix(light: np.ndarray, by: Mapping[str, np.ndarray], fraction: Mapping[str, float]) -> np.ndarray:
    """Linear light (...) of a picture in which each kind of source shines with a fraction of its light, not all of it.

    The illumination by each kind (...) is in a common unit; kinds without a fraction are left out.
    """
    usual = sum(by[kind] for kind in KINDS)
    return light * (sum(share * by[kind] for kind, share in fraction.items()) / np.maximum(usual, MIN_ILLUMINATION))


def _whiten(model: mujoco.MjModel, sources: Mapping[str, Sources], shining: str) -> mujoco.MjModel:
    """A white copy of a room in which the sources of one kind glow, and those of the others are dark."""
    white = copy.copy(model)
    white.vis.quality.numquads = QUADS
    material, opacity = model.geom_matid, model.geom_rgba[:, 3].copy()
    opacity[material >= 0] = model.mat_rgba[material[material >= 0], 3]
    white.geom_rgba[:, :3], white.geom_rgba[:, 3] = 1.0, opacity
    white.geom_matid[:] = -1
    for kind, some in sources.items():
        glowing, shines = material[some.geoms], kind == shining
        white.geom_matid[some.geoms] = glowing
        white.mat_texid[glowing] = -1
        white.geom_rgba[some.geoms, :3] = 1.0 if shines else UNLIT_REFLECTANCE
        white.mat_emission[glowing] = float(shines)
    return white


def _set_lights(scene: mujoco.MjvScene, sources: Sources) -> None:
    """Replace a scene's lights by sources and by what walls scatter of their light."""
    scene.nlight = len(sources.place) + 1
    scattered, *direct = scene.lights[: scene.nlight]
    colour = np.array(sources.colour)
    for light in (scattered, *direct):
        light.diffuse = light.ambient = light.specular = np.zeros(3, np.float32)
        light.headlight = light.castshadow = 0
    scattered.type = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    scattered.ambient = SCATTERED_LIGHT * colour * bool(len(sources.place))  # none where nothing shines
    for light, place, facing, share in zip(direct, sources.place, sources.facing, sources.strength, strict=True):
        light.type = mujoco.mjtLightType.mjLIGHT_SPOT
        light.pos, light.dir = place, facing if facing.any() else np.array([0.0, 0.0, -1.0])
        light.cutoff, light.exponent = 90.0 if facing.any() else 180.0, 0.0
        light.attenuation = np.array([1.0, 0.0, 1.0 / FADING_M2])
        light.diffuse = DIRECT_LIGHT * share * colour


TARGET_BRIGHTNESS = 0.18  # Mean that automatic exposure brings an image to, as a fraction of white: a grey card's
MAX_GAIN = 64.0  # Largest gain of a colour


def expose(light: np.ndarray) -> np.ndarray:
    """Return linear light (..., rings, sectors, 3) with automatic exposure and white balance.

    Both together bring the mean of each colour to ``TARGET_BRIGHTNESS`` ("grey world": Buchsbaum, Journal of the
    Franklin Institute 310, 1980), with gains of at most ``MAX_GAIN``. What becomes brighter than white is cut later.
    """
    mean = light.mean(axis=(-3, -2), keepdims=True)
    return light * np.minimum(TARGET_BRIGHTNESS / np.maximum(mean, 1e-6), MAX_GAIN).astype(np.float32)
