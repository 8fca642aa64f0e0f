"""Light that reaches each pixel from the lamps and from the windows, each drawn apart, and mixtures of the two.

A picture's linear light is reflectance times illumination. In a white copy of the room, MuJoCo draws the illumination
by one kind of source alone. The quotient of a mixture of these and their sum holds no reflectance, and the picture is
multiplied by it (Riklin-Raviv and Shashua, "The quotient image", IEEE PAMI 23(2), 2001). Lamps and windows at full
strength give the picture as it is, and the light of several sources adds up. There are no shadows.
"""

import copy
from collections.abc import Mapping
from functools import partial

import mujoco
import numpy as np

from sim.rooms.light_sources import KINDS, Sources
from sim.sensors.camera.fisheye import Dress, Fisheye
from sim.settings import CameraMountSettings, CameraSettings

SCATTERED = 0.1
"""Light that walls have scattered, the same everywhere, as a fraction of white; no corner is black."""
DIRECT = 1.2
"""Light of all sources of a kind together on a surface that faces them close by, as a fraction of white."""
FADING_M2 = 4.0
"""A light fades to 1 / (1 + distance^2 / FADING_M2) [m2]."""
QUADS = 8
"""Parts of a box's face along each side; MuJoCo computes light at their corners alone."""


OFF = 0.15
"""Reflectance of lamps and panes that do not shine."""
DARK = 1e-3
"""Least illumination by which is divided, as a fraction of white."""


class Illumination:
    """Draws the illumination by each kind of source as the fisheye camera sees it; one OpenGL context for each kind.

    Args:
        model: A compiled room with the robot in it.
        camera: The lens and the sizes of its image.
        mount: Where the camera is on the robot.
        sources: Kinds of sources.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        camera: CameraSettings,
        mount: CameraMountSettings,
        sources: Mapping[str, Sources],
    ) -> None:
        self._sources = sources
        self._cameras = {kind: Fisheye(_whiten(model, sources, kind), camera, mount) for kind in sources}

    def draw(self, data: mujoco.MjData, lean: np.ndarray | None, dress: Dress) -> dict[str, np.ndarray]:
        """Illumination (rings, sectors, 3) of the state ``data`` by each kind of source, as a fraction of white.

        Args:
            data: The model's state, with kinematics computed.
            lean: Lean of the camera (2,) [rad].
            dress: Adds to the scene what the room does not have; it becomes white too.
        """

        def light(scene: mujoco.MjvScene, sources: Sources) -> None:
            before = scene.ngeom
            dress(scene)
            for geom in scene.geoms[before : scene.ngeom]:
                geom.rgba = np.ones(4, np.float32)
            _set_lights(scene, sources)

        return {
            kind: camera.polar(data, lean, partial(light, sources=self._sources[kind])) / np.float32(255.0)
            for kind, camera in self._cameras.items()
        }


def mix(light: np.ndarray, by: Mapping[str, np.ndarray], fraction: Mapping[str, float]) -> np.ndarray:
    """Linear light (...) of a picture if each kind of source shines with a fraction of its light.

    Args:
        light: Linear light of the picture (...), in which lamps and windows shine.
        by: Illumination by each kind of source (...), in a common unit.
        fraction: Fraction of each kind's light; 0 for kinds that are left out.
    """
    usual = sum(by[kind] for kind in KINDS)
    return light * (sum(share * by[kind] for kind, share in fraction.items()) / np.maximum(usual, DARK))


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
        white.geom_rgba[some.geoms, :3] = 1.0 if shines else OFF
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
    scattered.ambient = SCATTERED * colour * bool(len(sources.place))  # where nothing shines, nothing is scattered
    for light, place, facing, share in zip(direct, sources.place, sources.facing, sources.strength, strict=True):
        light.type = mujoco.mjtLightType.mjLIGHT_SPOT
        light.pos, light.dir = place, facing if facing.any() else np.array([0.0, 0.0, -1.0])
        light.cutoff, light.exponent = 90.0 if facing.any() else 180.0, 0.0
        light.attenuation = np.array([1.0, 0.0, 1.0 / FADING_M2])
        light.diffuse = DIRECT * share * colour
