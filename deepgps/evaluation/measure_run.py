"""The third stage of a run: measure its methods against the truth, or judge them without it."""

import logging
from pathlib import Path
from typing import Any

from deepgps.config.scenario import Scenario
from deepgps.evaluation.stored_alignment import has_alignment
from deepgps.runs.provenance import describe_environment, stage_times, timed
from deepgps.runs.run_folder import METRICS, TRUTHLESS_METRICS, drop_viewed
from deepgps.terminal.progress import Report
from sim.errors import DamagedError
from sim.files.checksums import read_arrays, read_json, write_json
from sim.recording.format import has_truth, open_recording

log = logging.getLogger(__name__)
NO_TESTS = "all methods are trained; errors cannot be measured, since the recording holds no test observations"


def evaluate(scenario: Scenario, folder: Path, progress: Report) -> dict[str, Any] | None:
    """Measure all methods; write ``metrics.json``, ``error_field.npz`` and each method's alignment.

    On a recording without truth, ``without_truth.json`` is written in their place. Returns the file's contents; None if
    the recording holds the truth, but no test observations to measure errors at.
    """
    metrics = read_measured(folder)
    if metrics and set(scenario.methods) <= {name for name in metrics["methods"] if has_alignment(folder / name)}:
        return metrics
    from deepgps.evaluation import evaluate, without_truth
    from deepgps.learning.trainer import use_threads

    if has_truth(folder / "recording"):
        if not open_recording(folder / "recording").test_observation.size:
            return None
        path, measure = folder / METRICS, evaluate.evaluate
    else:
        judged = without_truth.read_judged(folder)
        if judged and set(scenario.methods) <= set(judged["methods"]):
            return judged
        path, measure = folder / TRUTHLESS_METRICS, without_truth.judge
    with timed(folder, "evaluate"), use_threads(scenario.learn.train.threads):
        measured = measure(folder, scenario, progress)
    drop_viewed(folder)
    if path.name == METRICS:
        head = {"scenario": scenario.title, "seed": scenario.seed}
        made_with = describe_environment(folder, measured["methods"].values())
        times = {name: seconds for name, seconds in stage_times(folder).items() if name != "show"}
        measured = {**head, **measured, "timing_s": times, "environment": made_with}
    write_json(path, measured)
    return read_json(path)


def read_measured(folder: Path) -> dict[str, Any] | None:
    """The contents of a run's ``metrics.json``; None if that file or an error field is missing or damaged."""
    if not (folder / METRICS).is_file():
        return None
    try:
        metrics = read_json(folder / METRICS)
        for field, measured in (("error", True), ("label", "labels" in metrics), ("use", "in_use" in metrics)):
            if measured:
                read_arrays(folder / f"{field}_field.npz")
    except DamagedError as error:
        log.warning("%s; the methods are measured again", error)
        return None
    return metrics
