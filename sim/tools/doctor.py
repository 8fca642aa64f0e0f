"""Check of what this machine has and lacks: each check is one line, and each problem comes with its fix."""

import os
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, metadata, requires, version
from pathlib import Path

from packaging.requirements import Requirement

from sim.files.atomic import find_existing
from sim.processes import usable_cores
from sim.sensors.camera.gl import EGL_FIX

NVIDIA_FIX = "install NVIDIA's EGL library (Debian: libegl-nvidia0; in a container: NVIDIA_DRIVER_CAPABILITIES=all)"
VULKAN_FIX = "apt-get install mesa-vulkan-drivers"
MIN_FREE_GB = 1.0  # the demo writes about 0.3 GB

_DRAWING_SCRIPT = """
import sys
from sim import errors
from sim.sensors.camera import gl
try:
    print(*gl.describe(), sep="\\n")
except (errors.InputError, errors.WorkError) as error:
    sys.exit(str(error))
"""


@dataclass(frozen=True)
class Check:
    """The result of one check."""

    name: str  # What was checked
    ok: bool  # Whether the testbed can work with it
    text: str  # What was found
    fix: str = ""  # What to do or to type; empty if all is well


def check_all(runs: Path = Path("runs")) -> list[Check]:
    """Check everything that a run needs, without raising; ``runs`` is where results would be written."""
    drawing, results = [check_renderer(), check_vulkan()], [check_folder(runs), check_disk(runs)]
    return [check_python(), *check_packages(), *check_extras(), *drawing, check_machine(), *results]


def check_python(found: tuple[int, int] = sys.version_info[:2]) -> Check:
    """Check that all packages have a wheel for this Python."""
    ok = (3, 11) <= found < (3, 15)
    text = f"{platform.python_version()} at {sys.executable}"
    return Check("python", ok, text, "" if ok else "make setup PYTHON=python3.11 (or 3.12, 3.13, 3.14)")


def check_packages(distribution: str = "deepgps") -> list[Check]:
    """Report the versions of what ``distribution`` requires, and one finding for each missing or unfit package."""
    try:
        wanted = _list_requirements(distribution)
    except PackageNotFoundError:
        return [Check("packages", False, f"{distribution} itself is not installed", "make setup")]
    found = [f"{one.name} {have}" for one in wanted if (have := _find_version(one))]
    faults = [Check("packages", False, fault, _install([one])) for one in wanted if (fault := _find_fault(one))]
    return [Check("packages", True, ", ".join(found)), *faults]


def check_extras(distribution: str = "deepgps") -> list[Check]:
    """Report each optional group of packages; a group that is not installed is no lack, since a run needs none."""
    try:
        extras = metadata(distribution).get_all("Provides-Extra") or []
    except PackageNotFoundError:
        return []
    checks = []
    for extra in extras:
        faults = {fault: one for one in _list_requirements(distribution, extra) if (fault := _find_fault(one))}
        fix = f"if you need it: {_install(faults.values())} (in a checkout: make setup-dev)"
        text = f"{', '.join(faults)}; {fix}" if faults else "installed"
        checks.append(Check("extras", True, f"{extra}: {text}"))
    return checks


def _install(wanted: Iterable[Requirement]) -> str:
    return " ".join(["pip install", *(f'"{one.name}{one.specifier}"' for one in wanted)])


def _list_requirements(distribution: str, extra: str = "") -> list[Requirement]:
    """Return what a distribution requires here: always, or because of an extra alone."""
    wanted = [Requirement(line) for line in requires(distribution) or []]
    always = [one for one in wanted if not one.marker or one.marker.evaluate({"extra": ""})]
    if not extra:
        return always
    return [one for one in wanted if one not in always and one.marker and one.marker.evaluate({"extra": extra})]


def _find_version(wanted: Requirement) -> str:
    """Return the version of a package, or an empty text if it is not installed."""
    try:
        return version(wanted.name)
    except PackageNotFoundError:
        return ""


def _find_fault(wanted: Requirement) -> str:
    """Return what is wrong with an installed package, or an empty text."""
    have = _find_version(wanted)
    if not have:
        return f"{wanted.name} is missing"
    return "" if wanted.specifier.contains(have, prereleases=True) else f"{wanted.name} {have} does not fit"


def check_renderer() -> Check:
    """Report the OpenGL backend and its renderer string, queried in a child process that a driver may crash."""
    try:
        command, home = [sys.executable, "-c", _DRAWING_SCRIPT], Path(__file__).parents[2]
        child = subprocess.run(
            command, cwd=home, capture_output=True, text=True, errors="replace", timeout=60, check=False
        )
    except subprocess.TimeoutExpired:
        return Check("renderer", False, "opening an OpenGL context takes more than 60 s", EGL_FIX)
    if child.returncode == 0:
        backend, renderer = child.stdout.strip().splitlines()[-2:]
        return judge_renderer(backend, renderer)
    complaint = (child.stderr.strip().splitlines() or [""])[-1]
    if child.returncode == 1 and "Traceback" not in child.stderr:
        problem, _, fix = complaint.rpartition(": ")  # the form of the errors of sim/sensors/camera/gl.py
        return Check("renderer", False, problem, fix)
    text = f"opening an OpenGL context ended with code {child.returncode}: {complaint}"
    return Check("renderer", False, text, EGL_FIX)


def judge_renderer(backend: str, renderer: str, nvidia: bool = Path("/dev/nvidiactl").exists()) -> Check:
    """Report a working renderer; EGL silently falls back to software where NVIDIA's own library is missing."""
    text = f"{backend}, {renderer}"
    if any(name in renderer for name in ("llvmpipe", "softpipe", "swrast")):
        text += f" (in software, though an NVIDIA GPU is here: {NVIDIA_FIX})" if nvidia else " (in software)"
    return Check("renderer", True, text)


def check_vulkan(folders: Iterable[Path] = (Path("/usr/share/vulkan"), Path("/etc/vulkan"))) -> Check:
    """Report the Vulkan drivers of this machine, which pictures of the viewer need, and nothing else."""
    drivers = sorted(path.stem for folder in folders for path in folder.glob("icd.d/*.json"))
    return Check("vulkan", True, ", ".join(drivers) or f"no driver; for deepgps view --screenshot: {VULKAN_FIX}")


def check_machine() -> Check:
    """Report the cores that this process may use, and the memory."""
    memory_gb = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9
    text = f"{usable_cores()} cores, {memory_gb:.0f} GB of memory, {platform.platform(terse=True)}"
    return Check("machine", True, text)


def check_folder(runs: Path) -> Check:
    """Check that results can be written to ``runs``."""
    try:
        with tempfile.TemporaryFile(dir=find_existing(runs)):
            return Check("folder", True, f"{runs.absolute()} can be written")
    except OSError as error:
        text = f"{runs.absolute()} cannot be written ({error.strerror})"
        return Check("folder", False, text, "give another with --out DIR")


def check_disk(runs: Path, least_gb: float = MIN_FREE_GB) -> Check:
    """Check that there is disk space for results."""
    free_gb = shutil.disk_usage(find_existing(runs)).free / 1e9
    fix = f"free {least_gb:g} GB, or give a folder on another disk with --out DIR" if free_gb < least_gb else ""
    return Check("disk", not fix, f"{free_gb:.1f} GB free", fix)
