"""A run's recording for the Rerun viewer, with a blueprint.

Entities: ``world`` (room, robot, path, error fields, the initial map's making, snapshots: all in the world's frame),
``drive`` (sensor data), ``encoders`` (encoder errors), ``making`` (words on the initial map), ``training`` (loss),
``place`` (pictures of the worst places) and ``report`` (text and plots). Without truth, as of a real robot, there are
only what was sensed, the dead-reckoned path and the maps, each in a frame of its own, below ``map``.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import rerun as rr

from deepgps.data.segments import dead_reckon, travel
from deepgps.diagnosis.store import FILE as DIAGNOSIS
from deepgps.evaluation.deployment import open_deployment
from deepgps.evaluation.error_field import ErrorField, read_all_headings
from deepgps.evaluation.map_errors import find_true_camera
from deepgps.evaluation.without_truth import read_judged
from deepgps.reports.plots import TICKS_M
from deepgps.reports.run_figures import read_histories
from deepgps.reports.run_report import OVERVIEW, describe, judge_run, markdown_report, markdown_table, read_metrics
from deepgps.reports.without_truth import markdown
from deepgps.runs.run_folder import METRICS, TRUTHLESS_METRICS, VIEWED
from deepgps.viewer.deployment import find_ways, log_deployment
from deepgps.viewer.drive import (
    LEG_COLOUR,
    ODOMETRY_COLOUR,
    find_pictures,
    log_diagnosis,
    log_drive,
    log_encoders,
    log_images,
    log_path,
    log_ticks,
)
from deepgps.viewer.error_field import SIGMA_TICKS_M, list_layers, log_coverage, log_field, log_layers
from deepgps.viewer.layout import FIGURES, make_blueprint, make_blueprint_without_truth
from deepgps.viewer.making import find_map, log_loss, log_making, log_points, log_snapshots, training_rows
from deepgps.viewer.pictures import LARGE_ENTITY, PICTURES, log_distribution, read_pictures
from deepgps.viewer.places import find_places, log_places
from deepgps.viewer.read import open_rrd
from deepgps.viewer.scene import log_room, log_scale
from deepgps.viewer.stream import drive_clock, find_span, hash_files, put_text, save_recording, send_series
from sim.files.checksums import is_intact
from sim.geometry import FreeSpace, limits
from sim.recording.format import has_truth, is_whole, open_recording, open_truth

READING_HINT = (
    "Point at an arrow or a dot: error (± radius of 68 %), heading → predicted x, y [m], and its place on the timeline "
    "`place`, where its image is, if it is shown in *Places*."
)
SLIDER_HINT = (
    "The slider has the seconds of the drive, and goes through places and training at the same time; choose the "
    "timeline `place` to step through the places, `deployment` or `step` for its seconds or training steps. Lines on "
    "plans are a metre apart."
)
LAYERS = (
    "The panel on the left (button at the top right) switches on and off: each heading, errors above and below 10 cm, "
    "refused ones, radii by place and ellipses (as in the tab Trust), predicted yaws (arrows of 7 cm; magenta if off "
    "by more than 5 degrees), floor not covered by images, images per cell of 0.25 m."
)
WITHOUT_TRUTH_NOTE = (
    "This recording has no ground truth, so there is no error field. *Drive* plays the sensor data and the "
    "dead-reckoned path; *Training* shows how each method's map unfolds, each in a frame of its own."
)


def write_run(run: Path) -> Path:
    """Write ``<run>/run.rrd``; return its path.

    Raises InputError if the folder is not a complete run. Equal runs give equal contents: the recording's id is a hash
    of the run, and no wall-clock time is written.
    """
    path = run / VIEWED
    if lacks_truth(run):
        return _write_without_truth(run, path)
    metrics, fields, histories = read_metrics(run), read_all_headings(run), read_histories(run)
    recording, truth = open_recording(run / "recording"), open_truth(run / "recording")
    space, driven = truth.free_space, truth.pose[:, :2]
    pictures = read_pictures(run)
    mapped, stored = find_map(run, fields)
    titles = ({LARGE_ENTITY: "Fisheye, drawn larger for people"} if pictures else {}) | find_pictures(recording)
    layers = {name: list_layers(name, field) for name, field in fields.items()}
    sure = next((name for name, field in fields.items() if field.radius is not None), None)
    places = find_places(run, fields, recording)
    drive, deployed = open_deployment(recording), None
    if drive is not None:
        method, ways = find_ways(run, drive)
        deployed = method, {name: way.title for name, way in ways.items()}
    span = find_span(recording)
    blueprint = make_blueprint(space, layers, list(histories), titles, span, mapped, sure, deployed)
    marks = {name: {} for name in fields}
    for number, place in enumerate(places):
        if place.field is fields[place.method]:
            marks[place.method].setdefault(place.cell, f", place {len(places) - number}")

    def log(stream: rr.RecordingStream) -> None:
        log_room(stream, recording.folder / "scene.glb", space)
        log_results(stream, metrics, fields, space, driven, [READING_HINT, SLIDER_HINT, LAYERS], marks)
        log_places(stream, places, recording, truth)
        if drive is not None:
            log_deployment(stream, method, ways, drive, span)
        log_drive(stream, recording, truth, pictures)
        log_encoders(stream, recording, truth)
        log_diagnosis(stream, run)
        if stored is not None:
            log_making(stream, stored, recording, find_true_camera(recording, truth))
        for name, history in histories.items():
            losses, snapshots = training_rows(history, span)
            log_loss(stream, name, history, losses)
            log_snapshots(stream, name, driven[history["snapshot_index"]], history["snapshot"], snapshots)
        log_distribution(stream, fields)

    save_recording(path, hash_run(run), f"{metrics['scenario']}, seed {metrics['seed']}", blueprint, log)
    return path


def find_recording(run: Path) -> Path:
    """Return a run's recording, written if it is missing or damaged; raise InputError if it cannot be read."""
    if not lacks_truth(run):
        read_metrics(run)
    path = run / VIEWED
    if not is_intact(path):
        return write_run(run)
    open_rrd(path)
    return path


