"""Off-screen drawing: an OpenGL context and MuJoCo's buffer in it."""

import atexit
import ctypes
from typing import Any

import mujoco
import numpy as np

from sim.errors import WorkError
from sim.sensors.camera import gl


class Offscreen:
    """A buffer to draw in; it belongs to the thread that opened it.

    Attributes:
        target: MuJoCo's rendering context.
        renderer_string: Name of the OpenGL renderer.

    Args:
        model: The model whose meshes and textures are loaded.
        width: Columns [px].
        height: Rows [px].

    Raises:
        WorkError: No OpenGL context can be opened; the message names the fix.
    """

    def __init__(self, model: mujoco.MjModel, width: int, height: int) -> None:
        self._width, self._height = width, height
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
        drawn = np.empty((self._height, self._width, 3), np.uint8)
        mujoco.mjr_readPixels(drawn, None, mujoco.MjrRect(0, 0, self._width, self._height), self.target)
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

    def _close_at_exit(self) -> None:
        try:
            self.close()
        except Exception:  # dm_control, imported after this was opened, has ended EGL first: RuntimeError or EGLError
            for owner in (self.target, self._gl):  # nothing is left to free, and collecting them would call the driver
                ctypes.pythonapi.Py_IncRef(ctypes.py_object(owner))
