"""A run: collect, train, evaluate, show. Each stage skips what is done and continues what was interrupted."""

from pathlib import Path
from typing import Any, Literal

from deepgps.config.scenario import Scenario
from deepgps.evaluation.measure_run import evaluate
from deepgps.methods.train import ask_for_device, make_judge, train
from deepgps.runs.collect import collect
from deepgps.runs.provenance import timed
from deepgps.runs.run_folder import claim
from deepgps.runs.source import link_recording
from deepgps.terminal.progress import Report
from sim.files.checksums import is_intact
from sim.recording.format import has_truth

Stage = Literal["collect", "train", "evaluate", "show"]


def run(
    scenario: Scenario, folder: Path, fresh: bool, progress: Report, recording: Path | None = None, last: Stage = "show"
) -> dict[str, Any] | None:
    """Run the stages of a scenario in a folder up to the last one, on a recording that exists already or on a drive.

    With ``fresh``, an existing run is replaced once the new one is complete. Returns the contents of ``metrics.json``,
    or, of a recording without truth, of ``without_truth.json``; None if the recording holds the truth, but no test
    observations to measure errors at, or if nothing is to be measured.
    """
    with claim(scenario, folder, fresh) as place:
        if recording is not None:
            link_recording(recording, place)
        if last != "collect":  # training may happen on another machine
            ask_for_device(scenario, place)
        collect(scenario, place, progress, make_judge(scenario, place, progress))
        if last == "collect":
            return None
        train(scenario, place, progress)
        if last == "train":
            return None
        metrics = evaluate(scenario, place, progress)
        if metrics is not None and last == "show":
            show(place, progress)
    return metrics


def show(folder: Path, progress: Report) -> None:
    """Draw the figures and write the Rerun recording."""
    from deepgps.reports.run_figures import draw_figures
    from deepgps.viewer.run import find_recording, write_run

    path = folder / "run.rrd"
    if is_intact(path):
        return
    if not has_truth(folder / "recording"):
        find_recording(folder)
    else:
        with timed(folder, "show"):
            progress("show", 0, 2)
            draw_figures(folder)
            progress("show", 1, 2)
            write_run(folder)
            progress("show", 2, 2)
