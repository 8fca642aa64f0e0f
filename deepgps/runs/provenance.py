"""Where a result comes from: packages, commit, machine, and the seconds of each stage, summed over all sittings."""

import logging
import platform
import subprocess
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any

from sim.errors import DamagedError
from sim.files.checksums import read_json, write_json
from sim.processes import usable_cores
from sim.recording.format import read_manifest

ROOT = Path(__file__).parents[2]  # Where the package lies: the root of a clone, or the packages of an installation
NAMED_PACKAGES = ("mujoco", "torch", "numpy")  # Packages that a study's report names
PACKAGES = ("deepgps", "mujoco", "torch", "numpy", "opencv-python-headless", "rerun-sdk")

log = logging.getLogger(__name__)


def describe_environment(folder: Path, methods: Iterable[Mapping[str, Any]] = ()) -> dict[str, Any]:
    """The renderer, packages, commit and machine that a run's figures were made with, and where its methods trained."""
    trained = _join(method["trained_on"] for method in methods if "trained_on" in method)
    made = {"gl_renderer": read_manifest(folder / "recording").gl_renderer, "trained_on": trained or None}
    return {**made, **_describe_process()}


def describe_origin(environments: Sequence[Mapping[str, Any]]) -> str:
    """A sentence on the commits, machines and packages that runs were made with; without any, on this process."""
    environments = environments or [_describe_process()]
    commits, machines, pythons = (
        _join(one.get(name, "-") for one in environments) for name in ("git", "cpu", "python")
    )
    devices = _join(device for one in environments if not (device := one.get("trained_on") or "CPU").startswith("CPU"))
    trained = f" trained on {devices}," if devices else ""
    versions = [one.get("packages", {}) for one in environments]
    packages = _join(", ".join(f"{name} {one.get(name, '-')}" for name in NAMED_PACKAGES) for one in versions)
    return f"Made at {commits} on {machines},{trained} with Python {pythons}, {packages}."


def _join(values: Iterable[str]) -> str:
    return " and ".join(dict.fromkeys(values))


def _describe_process() -> dict[str, Any]:
    return {
        "packages": {name: version(name) for name in PACKAGES},
        "python": platform.python_version(),
        "git": find_revision(ROOT),
        "cpu": f"{usable_cores()} x {_cpu_name()}",
    }


def find_revision(root: Path) -> str:
    """The commit of a repository's root; of an installed package it is not known, whatever repository is around it."""
    if not (root / ".git").exists():
        return "unknown"
    command = ["git", "-C", str(root), "describe", "--always", "--dirty"]
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


@contextmanager
def timed(folder: Path, stage: str, done: bool = False) -> Iterator[None]:
    """Add the seconds of a stage, or of the part before it was interrupted, to the run's ``timing.json`` and its log,
    unless the stage was already done."""
    start = time.perf_counter()
    try:
        yield
    finally:
        if not done:
            _add_time(folder, stage, time.perf_counter() - start)


def stage_times(folder: Path) -> dict[str, float]:
    """Seconds of each stage of a run, without work done elsewhere, such as a study's recordings."""
    times: dict[str, float] = {}
    for name, seconds in _read_times(folder).items():
        stage = name.partition(" ")[0]  # a training is timed as "train" and its method
        times[stage] = round(times.get(stage, 0.0) + seconds, 2)
    return times


def _read_times(folder: Path) -> dict[str, float]:
    path = folder / "timing.json"
    try:
        return read_json(path) if path.is_file() else {}
    except DamagedError as error:
        log.warning("%s; seconds are counted from zero", error)
        return {}


def _add_time(folder: Path, stage: str, seconds: float) -> None:
    path = folder / "timing.json"
    times = _read_times(folder)
    write_json(path, {**times, stage: round(times.get(stage, 0.0) + seconds, 2)})
    with (folder / "log.txt").open("a", encoding="utf-8") as file:
        file.write(f"{time.strftime('%Y-%m-%d %H:%M:%S')} {stage}: {seconds:.1f} s\n")
