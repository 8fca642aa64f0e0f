"""Off-screen drawing: an OpenGL context with MuJoCo's buffer in it, and scenes that are the same from each side."""

import atexit
import ctypes
from dataclasses import dataclass
from typing import Any, Self

import mujoco
import numpy as np

from sim.errors import WorkError
from sim.rooms.spec import DRAWN_GROUPS, NEAR_PLANE_M
from sim.sensors.camera import gl

INVISIBLE_GEOM = int(mujoco.mjtGeom.mjGEOM_NONE)
_DISABLED_FLAGS = ("mjRND_SHADOW", "mjRND_REFLECTION", "mjRND_FOG", "mjRND_HAZE")


@dataclass(frozen=True)
class Face:
    """One pinhole picture and its place in the strip of all of them."""

    axes: np.ndarray  # Rows right, up, forward in the camera's frame (3, 3)
    window: np.ndarray  # Tangents of the angles of its edges: left, right, bottom, top (4,)
    column: int  # First column in the strip [px]
    width: int  # Width [px]
    height: int  # Height [px]


class Offscreen:
    """A buffer to draw in, the base of the cameras; it belongs to the thread that opened it.

    It has so many columns and rows [px], loads a model's meshes and textures, and knows the name of the OpenGL
    renderer. Raises WorkError if no OpenGL context can be opened; the message names the fix.
    """

    def __init__(self, model: mujoco.MjModel, width: int, height: int) -> None:
        self._columns, self._rows = width, height
        self._gl: Any = gl.open_context(width, height)
        try:
            self.target = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_50)
            mujoco.mjr_resizeOffscreen(width, height, self.target)
            mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self.target)
            self.renderer_string = gl.read_renderer()
        except mujoco.FatalError as error:
            self._gl.free()
            raise WorkError(f"the OpenGL driver cannot draw off screen ({error}): update Mesa") from error
        # at exit, Mesa's display is gone before objects that were never closed are collected
        atexit.register(self._close_at_exit)

    def begin(self) -> None:
        """Draw into this buffer from now on; raises WorkError if it is closed."""
        if self._gl is None:
            raise WorkError("this camera is closed")
        self._gl.make_current()

    def read(self) -> np.ndarray:
        """Read the picture: (height, width, 3) uint8 RGB, the lowest row first."""
        drawn = np.empty((self._rows, self._columns, 3), np.uint8)
        mujoco.mjr_readPixels(drawn, None, mujoco.MjrRect(0, 0, self._columns, self._rows), self.target)
        return drawn

    def close(self) -> None:
        """Free the OpenGL context; a second call does nothing."""
        if self._gl is None:
            return
        self._gl.make_current()
        self.target.free()
        self._gl.free()
        self._gl = None
        atexit.unregister(self._close_at_exit)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _close_at_exit(self) -> None:
        try:
            self.close()
        except Exception:  # dm_control, imported after this was opened, has ended EGL first: RuntimeError or EGLError
            for owner in (self.target, self._gl):  # nothing is left to free, and collecting them would call the driver
                ctypes.pythonapi.Py_IncRef(ctypes.py_object(owner))


def make_scene(model: mujoco.MjModel) -> tuple[mujoco.MjvScene, mujoco.MjvOption, mujoco.MjvCamera]:
    """Make a scene of only the visual geoms."""
    scene, option, view = mujoco.MjvScene(model, model.ngeom + 100), mujoco.MjvOption(), mujoco.MjvCamera()
    for flag in _DISABLED_FLAGS:
        scene.flags[getattr(mujoco.mjtRndFlag, flag)] = 0
    keep = (mujoco.mjtVisFlag.mjVIS_TEXTURE, mujoco.mjtVisFlag.mjVIS_STATIC)
    for flag in range(len(option.flags)):
        option.flags[flag] = flag in keep
    for group in range(len(option.geomgroup)):
        option.geomgroup[group] = group in DRAWN_GROUPS
    for other in (option.sitegroup, option.jointgroup, option.tendongroup, option.actuatorgroup):
        other[:] = 0
    return scene, option, view


def update_scene(
    model: mujoco.MjModel, data: mujoco.MjData, option: mujoco.MjvOption, view: mujoco.MjvCamera, scene: mujoco.MjvScene
) -> None:
    """Bring a scene to the state ``data``, with kinematics computed; the light that would turn with the view is off."""
    mujoco.mj_camlight(model, data)  # kinematics leave the lamps without a place and a direction
    mujoco.mjv_updateScene(model, data, option, None, view, mujoco.mjtCatBit.mjCAT_ALL, scene)
    for light in scene.lights[: scene.nlight]:
        if light.headlight:
            light.diffuse = light.specular = np.zeros(3, np.float32)


def aim(scene: mujoco.MjvScene, face: Face, position: np.ndarray, turn: np.ndarray) -> None:
    """Point both eyes, which MuJoCo averages, at a face."""
    left, right, bottom, top = face.window * NEAR_PLANE_M
    for eye in scene.camera:
        eye.pos, eye.up, eye.forward = position, turn @ face.axes[1], turn @ face.axes[2]
        eye.frustum_near = NEAR_PLANE_M
        eye.frustum_center, eye.frustum_width = (left + right) / 2, (right - left) / 2
        eye.frustum_bottom, eye.frustum_top = bottom, top
        eye.orthographic = 0