def lacks_truth(run: Path) -> bool:
    """Whether a run's recording is finished and has no truth, so that there is no error field."""
    return is_whole(run / "recording") and not has_truth(run / "recording")


def log_results(
    stream: rr.RecordingStream,
    metrics: Mapping[str, Any],
    fields: Mapping[str, ErrorField],
    space: FreeSpace,
    driven: np.ndarray,
    notes: Sequence[str],
    marks: Mapping[str, Mapping[int, str]] = MappingProxyType({}),
) -> None:
    """Log a run's error fields with their layers and scale, its figures, how to read them, and the coverage of its
    floor by training images at true positions (N, 2) [m]; marks of places are by method, as ``log_field`` has them."""
    for path, ticks in (("world/scale", TICKS_M), ("world/radius_scale", SIGMA_TICKS_M)):
        log_scale(stream, path, *limits(space), ticks)
    for name, field in fields.items():
        log_field(stream, name, field, marks=marks.get(name, {}))
        log_layers(stream, name, field)
    log_coverage(stream, driven, space)
    lines = [
        f"# {metrics['scenario']}, seed {metrics['seed']}",
        "",
        markdown_table(metrics, OVERVIEW),
        "",
        *(f"- **{sentence}**" for sentence in judge_run(metrics)),
        *(f"- {sentence}" for sentence in describe(metrics)),
        "",
        "Each arrow points from a true test position to the predicted position, for the worst heading there that the "
        "method accepts; grey ones are the worst that it refuses. All methods share one colour scale.",
        "",
        *(f"- {sentence}" for sentence in notes),
    ]
    put_text(stream, FIGURES, "\n".join(lines))
    put_text(stream, "report/text", markdown_report(metrics))


def hash_run(run: Path) -> str:
    """Thirty-two hexadecimal digits of a run's metrics, error fields, recording, pictures and diagnosis."""
    extra = [path for name in (PICTURES, DIAGNOSIS, "use_field.npz") if (path := run / name).is_file()]
    extra += sorted(run.glob("tracking/*.npz"))
    return hash_files(run, [*(run / name for name in (METRICS, "error_field.npz", "recording/manifest.json")), *extra])


def _write_without_truth(run: Path, path: Path) -> Path:
    recording, histories = open_recording(run / "recording"), read_histories(run)
    reckoned = dead_reckon(recording)[:, :2]

    def log(stream: rr.RecordingStream) -> None:
        segment = recording.reading[:, 0]
        log_path(stream, "world/reckoned", segment, reckoned, (ODOMETRY_COLOUR, LEG_COLOUR), recording.time)
        distance = travel(recording.reading[:, 2:], recording.manifest.odometry).mean(axis=1)
        send_series(
            stream, "drive/distance/encoder", drive_clock(recording.time), distance, "by encoder", ODOMETRY_COLOUR
        )
        log_ticks(stream, recording)
        log_images(stream, recording)
        for name, history in histories.items():
            losses, snapshots = training_rows(history, find_span(recording))
            log_loss(stream, name, history, losses)
            points = history["snapshot"].astype(float)
            log_points(stream, f"map/{name}", points[-1], points, snapshots)
        log_diagnosis(stream, run)
        known = markdown(run) if read_judged(run) else ""
        put_text(stream, "report", f"{WITHOUT_TRUTH_NOTE}\n\n{known}")

    last = {name: history["snapshot"][-1] for name, history in histories.items()}
    others = [*sorted(run.glob("*/history.npz")), *run.glob(DIAGNOSIS), *run.glob(TRUTHLESS_METRICS)]
    blueprint = make_blueprint_without_truth(find_pictures(recording), find_span(recording), reckoned, last)
    number = hash_files(run, [run / "recording" / "manifest.json", *others])
    save_recording(path, number, f"{run.name}, without truth", blueprint, log)
    return path
