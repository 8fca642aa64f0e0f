"""A run: collect, train, evaluate, show. Each stage skips what is done and continues what was cut off."""

import logging
import platform
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any

from deepgps.progress import Report
from deepgps.run_folder import claim, find_place
from deepgps.scenario import Scenario
from sim.errors import DamagedError
from sim.files import is_intact, read_arrays, read_json, write_json
from sim.processes import usable_cores
from sim.recording.format import is_whole, read_manifest
from sim.settings import WorldName

log = logging.getLogger(__name__)
PACKAGES = ("deepgps", "mujoco", "torch", "numpy", "opencv-python-headless", "rerun-sdk")


def run(scenario: Scenario, folder: Path, fresh: bool, progress: Report) -> dict[str, Any]:
    """Run all stages of a scenario.

    Args:
        scenario: What to run.
        folder: The run folder.
        fresh: Whether to replace a run that is there, once the new one is complete.
        progress: Told how far each stage is.

    Returns:
        The contents of ``metrics.json``.
    """
    with claim(scenario, folder, fresh) as place:
        ask_for_device(scenario, place)
        collect(scenario, place, progress)
        train(scenario, place, progress)
        metrics = evaluate(scenario, place, progress)
        show(scenario, place, progress)
    return metrics


def list_undriven(scenario: Scenario, folder: Path, fresh: bool) -> list[Scenario]:
    """The scenario, if a run of it must still drive and look; what is recorded needs neither MuJoCo nor a renderer."""
    return [] if is_whole(find_place(folder, fresh) / "recording") else [scenario]


def ask_for_device(scenario: Scenario, folder: Path) -> None:
    """Raise InputError where a recording is still to be made and the device that shall learn from it is not here."""
    if scenario.learn.train.device.startswith("cuda") and not is_whole(folder / "recording"):
        from deepgps.learning.trainer import choose_device

        choose_device(scenario.learn.train.device)


def collect(scenario: Scenario, folder: Path, progress: Report) -> None:
    """Drive and look: write the recording, if it does not stand yet."""
    if not is_whole(folder / "recording"):
        with timed(folder, "collect"):
            make_recording(scenario, folder / "recording", progress)


def make_recording(scenario: Scenario, folder: Path, progress: Report) -> None:
    """Drive and look: write the recording ``folder``, or what is missing of it."""
    RECORD[scenario.world](scenario, folder, progress)


def train(scenario: Scenario, folder: Path, progress: Report) -> None:
    """Train each method that does not stand yet."""
    from deepgps.methods.catalog import METHODS
    from deepgps.methods.positioner import is_finished
    from sim.recording.format import open_recording

    recording = open_recording(folder / "recording")
    seed = training_seed(scenario)
    for method in scenario.methods:
        with timed(folder, f"train {method}", done=is_finished(folder / method)):
            METHODS[method](recording, scenario.learn, seed, folder / method, progress)


def training_seed(scenario: Scenario) -> int:
    """The seed of weights and shuffling: the scenario's, unless learning has one of its own."""
    return scenario.seed if scenario.learn.seed is None else scenario.learn.seed


def evaluate(scenario: Scenario, folder: Path, progress: Report) -> dict[str, Any]:
    """Measure all methods; write ``metrics.json`` and ``error_field.npz``."""
    from deepgps.evaluation.evaluate import evaluate as measure

    if metrics := read_measured(folder):
        return metrics
    with timed(folder, "evaluate"):
        progress("evaluate", 0, 1)
        measured = measure(folder, scenario)
        progress("evaluate", 1, 1)
    head = {"scenario": scenario.name, "seed": scenario.seed}
    tail = {"timing_s": stage_times(folder), "environment": describe_environment(folder)}
    write_json(folder / "metrics.json", {**head, **measured, **tail})
    return read_json(folder / "metrics.json")


def show(scenario: Scenario, folder: Path, progress: Report) -> None:
    """Draw the figures and write the Rerun recording."""
    from deepgps.figures.run_figures import draw_figures
    from deepgps.viewer.run.recording import write_recording

    path = folder / "recording.rrd"
    if not is_intact(path):
        with timed(folder, "show"):
            progress("show", 0, 2)
            draw_figures(folder)
            progress("show", 1, 2)
            write_recording(folder)
            progress("show", 2, 2)


def read_measured(folder: Path) -> dict[str, Any] | None:
    """The contents of a run's ``metrics.json``; none: it, or an error field, is missing or damaged."""
    if not (folder / "metrics.json").is_file():
        return None
    try:
        metrics = read_json(folder / "metrics.json")
        for name in ("error_field.npz", "label_field.npz")[: 2 if "labels" in metrics else 1]:
            read_arrays(folder / name)
    except DamagedError as error:
        log.warning("%s; the methods are measured again", error)
        return None
    return metrics


@contextmanager
def timed(folder: Path, stage: str, done: bool = False) -> Iterator[None]:
    """Add the seconds of a stage, or of the part of it before it was cut off, to the run's ``timing.json`` and its log,
    unless it was done before."""
    start = time.perf_counter()
    try:
        yield
    finally:
        if not done:
            _add_time(folder, stage, time.perf_counter() - start)


def stage_times(folder: Path) -> dict[str, float]:
    """Seconds of collecting, training and evaluating, without what was done elsewhere, as a study's recordings are."""
    times = _read_times(folder)
    parts = {name: [times[one] for one in times if one.partition(" ")[0] == name] for name in STAGES}
    return {name: round(sum(seconds), 2) for name, seconds in parts.items() if seconds}


def describe_environment(folder: Path) -> dict[str, Any]:
    """What the figures were made with."""
    manifest = read_manifest(folder / "recording")
    return {
        "gl_renderer": manifest["gl_renderer"],
        "packages": {name: version(name) for name in PACKAGES},
        "python": platform.python_version(),
        "git": _git_revision(),
        "cpu": f"{usable_cores()} x {_cpu_name()}",
    }


def _read_times(folder: Path) -> dict[str, float]:
    """Seconds of a run's stages so far."""
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


def _record_room(scenario: Scenario, folder: Path, progress: Report) -> None:
    from sim.recording.collect import collect as collect_room

    collect_room(scenario.sim, scenario.seed, folder, progress)


def _record_landmarks(scenario: Scenario, folder: Path, progress: Report) -> None:
    from sim.planar.landmarks import collect as collect_landmarks

    collect_landmarks(scenario.sim, scenario.seed, folder, progress)


def _record_lidar(scenario: Scenario, folder: Path, progress: Report) -> None:
    from sim.planar.obstacles import collect as collect_lidar

    collect_lidar(scenario.sim, scenario.seed, folder, progress)


RECORD: dict[WorldName, Callable[[Scenario, Path, Report], None]] = {
    "room": _record_room,
    "landmarks": _record_landmarks,
    "lidar": _record_lidar,
}
STAGES: dict[str, Callable[[Scenario, Path, Report], Any]] = {
    "collect": collect,
    "train": train,
    "evaluate": evaluate,
}
