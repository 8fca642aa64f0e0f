"""The doctor finds what is missing and names the fix, whatever the libraries do."""

import os
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

from deepgps.commands.machine import DoctorArguments, doctor_command
from sim.errors import WorkError
from sim.tools import doctor
from sim.tools.doctor import (
    Check,
    check_disk,
    check_extras,
    check_folder,
    check_packages,
    check_python,
    check_renderer,
    check_vulkan,
    judge_renderer,
)

ROOT = Path(__file__).parents[3]
EGL = ("libEGL.so", "libEGL.so.1")
OSMESA = ("libOSMesa.so", "libOSMesa.so.6", "libOSMesa.so.8")
OPENGL = (
    *("libOpenGL.so", "libOpenGL.so.0", "libGL.so", "libGL.so.1"),
    *("libGLESv2.so", "libGLESv2.so.2", "libGLESv1_CM.so", "libGLESv1_CM.so.1"),
)


@pytest.fixture
def mask(monkeypatch, tmp_path):
    """Hide system libraries from child processes: the loader finds an empty file first and refuses it."""

    def hide(*names: str) -> None:
        for name in names:
            (tmp_path / name).touch()
        monkeypatch.setenv("LD_LIBRARY_PATH", str(tmp_path))
        monkeypatch.delenv("PYOPENGL_PLATFORM", raising=False)

    return hide


@pytest.fixture
def site(monkeypatch, tmp_path):
    """Installed distributions of a test's own making: name, version, requirements, extras."""

    def install(name: str, number: str, *needs: str, extras: tuple[str, ...] = ()) -> None:
        folder = tmp_path / f"{name}-{number}.dist-info"
        folder.mkdir()
        lines = ["Metadata-Version: 2.1", f"Name: {name}", f"Version: {number}"]
        lines += [f"Requires-Dist: {need}" for need in needs] + [f"Provides-Extra: {extra}" for extra in extras]
        (folder / "METADATA").write_text("\n".join(lines) + "\n")

    monkeypatch.syspath_prepend(tmp_path)
    return install


def lacks(checks: list[Check]) -> list[tuple[str, str]]:
    return [(check.text, check.fix) for check in checks if not check.ok]


def test_all_is_well_where_the_tests_run(tmp_path):
    checks = doctor.check_all(tmp_path)
    assert lacks(checks) == []
    named = {check.name: check for check in checks}
    assert set(named) == {"python", "packages", "extras", "renderer", "vulkan", "machine", "folder", "disk"}
    assert all("\n" not in check.text for check in checks)
    packages = named["packages"]
    for name in ("mujoco", "torch", "rerun-sdk", "numpy"):
        assert f"{name} {version(name)}" in packages.text


def test_missing_and_unfit_packages_are_named_with_their_cure(site):
    site("wheelbarrow", "1.0", "oldpart>=2,<3", "nopart>=1.5", "numpy>=1; python_version < '3'", "evo; extra == 'dev'")
    site("oldpart", "1.9")
    packages, *_ = checks = check_packages("wheelbarrow")
    assert packages.ok and packages.text == "oldpart 1.9"
    assert lacks(checks) == [
        ("oldpart 1.9 does not fit", 'pip install "oldpart<3,>=2"'),
        ("nopart is missing", 'pip install "nopart>=1.5"'),
    ]


def test_extras_that_are_not_installed_name_their_cure_and_are_no_lack(site):
    needs = ("nopart>=1", "newpart; extra == 'full'", "oldpart>=2; extra == 'paint'", "nopaint; extra == 'paint'")
    site("wheelbarrow", "1.0", *needs, extras=("full", "paint"))
    site("oldpart", "1.9")
    site("newpart", "1.0")
    checks = check_extras("wheelbarrow")
    assert lacks(checks) == []
    assert [check.text for check in checks] == [
        "full: installed",
        "paint: oldpart 1.9 does not fit, nopaint is missing; "
        'if you need it: pip install "oldpart>=2" "nopaint" (in a checkout: make setup-dev)',
    ]


def test_a_checkout_that_is_not_installed_is_told_to_set_up():
    assert lacks(check_packages("no-such-testbed")) == [("no-such-testbed itself is not installed", "make setup")]


def test_only_pythons_with_all_wheels_are_fit():
    for minor, ok in ((10, False), (11, True), (14, True), (15, False)):
        check = check_python((3, minor))
        assert check.ok == ok and ("make setup PYTHON=" in check.fix) == (not ok)


