"""A run's recording for the Rerun viewer, with a blueprint.

Entities: ``world`` (room, robot, path, error fields, the initial map's making, snapshots: all in the world's frame),
``drive`` (sensor data), ``encoders`` (encoder errors), ``making`` (words on the initial map), ``training`` (loss),
``place`` (pictures of the worst places) and ``report`` (text and plots). Without truth, as of a real robot, there are
only what was sensed, the robot on its dead-reckoned path and the maps, each in a frame of its own.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import rerun as rr
import rerun.blueprint as rrb

from deepgps.data.segments import dead_reckon
from deepgps.diagnosis.store import FILE as DIAGNOSIS
from deepgps.evaluation.deployment import open_deployment
from deepgps.evaluation.error_field import ErrorField, read_all_headings
from deepgps.evaluation.map_errors import find_true_camera
from deepgps.evaluation.without_truth import read_judged
from deepgps.reports.run_figures import draw_error_cdf, read_histories
from deepgps.reports.run_report import (
    COLUMNS_NOTE,
    OVERVIEW,
    describe,
    judge_run,
    markdown_report,
    markdown_table,
    read_metrics,
)
from deepgps.reports.without_truth import markdown
from deepgps.runs.run_folder import METRICS, TRUTHLESS_METRICS, VIEWED
from deepgps.viewer import layout
from deepgps.viewer.deployment import find_ways, log_deployment
from deepgps.viewer.drive import find_pictures, log_diagnosis, log_drive, log_encoders
from deepgps.viewer.error_field import RADIUS_TICKS_M, log_field, log_trust
from deepgps.viewer.making import find_map, log_making, log_training
from deepgps.viewer.pictures import log_figure
from deepgps.viewer.places import find_places, log_places
from deepgps.viewer.scene import log_room, log_scale
from deepgps.viewer.stream import DRIVE_TIME, Span, find_span, hash_files, open_rrd, put_text, save_recording
from sim.files.checksums import is_intact
from sim.geometry import FreeSpace, limits
from sim.recording.format import has_truth, is_whole, open_recording, open_truth

PLAYED_S = 100.0  # In which the viewer plays a drive
READING_HINT = (
    "Point at an arrow or a dot: error (± radius of 68 %), heading → predicted x, y [m], and its place on the timeline "
    "`place`, where its image is, if it is shown in *Places*."
)
SLIDER_HINT = (
    "The slider has the seconds of the drive: play it, or press End. Choose the timeline `place` at the bottom to step "
    "through the worst places, `making`, `step` or `deployment` for the initial map, the training, the deployment."
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
    space, floor, span = truth.free_space, limits(truth.free_space), find_span(recording)
    stored = find_map(run, fields)
    sure = next((name for name, field in fields.items() if field.radius is not None), None)
    places = find_places(run, fields, recording)
    marks = {name: {} for name in fields}
    for number, place in enumerate(places, 1):
        marks[place.method].setdefault(place.at[0], f", place {number}")
    drive, is_polar = open_deployment(recording), recording.kind == "polar_image"
    errors = rrb.Horizontal(layout.segment_error_view(), layout.ticks_view())
    tabs = [
        layout.error_fields(floor, list(fields), ["place/test", "place/label"]),
        layout.places(floor, is_polar),
        *([layout.trust(floor, sure)] if sure else []),
        layout.drive(floor, find_pictures(recording), errors),
        *([layout.making(floor)] if stored else []),
        *([layout.training(dict.fromkeys(histories, floor), True)] if histories else []),
        layout.encoders(floor),
        layout.report(),
    ]
    if drive is not None:
        method, ways = find_ways(run, drive)
        titles = {name: way.title for name, way in ways.items()}
        tabs.insert(2, layout.deployment(floor, method, titles, is_polar))

    def log(stream: rr.RecordingStream) -> None:
        log_room(stream, recording.folder / "scene.glb", space)
        log_results(stream, metrics, fields, space, [READING_HINT, SLIDER_HINT], marks)
        log_places(stream, places, recording, truth)
        if sure:
            log_scale(stream, "world/radius_scale", *floor, RADIUS_TICKS_M)
            log_trust(stream, sure, fields[sure])
        if drive is not None:
            log_deployment(stream, method, ways, drive, span)
        log_drive(stream, recording, truth.pose[recording.reading[:, 1]])
        log_encoders(stream, recording, truth)
        log_diagnosis(stream, run)
        if stored is not None:
            log_making(stream, stored, recording, find_true_camera(recording, truth))
        for name, history in histories.items():
            log_training(stream, name, history, span, truth.pose[:, :2])
        log_figure(stream, layout.DISTRIBUTION, draw_error_cdf(fields))

    title = f"{metrics['scenario']}, seed {metrics['seed']}"
    save_recording(path, hash_run(run), title, layout.arrange(tabs, _play(span)), log)
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
    notes: Sequence[str] = (),
    marks: Mapping[str, Mapping[int, str]] = MappingProxyType({}),
) -> None:
    """Log a run's error fields with their scale, its figures, and how to read them; marks of places are by method, as
    ``log_field`` has them."""
    log_scale(stream, "world/scale", *limits(space))
    for name, field in fields.items():
        log_field(stream, name, field, marks=marks.get(name, {}))
    lines = [
        f"# {metrics['scenario']}, seed {metrics['seed']}",
        "",
        markdown_table(metrics, OVERVIEW),
        "",
        *(f"- **{sentence}**" for sentence in judge_run(metrics)),
        *(f"- {sentence}" for sentence in (COLUMNS_NOTE, *describe(metrics))),
        "",
        "Each arrow points from a true test position to the predicted position, for the worst heading there that the "
        "method accepts; grey ones are the worst that it refuses. All methods share one colour scale.",
        "",
        *(f"- {sentence}" for sentence in notes),
    ]
    put_text(stream, layout.FIGURES, "\n".join(lines))
    put_text(stream, layout.REPORT, markdown_report(metrics))


def hash_run(run: Path) -> str:
    """Thirty-two hexadecimal digits of a run's metrics, error fields, recording and diagnosis."""
    extra = [path for name in (DIAGNOSIS, "use_field.npz") if (path := run / name).is_file()]
    extra += sorted(run.glob("tracking/*.npz"))
    return hash_files(run, [*(run / name for name in (METRICS, "error_field.npz", "recording/manifest.json")), *extra])


