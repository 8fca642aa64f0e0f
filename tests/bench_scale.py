"""Measure how seconds and memory of registration grow with the images and the floor: ``make bench ARGS=--scale``.

Usage: python tests/bench.py --scale [IMAGES ...], by default 8000 16000 32000 64000. Drives and images are the real
thing, by the robot's own map and with the default camera; only the test grid is coarse. Each size has a run of its own
in runs/scale/, whose drive is kept; it is measured in a process of its own. The table and the plot have every size that
was ever measured there.
"""

import json
import re
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib.pyplot as plt
import numpy as np

HOME = Path("runs/scale")
FIGURES = "scale.json"
STAGES = {
    "features": "features",
    "map": "map by compass",
    "registration": "noise model, calibration",
    "viewer": "viewer recording",
}
"""What is measured, and its title."""


class Case(NamedTuple):
    """A floor [m2] and the overrides that make it."""

    title: str
    floor_m2: int
    words: tuple[str, ...]


def make_case(title: str, kind: str, width_m: float, depth_m: float) -> Case:
    """A rectangle of a kind of room."""
    words = ("--room.kind", kind, "--room.width-m", str(width_m), "--room.depth-m", str(depth_m))
    return Case(title, round(width_m * depth_m), words)


CASES = {
    8_000: make_case("living room", "living_room", 6.0, 5.0),
    16_000: make_case("flat", "flat", 10.0, 9.0),
    32_000: make_case("office floor", "corridor", 16.0, 12.5),
    64_000: make_case("office floor", "corridor", 25.0, 16.0),
}
"""Floors by the images taken of them."""


def main(sizes: list[int]) -> None:
    """Measure some sizes in processes of their own, then write the table and the plot of all that were measured."""
    for images in sizes or CASES:
        case, folder = CASES[images], HOME / str(images)
        if not (folder / "recording" / "manifest.json").is_file():
            words = ("collect", "flat", *case.words, "--drive.samples", str(images), "--methods", "registration")
            command = [sys.executable, "-m", "deepgps.commands.main", *words, "--out", str(folder)]
            subprocess.run([*command, "--grid.spacing-m", "0.5", "--grid.headings", "1"], check=True)
        subprocess.run([sys.executable, __file__, str(folder)], check=True)
    rows = [json.loads(path.read_text()) for path in HOME.glob(f"*/{FIGURES}")]
    rows.sort(key=lambda row: row["images"])
    (HOME / "table.md").write_text(tabulate(rows))
    draw(rows, HOME / "scale.png")
    print(tabulate(rows), f"{HOME}/table.md, {HOME}/scale.png", sep="\n")


def measure(folder: Path) -> None:
    """Learn from the recording of a run and show it; write seconds and peak memory of each stage into the run."""
    from deepgps.evaluation.measure_run import evaluate
    from deepgps.learning.trainer import use_threads
    from deepgps.learning.training_data import prepare
    from deepgps.methods.compass import find_mount, keep_chosen, map_by_compass
    from deepgps.methods.registration import finish
    from deepgps.positioner.stored_positioner import save_positioner
    from deepgps.runs.run_folder import METRICS, open_run
    from deepgps.terminal.progress import ignore
    from deepgps.viewer.run import write_run
    from sim.recording.format import open_recording

    for name in ("features/features.key", "registration/positioner.json", "diagnosis.json", METRICS):
        (folder / name).unlink(missing_ok=True)
    scenario, recording = open_run(folder), open_recording(folder / "recording")
    place, found = folder / "registration", dict[str, Any]()
    images = len(recording.observation)

    def stage(name: str, work: Callable[[], Any]) -> Any:
        forget_peak()
        start, used = time.perf_counter(), time.process_time()
        result = work()
        took = {"s": time.perf_counter() - start, "cpu_s": time.process_time() - used, "gb": read_peak_gb()}
        found[name] = {unit: round(value, 2) for unit, value in took.items()}
        print(f"{images:,} images, {name}: {found[name]}", flush=True)
        return result

    with use_threads(scenario.learn.train.threads):
        stage("features", lambda: prepare(recording, scenario.learn, scenario.seed, folder))
        data, mapped, record = stage(
            "map", lambda: map_by_compass(recording, scenario.learn, scenario.seed, place, ignore)
        )
        places, mount = keep_chosen(mapped), find_mount(mapped)
        fitted = stage(
            "registration",
            lambda: finish(data, places, mapped.heading, ignore, place, mapped.std, mount).note(record),
        )
        save_positioner(place, *fitted)
    metrics = evaluate(scenario, folder, ignore)
    assert metrics is not None
    stage("viewer", lambda: write_run(folder))
    case = CASES[int(folder.name)]
    about = {"title": case.title, "floor_m2": case.floor_m2, "images": images}
    median_cm = round(100 * metrics["methods"]["registration"]["median_m"], 2)
    (folder / FIGURES).write_text(json.dumps({**about, "stages": found, "median_cm": median_cm}, indent=1))


def forget_peak() -> None:
    """Let the peak of this process's memory begin at what it holds now (Linux)."""
    Path("/proc/self/clear_refs").write_text("5")


def read_peak_gb() -> float:
    """Peak of this process's memory [GB], with pages of mapped files, which the system may take back."""
    found = re.search(r"VmHWM:\s+(\d+) kB", Path("/proc/self/status").read_text())
    assert found is not None
    return int(found[1]) / 1e6


def tabulate(rows: list[dict[str, Any]]) -> str:
    """The measurements as a Markdown table."""
    stages = (f"{title} [s; processor s; GB]" for title in STAGES.values())
    head = ("floor", "images", *stages, "all but viewer [min; processor min]", "median [cm]")
    lines = [f"| {' | '.join(head)} |", f"|---{'|--:' * (len(head) - 1)}|"]
    for row in rows:
        parts = [row["stages"][name] for name in STAGES]
        each = [f"{part['s']:,.0f}; {part['cpu_s']:,.0f}; {part['gb']:.1f}" for part in parts]
        whole = "; ".join(f"{sum(part[name] for part in parts[:-1]) / 60:.1f}" for name in ("s", "cpu_s"))
        floor, images = f"{row['title']}, {row['floor_m2']} m2", f"{row['images']:,}"
        lines.append(f"| {' | '.join((floor, images, *each, whole, str(row['median_cm'])))} |")
    return "\n".join(lines) + "\n"


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw seconds and memory over the images."""
    figure, axes = plt.subplots(1, 2, figsize=(9.5, 3.6), layout="constrained")
    images = [row["images"] for row in rows]
    for axis, unit, title in zip(axes, ("cpu_s", "gb"), ("processor seconds", "peak memory [GB]"), strict=True):
        for name, label in STAGES.items():
            axis.plot(images, [row["stages"][name][unit] for row in rows], "o-", label=label)
        axis.set(xscale="log", xlabel="images", title=title, xticks=images, xticklabels=[f"{one:,}" for one in images])
        axis.minorticks_off()
        axis.set_ylim(bottom=0.0)
        axis.grid(alpha=0.3)
    steep = np.array(images) * (rows[0]["stages"]["map"]["cpu_s"] / images[0])
    axes[0].plot(images, steep, ":", color="grey", label="in proportion to images, from the first map")
    axes[0].legend(fontsize=8)
    figure.savefig(path, dpi=120)


if __name__ == "__main__":
    measure(Path(sys.argv[1]))
