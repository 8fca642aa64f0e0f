"""The bench: the promises about speed, latency, memory and steadiness, measured again, against naive baselines."""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from deepgps.bench.memory import measure_memory
from deepgps.bench.paper import measure_paper
from deepgps.bench.rows import KEPT, Row, write_bench
from deepgps.bench.speed import measure_speed, measure_spread
from deepgps.config.scenario import Scenario, load_scenario
from deepgps.evaluation.evaluate import evaluate
from deepgps.methods.train import train
from deepgps.positioner.positioner import NetworkPositioner
from deepgps.positioner.stored_positioner import load_positioner
from deepgps.runs.collect import collect
from deepgps.runs.provenance import describe_environment
from deepgps.runs.run_folder import METRICS
from deepgps.runs.timing import stage_times
from deepgps.terminal.progress import Report, ignore
from sim.errors import InputError, WorkError
from sim.files.arrays import read_arrays
from sim.files.json_files import read_json
from sim.recording.format import open_recording
from sim.settings import GridSettings, SimSettings

DrawPoses = Callable[[SimSettings, np.ndarray], tuple[np.ndarray, float]]
MeasureRendering = Callable[[SimSettings, np.ndarray, int], dict[str, float]]


DRAWN = 8  # maximum number of poses for comparing renderers


@dataclass(frozen=True)
class Size:
    """How much is measured.

    Attributes:
        scenario: The scenario of the demo.
        quick: The scenario of the quick schedule, on the demo's recording.
        settings: Settings by dotted name, for both.
        places: Number of places at which predictions are compared over headings.
        headings: Number of headings at each place.
        repeats: Number of repetitions of timed work; medians count.
        long: Number of observations in the long recording.
        steps: Number of steps of each training on it.
        paper_steps: Number of steps of the paper's recipe.
    """

    scenario: str
    quick: str
    settings: Mapping[str, Any]
    places: int
    headings: int
    repeats: int
    long: int
    steps: int
    paper_steps: int


FULL = Size("living_room", "quick", {}, places=60, headings=64, repeats=9, long=1_000_000, steps=200, paper_steps=40)
TINY_SETTINGS = {
    "camera.rings": 8,
    "camera.sectors": 32,
    "camera.face_px": 16,
    "drive.samples": 120,
    "grid.spacing_m": 0.5,
    "learn.train.steps": 20,
}
TINY = Size("tiny", "tiny", TINY_SETTINGS, places=3, headings=4, repeats=2, long=500, steps=20, paper_steps=2)


def choose_size(tiny: bool, memory_samples: int | None) -> Size:
    """The size asked for; raises InputError if the long recording would be shorter than the demo's."""
    size = TINY if tiny else FULL
    if memory_samples is None:
        return size
    least = load_scenario(size.scenario, size.settings).drive.samples
    if memory_samples < least:
        raise InputError(f"--memory-samples {memory_samples}: at least {least}, as many as the recording it repeats")
    return replace(size, long=memory_samples)


def run_bench(
    size: Size, out: Path, keep: bool, draw_poses: DrawPoses, measure_rendering: MeasureRendering, progress: Report
) -> list[Row]:
    """Measure everything and write the results.

    Args:
        size: How much is measured.
        out: The file to write.
        keep: Whether rows get verdicts and a copy is kept for comparison with later benches.
        draw_poses, measure_rendering: As for ``measure``.
        progress: Called with the steps done and their number.
    """
    started, load = time.strftime("%Y-%m-%dT%H%M"), os.getloadavg()[0]  # before the bench adds its own load
    KEPT.mkdir(parents=True, exist_ok=True)
    begun = time.perf_counter()
    with tempfile.TemporaryDirectory(dir=KEPT, prefix="work-") as work:  # not in /tmp, which may be in memory
        rows, environment = measure(size, Path(work), draw_poses, measure_rendering, progress)
    if not keep:  # targets do not apply to so small a bench
        rows = [replace(row, target=None) for row in rows]
    head = {"date": started, "took_s": round(time.perf_counter() - begun, 1), "load": load, **environment}
    write_bench(out, rows, head)
    if keep:
        write_bench(KEPT / f"{started}-{environment['git']}.json", rows, head)
    return rows


def measure(
    size: Size, folder: Path, draw_poses: DrawPoses, measure_rendering: MeasureRendering, progress: Report
) -> tuple[list[Row], dict[str, Any]]:
    """Measure everything.

    Args:
        size: How much is measured.
        folder: An empty folder to work in.
        draw_poses: Returns the images at poses (n, 3), and the number of images per second.
        measure_rendering: Returns the seconds per observation for each renderer.
        progress: Called with the steps done and their number.

    Returns:
        The rows, and the environment in which they were measured.
    """
    scenario = load_scenario(size.scenario, size.settings)
    demo = folder / "demo"
    parts: list[Callable[[], list[Row]]] = [
        lambda: measure_demo(size, folder),
        lambda: measure_quick(size, demo, folder / "quick", progress),
        lambda: measure_pictures(scenario, size, demo, draw_poses, measure_rendering),
        lambda: measure_positions(demo, size),
        lambda: measure_paper(
            load_scenario("paper", size.settings), demo, size.paper_steps, folder / "paper", progress
        ),
        lambda: measure_memory(demo / "recording", scenario.learn, size.long, size.steps, min(size.repeats, 3), folder),
    ]
    rows = []
    for number, part in enumerate(parts):
        progress("bench", number, len(parts))
        rows += part()
    progress("bench", len(parts), len(parts))
    return rows, describe_environment(demo)