def test_renderer_is_named(monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "egl")
    monkeypatch.delenv("PYOPENGL_PLATFORM", raising=False)
    check = check_renderer()
    assert check.ok and check.text.startswith("egl, ") and not check.fix


@pytest.mark.parametrize(
    ("masked", "backend", "problem", "fix"),
    [
        (EGL, "egl", "libEGL", "apt-get install libegl1 "),
        (OPENGL, "egl", "libOpenGL", "apt-get install libegl1 "),
        (OSMESA, "osmesa", "OSMesa", "apt-get install libosmesa6"),
        ((*EGL, *OSMESA), "", "libOSMesa", "libegl1"),
        ((), "directx", "MUJOCO_GL=directx", "egl or osmesa"),
    ],
)
def test_what_drawing_lacks_is_named_with_its_cure(masked, backend, problem, fix, mask, monkeypatch):
    mask(*masked)
    monkeypatch.setenv("MUJOCO_GL", backend)
    check = check_renderer()
    assert not check.ok
    assert problem in check.text and fix in check.fix
    assert "Traceback" not in check.text + check.fix


def test_a_driver_that_kills_the_process_is_an_answer_too_and_need_not_speak_text(monkeypatch):
    monkeypatch.setattr(doctor, "_DRAWING_SCRIPT", "import os; os.write(2, b'Ger\\xe4t fehlt\\n'); os.abort()")
    check = check_renderer()
    assert not check.ok
    assert "code -6" in check.text and "t fehlt" in check.text and check.fix == doctor.EGL_FIX


def test_software_beside_a_graphics_card_is_said():
    software = "llvmpipe (LLVM 15.0.6, 256 bits)"
    assert "NVIDIA" in judge_renderer("egl", software, nvidia=True).text
    assert "NVIDIA" not in judge_renderer("egl", software, nvidia=False).text
    assert "software" not in judge_renderer("egl", "NVIDIA H100/PCIe/SSE2", nvidia=True).text


def test_a_results_folder_need_not_exist_yet_and_one_that_cannot_be_written_is_told(tmp_path):
    assert check_folder(tmp_path / "a" / "b").ok
    assert not (tmp_path / "a").exists()
    (tmp_path / "file").touch()
    check = check_folder(tmp_path / "file")
    assert not check.ok
    assert str(tmp_path / "file") in check.text and "--out" in check.fix


def test_full_disk_is_told(tmp_path):
    check = check_disk(tmp_path, least_gb=1e9)
    assert not check.ok and "--out" in check.fix
    assert check_disk(tmp_path, least_gb=0.0).ok


def test_setup_installs_the_packages_that_the_cure_names():
    script = (ROOT / ".ci" / "setup").read_text(encoding="utf-8")
    for fix in (doctor.EGL_FIX, doctor.VULKAN_FIX):
        assert fix.removeprefix("apt-get install ") in script


def test_a_missing_vulkan_driver_is_no_lack_but_has_its_cure(tmp_path):
    check = check_vulkan([tmp_path])
    assert check.ok and check.text.endswith(doctor.VULKAN_FIX)
    (tmp_path / "icd.d").mkdir()
    (tmp_path / "icd.d" / "lvp_icd.json").touch()
    assert check_vulkan([tmp_path]).text == "lvp_icd"


def test_command_tells_the_lack_and_fails(mask, tmp_path):
    mask(*EGL, *OSMESA)
    done = run_doctor(tmp_path, MUJOCO_GL="egl")
    assert done.returncode == 1
    assert "apt-get install libegl1" in done.stdout
    assert "Traceback" not in done.stdout + done.stderr


def test_command_names_the_device(tmp_path):
    done = run_doctor(tmp_path, MUJOCO_GL="egl")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "device" in done.stdout and "mujoco" in done.stdout


def test_command_prints_cures_with_their_brackets(monkeypatch, capsys):
    fix = "pip install 'deepgps[ray]'"
    checks = [Check("extras", True, f"ray: {fix}"), Check("packages", False, "part is missing", fix)]
    monkeypatch.setattr(doctor, "check_all", lambda: checks)
    with pytest.raises(WorkError):
        doctor_command(DoctorArguments())
    assert capsys.readouterr().out.count(fix) == 2


def run_doctor(folder: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    command = [Path(sys.executable).with_name("deepgps"), "doctor"]
    return subprocess.run(
        command, cwd=folder, env=os.environ | environment, capture_output=True, text=True, check=False
    )
