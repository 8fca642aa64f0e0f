"""Choosing the OpenGL backend: what works is used, and what is missing is named with its fix."""

import ctypes
import os
import subprocess
import sys

import pytest

from sim.errors import InputError, WorkError
from sim.sensors.camera import gl


@pytest.fixture(autouse=True)
def _clean_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    for variable in ("MUJOCO_GL", "PYOPENGL_PLATFORM", "MUJOCO_EGL_DEVICE_ID"):
        monkeypatch.setenv(variable, "")  # set and restored, so that choose_backend's own settings end with the test
        monkeypatch.delenv(variable)


def hide(monkeypatch: pytest.MonkeyPatch, *libraries: str) -> None:
    real = ctypes.CDLL

    def load(name: str, mode: int = ctypes.DEFAULT_MODE) -> ctypes.CDLL:
        if name.startswith(libraries):
            raise OSError(name)
        return real(name, mode)

    monkeypatch.setattr(ctypes, "CDLL", load)


def test_egl_comes_first_both_variables_agree_and_the_renderer_is_described() -> None:
    assert gl.choose_backend() == "egl"
    assert os.environ["MUJOCO_GL"] == os.environ["PYOPENGL_PLATFORM"] == "egl"
    assert gl.choose_backend() == "egl"
    backend, renderer = gl.describe()
    assert backend == "egl" and len(renderer) > 3


def test_osmesa_comes_second(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(gl._PROBES, "egl", lambda: "libEGL is missing")
    monkeypatch.setitem(gl._PROBES, "osmesa", lambda: None)
    assert gl.choose_backend() == "osmesa"
    assert os.environ["MUJOCO_GL"] == os.environ["PYOPENGL_PLATFORM"] == "osmesa"


def test_nothing_usable_names_both_and_the_cure(monkeypatch: pytest.MonkeyPatch) -> None:
    hide(monkeypatch, "libEGL", "libOSMesa")
    with pytest.raises(WorkError, match="libEGL is missing, and libOSMesa is missing: apt-get install libegl1"):
        gl.choose_backend()
    assert "MUJOCO_GL" not in os.environ


def test_the_wanted_backend_is_the_only_one_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    hide(monkeypatch, "libOSMesa", "libEGL")
    for wanted, library, package in (("osmesa", "libOSMesa", "libosmesa6"), ("egl", "libEGL", "libegl1")):
        monkeypatch.setenv("MUJOCO_GL", wanted)
        complaint = f"^MUJOCO_GL={wanted}, but {library} is missing: apt-get install {package}"
        with pytest.raises(WorkError, match=complaint):
            gl.choose_backend()


def test_wrong_environments_are_wrong_input(monkeypatch: pytest.MonkeyPatch) -> None:
    for environment, complaint in (
        ({"MUJOCO_GL": "glfw"}, "MUJOCO_GL=glfw: must be egl or osmesa, or unset"),
        ({"PYOPENGL_PLATFORM": "glx"}, "PYOPENGL_PLATFORM=glx: must be egl or osmesa, or unset"),
        ({"MUJOCO_GL": "egl", "PYOPENGL_PLATFORM": "osmesa"}, "disagree: unset PYOPENGL_PLATFORM"),
        ({"MUJOCO_EGL_DEVICE_ID": "99"}, "MUJOCO_EGL_DEVICE_ID=99: must be a whole number from 0 to"),
        ({"MUJOCO_EGL_DEVICE_ID": "one"}, "MUJOCO_EGL_DEVICE_ID=one: must be a whole number from 0 to"),
    ):
        with monkeypatch.context() as patch:
            for variable, value in environment.items():
                patch.setenv(variable, value)
            with pytest.raises(InputError, match=complaint):
                gl.choose_backend()


def run_describe(environment: dict[str, str]) -> str:
    describe = "try:\n print(*gl.describe())\nexcept gl.WorkError as error:\n print('sorry:', error)"
    code = f"from sim.sensors.camera import gl\n{describe}"
    done = subprocess.run(
        [sys.executable, "-c", code], env=os.environ | environment, capture_output=True, text=True, check=True
    )
    return done.stdout


@pytest.mark.parametrize("variable", ["__EGL_VENDOR_LIBRARY_DIRS", "LIBGL_DRIVERS_PATH"])
def test_a_library_without_a_driver_is_found_out(variable: str) -> None:
    if "llvmpipe" not in run_describe({}):
        pytest.skip("Mesa's software driver is not the one in use")
    answer = run_describe({variable: "/nowhere", "MUJOCO_GL": "egl"})
    assert answer.startswith("sorry: MUJOCO_GL=egl, but EGL has no driver for any of its")
    assert answer.endswith("apt-get install libegl1 libegl-mesa0 libgl1-mesa-dri libopengl0\n")


def test_a_refused_context_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: int) -> None:
        raise AttributeError("'NoneType' object has no attribute\n'glGetError'")

    monkeypatch.setattr("mujoco.egl.GLContext", refuse)
    with pytest.raises(WorkError, match=r"egl cannot open an OpenGL context \('NoneType'.*\): apt-get install libegl1"):
        gl.open_context(8, 8)
