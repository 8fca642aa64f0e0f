"""Where a result comes from: packages, commit, machine."""

import platform
import subprocess
from importlib.metadata import version
from pathlib import Path
from typing import Any

from sim.processes import usable_cores
from sim.recording.format import read_manifest

PACKAGES = ("deepgps", "mujoco", "torch", "numpy", "opencv-python-headless", "rerun-sdk")


def describe_environment(folder: Path) -> dict[str, Any]:
    """The renderer, packages, commit and machine that a run's figures were made with."""
    manifest = read_manifest(folder / "recording")
    return {
        "gl_renderer": manifest.gl_renderer,
        "packages": {name: version(name) for name in PACKAGES},
        "python": platform.python_version(),
        "git": _git_revision(),
        "cpu": f"{usable_cores()} x {_cpu_name()}",
    }


def _git_revision() -> str:
    command = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def _cpu_name() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.machine()
    return next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.machine())
