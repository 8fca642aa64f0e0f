"""The paper's own recipe against ours: how long it would take here, and its error after about the same time."""

from pathlib import Path

from deepgps.bench.rows import Row
from deepgps.config.scenario import Scenario
from deepgps.evaluation.evaluate import measure_part
from deepgps.methods.fit import fit_method
from deepgps.runs.run_folder import METRICS
from deepgps.terminal.progress import Report
from sim.files.json_files import read_json
from sim.recording.format import open_recording

EVERY = 4
"""One in this many test positions and training samples is evaluated, since a ResNet on a CPU takes minutes for all."""


def measure_paper(scenario: Scenario, demo: Path, steps: int, folder: Path, progress: Report) -> list[Row]:
    """Train the paper's recipe for a few steps on the demo's recording.

    Args:
        scenario: The recipe.
        demo: The demo's run folder.
        steps: Number of steps, to which the schedule is shortened.
        folder: Folder of the training.
        progress: Called with the steps done and their number.
    """
    train = scenario.learn.train.model_copy(update={"steps": steps, "snapshots": 2, "device": "cpu"})
    settings = scenario.learn.model_copy(update={"train": train})
    fit_method("deepgps", open_recording(demo / "recording"), settings, scenario.seed, folder / "deepgps", progress)
    took_s = read_json(folder / "deepgps" / "training.json")["train_s"]
    ours = read_json(demo / METRICS)["methods"]["deepgps"]
    found = measure_part(demo, folder / "deepgps", "deepgps", EVERY)
    whole = scenario.learn.train.steps
    schedule = f"{whole:,} steps of {1e3 * took_s / steps:.0f} ms; naive: what replaced it"
    after = f"{steps} steps, {took_s:.0f} s (ours: {ours['train_s']:.0f} s); naive: what replaced it"
    return [
        Row(
            "paper",
            "the paper's recipe, whole",
            took_s / steps * whole / 3600,
            "h",
            naive=ours["train_s"] / 3600,
            note=schedule,
        ),
        Row(
            "paper_rms",
            "... after about our time, RMS",
            100 * found["rms_m"],
            "cm",
            naive=100 * ours["rms_m"],
            note=after,
        ),
    ]
