"""What this machine has and lacks: each finding is one line, each lack comes with its cure."""

import os
import platform
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path

from packaging.requirements import Requirement

from sim.processes import usable_cores
from sim.sensors.gl import EGL_CURE

NVIDIA_CURE = "install NVIDIA's EGL library (Debian: libegl-nvidia0; in a container: NVIDIA_DRIVER_CAPABILITIES=all)"
LEAST_FREE_GB = 1.0  # the demo leaves some 0.3 GB behind

_DRAW = """
import sys
from sim import errors
from sim.sensors import gl
try:
    print(*gl.describe(), sep="\\n")
except (errors.InputError, errors.WorkError) as error:
    sys.exit(str(error))
"""


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at.

    Attributes:
        name: What was looked at.
        ok: Whether the testbed can work with it.
        text: What was found.
        cure: What to do or to type; empty where all is well.
    """

    name: str
    ok: bool
    text: str
    cure: str = ""


def diagnose(runs: Path = Path("runs")) -> list[Finding]:
    """Look at everything that a run needs; ``runs`` is where results would be written. Never raises."""
    return [
        check_python(),
        *check_packages(),
        check_renderer(),
        check_machine(),
        check_folder(runs),
        check_disk(runs),
    ]


def check_python(found: tuple[int, int] = sys.version_info[:2]) -> Finding:
    """Whether this Python is one that all packages have a wheel for."""
    ok = (3, 11) <= found < (3, 14)
    text = f"{platform.python_version()} at {sys.executable}"
    return Finding("python", ok, text, "" if ok else "make setup PYTHON=python3.11 (or 3.12, 3.13)")


def check_packages(distribution: str = "deepgps") -> list[Finding]:
    """The versions of what ``distribution`` requires, in one finding, and one for each that is missing or unfit."""
    try:
        wanted = [Requirement(line) for line in requires(distribution) or []]
    except PackageNotFoundError:
        return [Finding("packages", False, f"{distribution} itself is not installed", "make setup")]
    found, faults = [], []
    for one in wanted:
        if one.marker and not one.marker.evaluate({"extra": ""}):
            continue
        cure = f'pip install "{one.name}{one.specifier}"'
        try:
            have = version(one.name)
        except PackageNotFoundError:
            faults.append(Finding("packages", False, f"{one.name} is missing", cure))
            continue
        if not one.specifier.contains(have, prereleases=True):
            faults.append(Finding("packages", False, f"{one.name} {have} does not fit", cure))
        found.append(f"{one.name} {have}")
    return [Finding("packages", True, ", ".join(found)), *faults]


def check_renderer() -> Finding:
    """The OpenGL backend and its renderer string, asked for in a child process: a driver may crash it."""
    try:
        child = subprocess.run(
            [sys.executable, "-c", _DRAW],
            cwd=Path(__file__).parents[2],
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return Finding("renderer", False, "opening an OpenGL context takes more than 60 s", EGL_CURE)
    if child.returncode == 0:
        backend, renderer = child.stdout.strip().splitlines()[-2:]
        return judge_renderer(backend, renderer)
    complaint = (child.stderr.strip().splitlines() or [""])[-1]
    if child.returncode == 1 and "Traceback" not in child.stderr:
        problem, _, cure = complaint.rpartition(": ")  # how sim/sensors/gl.py words its errors
        return Finding("renderer", False, problem, cure)
    text = f"opening an OpenGL context ended with code {child.returncode}: {complaint}"
    return Finding("renderer", False, text, EGL_CURE)


def judge_renderer(backend: str, renderer: str, nvidia: bool = Path("/dev/nvidiactl").exists()) -> Finding:
    """A renderer that works; EGL falls back to software without a word where NVIDIA's own library is missing."""
    text = f"{backend}, {renderer}"
    if any(name in renderer for name in ("llvmpipe", "softpipe", "swrast")):
        text += f" (in software, though an NVIDIA GPU is here: {NVIDIA_CURE})" if nvidia else " (in software)"
    return Finding("renderer", True, text)


def check_machine() -> Finding:
    """Cores that this process may use, and memory."""
    memory_gb = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9
    text = f"{usable_cores()} cores, {memory_gb:.0f} GB of memory, {platform.platform(terse=True)}"
    return Finding("machine", True, text)


def check_folder(runs: Path) -> Finding:
    """Whether results can be written to ``runs``."""
    try:
        with tempfile.TemporaryFile(dir=_nearest(runs)):
            return Finding("folder", True, f"{runs.absolute()} can be written")
    except OSError as error:
        text = f"{runs.absolute()} cannot be written ({error.strerror})"
        return Finding("folder", False, text, "give another with --out DIR")


def check_disk(runs: Path, least_gb: float = LEAST_FREE_GB) -> Finding:
    """Whether there is room for results."""
    free_gb = shutil.disk_usage(_nearest(runs)).free / 1e9
    ok = free_gb >= least_gb
    cure = "" if ok else f"free {least_gb:g} GB, or give a folder on another disk with --out DIR"
    return Finding("disk", ok, f"{free_gb:.1f} GB free", cure)


def _nearest(folder: Path) -> Path:
    """The folder itself, or the nearest one above it that exists."""
    return next(path for path in (folder.absolute(), *folder.absolute().parents) if path.exists())
