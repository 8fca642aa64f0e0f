"""Measure how fast this machine runs a scenario, draws images, trains and positions, and how much memory that takes.

Usage: python tests/bench.py [SCENARIO], by default demo; it works in a temporary folder of runs/. With ``--scale``, see
``tests/bench_scale.py``.
"""

import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from sim.sensors.camera.gl import choose_backend

choose_backend()

import mujoco  # noqa: E402 (it reads at its import which renderer was chosen)

from deepgps.config.scenario import Scenario  # noqa: E402
from deepgps.learning.trainer import use_threads  # noqa: E402
from deepgps.positioner.stored_positioner import load_positioner  # noqa: E402
from deepgps.runs.run_folder import METRICS, open_run  # noqa: E402
from sim.files.checksums import read_json  # noqa: E402
from sim.recording.format import open_recording  # noqa: E402
from sim.robot.world import RoomWorld  # noqa: E402
from sim.sensors.camera.fisheye import Fisheye  # noqa: E402
from tests import bench_scale  # noqa: E402

Row = tuple[str, float, str]
"""What was measured, its value and its unit."""
SINGLE, AT_ONCE, REPEATS = 400, 500, 9
"""Single observations that are timed, observations in a batch, and repetitions, of which the median counts."""


def measure_run(scenario: str, folder: Path) -> Iterator[Row]:
    """Run the scenario as a user does; seconds of its stages, steps of training a second, peak memory, error."""
    start = time.perf_counter()
    command = [sys.executable, "-m", "deepgps.commands.main", "run", scenario, "--out", str(folder)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    yield f"deepgps run {scenario}", time.perf_counter() - start, "s"
    for stage, seconds in read_json(folder / "timing.json").items():
        yield f"  {stage}", seconds, "s"
    yield "  largest process", resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1e6, "GB"
    for method, metrics in read_json(folder / METRICS)["methods"].items():
        training = read_json(folder / method / "training.json")
        if training["steps"]:
            yield f"{method}: training", training["steps"] / training["train_s"], "steps/s"
        yield f"{method}: error", 100 * metrics["rms_m"], "cm RMS"


def measure_camera(scenario: Scenario) -> Iterator[Row]:
    """Images a second of the fisheye camera, in one process."""
    if scenario.world != "room" or scenario.sensor != "fisheye":
        return
    world = RoomWorld(scenario.sim)
    poses = np.random.default_rng(0).uniform(-0.5, 0.5, (SINGLE, 3))
    states = world.rest_states(poses)

    def draw_all(fisheye: Fisheye) -> None:
        for state in states:
            world.data.qpos[:] = state
            mujoco.mj_kinematics(world.model, world.data)
            fisheye.polar(world.data)

    with Fisheye(world.model, scenario.camera) as fisheye:
        draw_all(fisheye)  # the first images take longer
        yield "fisheye, one process", SINGLE / time_call(lambda: draw_all(fisheye)), "images/s"


def measure_positions(folder: Path, method: str) -> Iterator[Row]:
    """Milliseconds for one position, and positions a second, on one core."""
    positioner = load_positioner(folder / method)
    observations = np.array(open_recording(folder / "recording").observation[:AT_ONCE])
    with use_threads(1):
        single = [time_call(lambda one=one: positioner(one[None])) for one in observations[:SINGLE]]
        batch = [time_call(lambda: positioner(observations)) for _ in range(REPEATS)]
    yield f"{method}: one position", 1e3 * float(np.median(single)), "ms"
    yield f"{method}: {len(observations)} at once", len(observations) / float(np.median(batch)), "positions/s"


def time_call(work: Callable[[], object]) -> float:
    """Seconds that a call takes."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def main() -> None:
    """Measure everything and print each figure as soon as it is known."""
    if "--scale" in sys.argv:
        bench_scale.main([int(images) for images in sys.argv[2:]])
        return
    name = sys.argv[1] if len(sys.argv) > 1 else "demo"
    Path("runs").mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory(dir="runs", prefix="bench-") as work:
        folder = Path(work) / "run"

        def measure_all() -> Iterator[Row]:
            yield from measure_run(name, folder)
            scenario = open_run(folder)
            yield from measure_camera(scenario)
            for method in scenario.methods:
                yield from measure_positions(folder, method)

        for what, value, unit in measure_all():
            print(f"{what:<36} {value:>12,.4g} {unit}", flush=True)


if __name__ == "__main__":
    main()