def _write_without_truth(run: Path, path: Path) -> Path:
    recording, histories = open_recording(run / "recording"), read_histories(run)
    pose, span = dead_reckon(recording), find_span(recording)
    last = {name: history["snapshot"][-1] for name, history in histories.items()}
    floors = {name: (points.min(axis=0), points.max(axis=0)) for name, points in last.items()}
    way = pose[:, :2].min(axis=0), pose[:, :2].max(axis=0)
    tabs = [
        layout.drive(way, find_pictures(recording), layout.ticks_view(), has_room=False),
        *([layout.training(floors, False)] if floors else []),
        layout.wheels_view(),
        layout.text_view("Without truth", layout.REPORT),
    ]

    def log(stream: rr.RecordingStream) -> None:
        log_drive(stream, recording, pose)
        for name, history in histories.items():
            log_training(stream, name, history, span, None)
        log_diagnosis(stream, run)
        known = markdown(run) if read_judged(run) else ""
        put_text(stream, layout.REPORT, f"{WITHOUT_TRUTH_NOTE}\n\n{known}")

    others = [*sorted(run.glob("*/history.npz")), *run.glob(DIAGNOSIS), *run.glob(TRUTHLESS_METRICS)]
    number = hash_files(run, [run / "recording" / "manifest.json", *others])
    save_recording(path, number, f"{run.name}, without truth", layout.arrange(tabs, _play(span)), log)
    return path


def _play(span: Span) -> rrb.TimePanel:
    return layout.pause(DRIVE_TIME, (span[1] - span[0]) / PLAYED_S)