def measure_demo(size: Size, folder: Path) -> list[Row]:
    """Time the complete demo as a user starts it, its training, and collecting its samples without the test grid."""
    scenario = load_scenario(size.scenario, size.settings)
    words = [word for name, value in size.settings.items() for word in (f"--{name}", str(value))]
    command = [
        sys.executable,
        "-m",
        "deepgps.commands.main",
        "run",
        size.scenario,
        "--out",
        str(folder / "demo"),
        *words,
    ]
    start = time.perf_counter()
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    demo_s = time.perf_counter() - start
    if done.returncode != 0:
        raise WorkError(f"deepgps run {size.scenario}: {done.stderr.strip()[-300:]}")
    (folder / "samples").mkdir()
    grid = GridSettings(spacing_m=1.0, headings=1)
    collect(scenario.model_copy(update={"grid": grid}), folder / "samples", ignore)
    collect_s = stage_times(folder / "samples")["collect"]
    times = read_json(folder / "demo" / "timing.json")
    training, naive = (read_json(folder / "demo" / name / "training.json") for name in ("deepgps", "posenet"))
    grid_s = f"physics, pictures, writing; the demo's test grid takes {times['collect'] - collect_s:.0f} s more"
    tries = f"{training['attempts']} training of {training['steps']} steps; naive: PoseNet"
    samples = f"{scenario.drive.samples:,} samples"
    return [
        Row("train", f"training on {samples}", training["train_s"], "s", 90.0, False, naive["train_s"], tries),
        Row("demo", "the whole demo", demo_s, "s", 240.0, note=", ".join(f"{n} {s:.0f} s" for n, s in times.items())),
        Row("collect", f"collecting {samples}", collect_s, "s", 40.0, note=grid_s),
    ]


def measure_quick(size: Size, demo: Path, folder: Path, progress: Report) -> list[Row]:
    """Measure the total time and the error of the quick schedule on the demo's recording."""
    scenario = load_scenario(size.quick, size.settings).model_copy(update={"methods": ("deepgps",)})
    folder.mkdir()
    (folder / "recording").symlink_to((demo / "recording").resolve())
    train(scenario, folder, progress)
    found = evaluate(folder, scenario)["methods"]["deepgps"]
    seconds = read_json(folder / "timing.json")["train deepgps"]
    rms = 100 * found["relative_rms"]
    baseline = 100 * read_json(demo / METRICS)["methods"]["posenet"]["relative_rms"]
    note = f"of the shorter side: {100 * found['rms_m']:.1f} cm; {found['steps']} steps; naive: PoseNet, whole"
    return [
        Row("quick", "quick schedule", seconds, "s", 15.0, note="features, initial map, training, search for folds"),
        Row("quick_rms", "RMS of the quick schedule", rms, "%", 2.0, False, baseline, note),
    ]


def measure_pictures(
    scenario: Scenario, size: Size, demo: Path, draw_poses: DrawPoses, measure_rendering: MeasureRendering
) -> list[Row]:
    """Measure rendering, and how steady predictions are over headings that are really rendered."""
    cell = read_arrays(demo / "error_field.npz")["truth"]
    place = cell[np.linspace(0, len(cell) - 1, size.places).round().astype(int)]
    yaw = np.arange(size.headings) * 2.0 * np.pi / size.headings
    poses = np.concatenate([place.repeat(size.headings, axis=0), np.tile(yaw, len(place))[:, None]], axis=1)
    images, rate = draw_poses(scenario.sim, poses)
    images = images.reshape(len(place), size.headings, *images.shape[1:])
    seen = f"{size.headings} headings at {len(place)} places; naive: PoseNet"
    ours, baseline = (measure_spread(load_positioner(demo / name), images) for name in ("deepgps", "posenet"))
    some = poses[:: size.headings][:: -(-len(place) // DRAWN)]  # the slowest renderer takes half a second for each
    seconds = measure_rendering(scenario.sim, some, min(size.repeats, 5))
    faster, plain = seconds["faces"] / seconds["fisheye"], seconds["plain"] / seconds["fisheye"]
    drawn = f"{seconds['geoms']:.0f} geoms; {1e3 * seconds['fisheye']:.2f} ms against {1e3 * seconds['faces']:.2f} ms"
    shadows = f"with shadows: {1e3 * seconds['plain']:.0f} ms"
    alone = "naive: five faces, one process"
    return [
        Row("spread", "spread over headings, RMS", 1e3 * ours[0], "mm", 5.0, False, 1e3 * baseline[0], seen),
        Row("spread_worst", "spread, worst heading", 1e3 * ours[1], "mm", naive=1e3 * baseline[1], note=seen),
        Row("render", "fisheye, times faster than 5 faces", faster, "", 3.0, True, 1.0, drawn),
        Row("render_plain", "... than 5 faces by default", plain, "", naive=1.0, note=shadows),
        Row("render_rate", "observations, 2 processes", rate, "/s", 400.0, True, 1.0 / seconds["faces"], alone),
    ]


def measure_positions(demo: Path, size: Size) -> list[Row]:
    """Time positioning on the demo's images."""
    positioner = load_positioner(demo / "deepgps")
    if not isinstance(positioner, NetworkPositioner):
        raise WorkError(f"{demo / 'deepgps'} holds no network")
    images = np.array(open_recording(demo / "recording").observation[:2000])
    return measure_speed(positioner, images, size.repeats)
