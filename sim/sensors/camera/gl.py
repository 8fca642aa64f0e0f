"""The OpenGL backend for off-screen images: EGL first, OSMesa second, chosen before mujoco is imported.

If it is missing for any reason, a one-line error names the fix. Libraries are probed in this process through ctypes:
that takes about ten milliseconds and, unlike a failed import of PyOpenGL, can be repeated.
"""

import ctypes
import importlib
import os
from typing import Any

from sim.errors import InputError, WorkError, one_line

_BACKENDS = ("egl", "osmesa")
# PyOpenGL, through which mujoco opens EGL, needs libOpenGL (or libGL) as well
EGL_FIX = "apt-get install libegl1 libegl-mesa0 libgl1-mesa-dri libopengl0"
_OSMESA_FIX = "apt-get install libosmesa6"
_EGL_PLATFORM_DEVICE = 0x313F  # EGL_EXT_platform_device
_MAX_DEVICES = 32


def choose_backend() -> str:
    """Set MUJOCO_GL and PYOPENGL_PLATFORM to a backend that works, and return it: ``egl`` or ``osmesa``.

    Call it before mujoco is imported. A backend that the user's environment names is the only one tried. Raises
    InputError if an environment variable names an unknown backend, or two disagree, WorkError if no usable backend is
    installed; the message names the missing package.
    """
    wanted = _read_environment()
    problems = {}
    for backend in [wanted] if wanted else _BACKENDS:
        problems[backend] = _PROBES[backend]()
        if problems[backend] is None:
            os.environ["MUJOCO_GL"] = os.environ["PYOPENGL_PLATFORM"] = backend
            return backend
    raise WorkError(_explain(wanted, problems))


def open_context(width: int, height: int) -> Any:
    """Open an off-screen OpenGL context for pictures of this size [px] and make it current; its owner calls ``free()``.

    EGL ignores the size. Raises as ``choose_backend`` does, or if the driver refuses a context.
    """
    backend = choose_backend()
    try:
        context = importlib.import_module(f"mujoco.{backend}").GLContext(width, height)
        context.make_current()
    except Exception as error:  # drivers raise ImportError, AttributeError, RuntimeError or GLError
        fix = EGL_FIX if backend == "egl" else _OSMESA_FIX
        raise WorkError(f"{backend} cannot open an OpenGL context ({one_line(error)}): {fix}") from error
    return context


def read_renderer() -> str:
    """Name of the renderer behind the current context, e.g. ``llvmpipe (LLVM 15.0.6, 256 bits)``."""
    gl = importlib.import_module("OpenGL.GL")
    return gl.glGetString(gl.GL_RENDERER).decode()


def describe() -> tuple[str, str]:
    """Backend and renderer of this machine, found by opening a context; raises like ``open_context``."""
    context = open_context(16, 16)
    try:
        return os.environ["MUJOCO_GL"], read_renderer()
    finally:
        context.free()


def _read_environment() -> str | None:
    named = {}
    for variable in ("MUJOCO_GL", "PYOPENGL_PLATFORM"):
        value = os.environ.get(variable, "").strip().lower()
        if value and value not in _BACKENDS:
            raise InputError(f"{variable}={value}: must be egl or osmesa, or unset")
        if value:
            named[variable] = value
    if len(set(named.values())) > 1:
        raise InputError(
            f"MUJOCO_GL={named['MUJOCO_GL']} and PYOPENGL_PLATFORM={named['PYOPENGL_PLATFORM']} disagree: "
            "unset PYOPENGL_PLATFORM"
        )
    return next(iter(named.values()), None)


def _explain(wanted: str | None, problems: dict[str, str | None]) -> str:
    if wanted is None:
        return f"no OpenGL for images: {problems['egl']}, and {problems['osmesa']}: {EGL_FIX}"
    if wanted == "osmesa":
        return f"MUJOCO_GL=osmesa, but {problems['osmesa']}: {_OSMESA_FIX}, or unset MUJOCO_GL to use EGL"
    return f"MUJOCO_GL=egl, but {problems['egl']}: {EGL_FIX}"


def _probe_osmesa() -> str | None:
    """The problem with OSMesa on this machine, or None."""
    names = ("libOSMesa.so.8", "libOSMesa.so.6", "libOSMesa.so")
    return None if any(_load(name) for name in names) else "libOSMesa is missing"


def _probe_egl() -> str | None:
    """The problem with EGL on this machine, or None; tries a display on each device like mujoco.egl."""
    # NVIDIA's driver needs libOpenGL before libEGL, the order in which mujoco.egl loads them
    if _load("libOpenGL.so.0", ctypes.RTLD_GLOBAL) is None and _load("libGL.so.1", ctypes.RTLD_GLOBAL) is None:
        return "libOpenGL is missing"
    egl = _load("libEGL.so.1")
    if egl is None:
        return "libEGL is missing"
    egl.eglGetProcAddress.restype = ctypes.c_void_p
    egl.eglGetProcAddress.argtypes = [ctypes.c_char_p]
    egl.eglInitialize.argtypes = [ctypes.c_void_p] * 3
    query = egl.eglGetProcAddress(b"eglQueryDevicesEXT")
    display = egl.eglGetProcAddress(b"eglGetPlatformDisplayEXT")
    if not query or not display:
        return "libEGL knows no devices"
    query_devices = ctypes.CFUNCTYPE(ctypes.c_uint, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)(query)
    get_display = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_uint, ctypes.c_void_p, ctypes.c_void_p)(display)

    devices, count = (ctypes.c_void_p * _MAX_DEVICES)(), ctypes.c_int()
    query_devices(_MAX_DEVICES, devices, ctypes.byref(count))
    for device in _select(list(devices[: count.value])):
        handle = get_display(_EGL_PLATFORM_DEVICE, device, None)
        if handle and egl.eglInitialize(handle, None, None):
            return None
    return f"EGL has no driver for any of its {count.value} devices"


def _select(devices: list[int | None]) -> list[int | None]:
    wish = os.environ.get("MUJOCO_EGL_DEVICE_ID")
    if wish is None or not devices:
        return devices
    if not wish.isdecimal() or int(wish) >= len(devices):
        raise InputError(f"MUJOCO_EGL_DEVICE_ID={wish}: must be a whole number from 0 to {len(devices) - 1}")
    return [devices[int(wish)]]


def _load(name: str, mode: int = ctypes.DEFAULT_MODE) -> ctypes.CDLL | None:
    try:
        return ctypes.CDLL(name, mode=mode)
    except OSError:
        return None


_PROBES = {"egl": _probe_egl, "osmesa": _probe_osmesa}
