"""A run's recording for the Rerun viewer, with a blueprint.

Entities: ``world`` (room, robot, path, error fields, snapshots: all in the world's frame), ``drive`` (sensor data),
``encoders`` (encoder errors), ``training`` (loss) and ``report`` (text and figures).
"""

from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

import rerun as rr

from deepgps.data.plausible_readings import keep_plausible
from deepgps.evaluation.error_field import WorstField
from deepgps.figures import field_plot, run_figures, style
from deepgps.figures.run_report import OVERVIEW, describe, markdown_report, markdown_table, read_metrics
from deepgps.viewer.read import open_rrd
from deepgps.viewer.run.drive import find_pictures, log_drive
from deepgps.viewer.run.encoders import log_encoders
from deepgps.viewer.run.layout import make_blueprint
from deepgps.viewer.run.training import Data, log_training
from deepgps.viewer.run.without_truth import write_without_truth
from deepgps.viewer.save import hash_files, save_recording
from deepgps.viewer.scene import log_field, log_room, log_scale
from sim.files import is_intact
from sim.occupancy import FreeSpace
from sim.recording.format import has_truth, is_whole, open_recording, open_truth

RECORDING = "run.rrd"


def write_recording(run: Path) -> Path:
    """Write ``<run>/run.rrd``; raise InputError if the folder is not a complete run.

    Equal runs give equal contents: the recording's id is a hash of the run, and no wall-clock time is written.
    """
    if _lacks_truth(run):
        return write_without_truth(run, run / RECORDING)
    metrics, fields, histories = read_metrics(run), field_plot.read_fields(run), run_figures.read_histories(run)
    recording, truth = keep_plausible(open_recording(run / "recording")), open_truth(run / "recording")
    drive_s = float(recording.time[-1] - recording.time[0])
    blueprint = make_blueprint(truth.free_space, list(fields), list(histories), find_pictures(recording), drive_s)

    def log(stream: rr.RecordingStream) -> None:
        log_room(stream, recording.folder / "scene.glb", truth.free_space)
        log_scale(stream, truth.free_space)
        for name, field in fields.items():
            log_field(stream, name, field)
        log_drive(stream, recording, truth)
        log_encoders(stream, recording, truth)
        for name, history in histories.items():
            log_training(stream, name, history, truth.pose[:, :2])
        _log_report(stream, metrics, fields, histories, truth.free_space)

    path = run / RECORDING
    save_recording(path, hash_run(run), f"{metrics['scenario']}, seed {metrics['seed']}", blueprint, log)
    return path


def find_recording(run: Path) -> Path:
    """Return a run's recording, written if it is missing or damaged; raise InputError if it cannot be read."""
    if not _lacks_truth(run):
        read_metrics(run)
    path = run / RECORDING
    if not is_intact(path):
        return write_recording(run)
    open_rrd(path)
    return path


def _lacks_truth(run: Path) -> bool:
    return is_whole(run / "recording") and not has_truth(run / "recording")


def _log_report(
    stream: rr.RecordingStream,
    metrics: Mapping[str, Any],
    fields: Mapping[str, WorstField],
    histories: Mapping[str, Data],
    space: FreeSpace,
) -> None:
    summary = "\n".join(
        [
            f"# {metrics['scenario']}, seed {metrics['seed']}",
            "",
            markdown_table(metrics, OVERVIEW),
            "",
            *(f"- {sentence}" for sentence in describe(metrics)),
            "",
            "Each arrow points from a true test position to the predicted position, for the worst heading there. All "
            "methods share one colour scale.",
            "",
            "The slider below runs through the drive and the training at the same time; choose the timeline "
            "`drive_time` or `step` to move in seconds or in training steps.",
        ]
    )
    for name, text in {"figures": summary, "text": markdown_report(metrics)}.items():
        stream.log(f"report/{name}", rr.TextDocument(text, media_type="text/markdown"), static=True)
    pictures = {
        "error_fields": run_figures.draw_comparison(space, fields, metrics),
        "error_cdf": run_figures.draw_error_cdf(fields),
    }
    if histories:
        pictures["training"] = run_figures.draw_training(histories)
    for name, figure in pictures.items():
        image = rr.EncodedImage(contents=BytesIO(style.to_png(figure)), media_type="image/png")
        stream.log(f"report/{name}", image, static=True)


def hash_run(run: Path) -> str:
    """Thirty-two hexadecimal digits of a run's metrics, error fields and recording."""
    return hash_files(run, [run / "metrics.json", run / "error_field.npz", run / "recording" / "manifest.json"])
