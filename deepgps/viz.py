"""A run in the Rerun viewer: its recording, with a blueprint, and reading it back. Only this file imports rerun.

Entities: ``world`` (room, robot, path, error fields, snapshots: all in the world's frame), ``drive`` (what was
sensed), ``training`` (loss) and ``report`` (text and figures). Timelines: ``drive_time`` [s], ``step`` of training,
and ``progress``, which runs through drive and training together from 0 to ``PROGRESS_END``.
"""

import hashlib
import os
import shutil
import subprocess
import sys
from collections.abc import Iterable, Mapping, Sequence
from datetime import timedelta
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from matplotlib.colors import to_rgb
from rerun.chunk import RrdReader

from deepgps import figures, playback
from deepgps.alignment import fit_alignment
from deepgps.figures import WorstField, colours_of
from deepgps.report import OVERVIEW, describe, markdown_report, markdown_table, method_title, read_metrics
from sim.errors import InputError, WorkError
from sim.files import write_atomic
from sim.records import FreeSpace, Recording, Truth, open_recording, open_truth, sha256
from sim.settings import CameraSettings

APPLICATION = "deepgps"
RECORDING = "recording.rrd"
DRIVE_TIME, STEP, PROGRESS = "drive_time", "step", "progress"
PROGRESS_END = 10_000
IMAGES_AT_MOST = 4_000  # more pictures than anyone plays; keeps a long drive's file small
ROUND_PX = 144
LAYER_M = 0.01  # height of one drawn layer above the next
ROBOT = "world/drive/robot"
FIELDS = "/world/error_field/"
CAMERAS = {
    "fisheye": "Fisheye, forward is up",
    "polar": "Polar image, zenith at the top",
    "horizontal": "Horizontal camera",
}

Data = Mapping[str, np.ndarray]


def write_recording(run: Path) -> Path:
    """Write ``<run>/recording.rrd``; raises InputError where the folder is no whole run.

    Equal runs give equal contents: the recording's id is a hash of the run, and no wall-clock time is written.
    """
    metrics, fields, histories = read_metrics(run), figures.read_fields(run), figures.read_histories(run)
    recording, truth = open_recording(run / "recording"), open_truth(run / "recording")
    blueprint = make_blueprint(truth.free_space, list(fields), list(histories), find_cameras(recording))

    def write(part: Path) -> None:
        # Chunks end by size and never by the clock, so that a busy machine cuts equal runs in equal pieces.
        by_size = rr.ChunkBatcherConfig(flush_tick=timedelta(days=1))
        stream = rr.RecordingStream(APPLICATION, recording_id=_hash(run), send_properties=False, batcher_config=by_size)
        with stream:
            stream.save(part, default_blueprint=blueprint)
            stream.send_recording_name(f"{metrics['scenario']}, seed {metrics['seed']}")
            _log_room(stream, recording.folder / "scene.glb", truth.free_space)
            _log_scale(stream, truth.free_space)
            for name, field in fields.items():
                _log_field(stream, name, field)
            _log_drive(stream, recording, truth)
            for name, history in histories.items():
                _log_training(stream, name, history, truth.pose[:, :2])
            _log_report(stream, metrics, fields, histories, truth.free_space)
            stream.flush()
            stream.disconnect()

    path = run / RECORDING
    write_atomic(path, write)
    return path


def view(paths: Sequence[Path]) -> None:
    """Open runs in the Rerun viewer and wait until it is closed.

    Args:
        paths: Run folders; a run without a recording gets one first.

    Raises:
        InputError: A folder is no run, or its recording is cut off.
        WorkError: The viewer is missing or cannot open a window.
    """
    recordings = [find_recording(path) for path in paths]
    # the viewer also listens for data; only this machine may send it any
    command = [find_viewer(), "--bind", "127.0.0.1", *map(str, recordings)]
    ended = subprocess.run(command, check=False, stderr=subprocess.PIPE, text=True)
    if ended.returncode != 0:
        lines = [line for line in ended.stderr.splitlines() if line.strip()] or ["no reason given"]
        raise WorkError(
            f"the Rerun viewer ended with {ended.returncode} ({lines[-1]}); without a display, copy "
            f"{recordings[0]} to a machine that has one, or: rerun --serve-web --bind 127.0.0.1 {recordings[0]}"
        )


def find_viewer() -> str:
    """Path of the viewer that came with rerun-sdk, whether or not its environment is active; raises WorkError."""
    places = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    viewer = shutil.which("rerun", path=places)
    if viewer is None:
        raise WorkError("the Rerun viewer is missing: there is no command rerun; pip install rerun-sdk brings it")
    return viewer


def find_recording(run: Path) -> Path:
    """A run's recording, written if it is missing and checked to be whole; raises InputError."""
    read_metrics(run)
    path = run / RECORDING
    if not path.is_file():
        return write_recording(run)
    open_rrd(path)
    return path


def open_rrd(path: Path) -> RrdReader:
    """Open a recording; raises InputError where it is missing, cut off or something else."""
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    try:
        reader = RrdReader(path)
        reader.store().schema()  # needs the footer, which a cut-off file lacks
    except Exception as error:  # rerun raises ValueError, RuntimeError and its own kinds
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"{path} is cut off or no recording ({reason}); delete it and view the run again") from None
    return reader


def read_error_field(path: Path, method: str) -> WorstField:
    """Read a method's error field back from a recording.

    Args:
        path: A ``.rrd`` file.
        method: Its name, as in metrics.json.

    Raises:
        InputError: The file is broken, or has no such method; the names it has are told.
    """
    columns: dict[str, np.ndarray] = {}
    methods: set[str] = set()
    for chunk in open_rrd(path).stream():
        if chunk.entity_path.startswith(FIELDS):
            methods.add(chunk.entity_path.removeprefix(FIELDS).split("/")[0])
        if chunk.entity_path == FIELDS + method:
            batch = chunk.to_record_batch()
            for name in {"Arrows3D:origins", "Arrows3D:vectors"} & set(batch.schema.names):
                flat = batch.column(name).flatten().flatten().to_numpy()
                columns[name] = flat.reshape(-1, 3)[:, :2].astype(float)
    if method not in methods:
        raise InputError(f"{path} has no method {method!r}; it has {', '.join(sorted(methods)) or 'none'}")
    truth, error = columns["Arrows3D:origins"], columns["Arrows3D:vectors"]
    return WorstField(truth, truth + error, np.linalg.norm(error, axis=1))


def find_cameras(recording: Recording) -> list[str]:
    """Names of the pictures that a recording has: none of scans and of distances to landmarks."""
    images = ["fisheye", "polar"] if recording.observation.ndim == 4 else []
    return [*images, *(["horizontal"] if recording.horizontal is not None else [])]


def make_blueprint(
    space: FreeSpace,
    methods: Sequence[str],
    trained: Sequence[str],
    cameras: Sequence[str] = ("fisheye", "polar"),
    tab: int = 0,
) -> rrb.Blueprint:
    """How the viewer shows a run, with what its cameras saw: what matters first, without a click."""
    return rrb.Blueprint(
        rrb.Tabs(
            _overview(space, methods[0]),
            _error_fields(space, methods),
            _drive(space, cameras),
            *([_training(space, trained)] if trained else []),
            _report(),
            active_tab=tab,
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=PROGRESS, fps=PROGRESS_END / 100, play_state="paused"),
        auto_views=False,
    )


def _overview(space: FreeSpace, method: str) -> rrb.Horizontal:
    return rrb.Horizontal(
        rrb.Spatial3DView(
            name=f"Error field of {method_title(method)}",
            origin="world",
            contents=["world/room", "world/floor_plan", "world/scale/**", f"world/error_field/{method}/**"],
            eye_controls=_eye(space, tilt=0.45, reach=1.08),
            line_grid=False,
        ),
        rrb.TextDocumentView(name="Figures", origin="report/figures"),
        column_shares=[5, 2],
        name="Overview",
    )


def _error_fields(space: FreeSpace, methods: Sequence[str]) -> rrb.Grid:
    return rrb.Grid(
        *(
            rrb.Spatial3DView(
                name=method_title(method),
                origin="world",
                contents=["world/floor_plan", "world/scale/**", f"world/error_field/{method}/**"],
                eye_controls=_eye(space),
                line_grid=False,
            )
            for method in methods
        ),
        grid_columns=2,
        name="Error field",
    )


def _drive(space: FreeSpace, cameras: Sequence[str]) -> rrb.Horizontal:
    relative, infinite = rr.TimeRangeBoundary.cursor_relative, rr.TimeRangeBoundary.infinite
    recent = [
        rr.VisibleTimeRange(DRIVE_TIME, start=relative(seconds=-60), end=relative(seconds=0)),
        rr.VisibleTimeRange(PROGRESS, start=relative(seq=-PROGRESS_END // 50), end=relative(seq=0)),
    ]
    so_far = [
        rr.VisibleTimeRange(DRIVE_TIME, start=infinite(), end=relative(seconds=0)),
        rr.VisibleTimeRange(PROGRESS, start=infinite(), end=relative(seq=0)),
    ]
    room = rrb.Spatial3DView(
        name="Robot and path so far",
        origin="world",
        contents=["world/room", "world/drive/**"],
        eye_controls=_eye(space, tilt=0.45, reach=1.3),
        line_grid=False,
        overrides={"world/drive/path": rrb.VisibleTimeRanges(so_far)},
    )
    pictures = rrb.Horizontal(
        *(rrb.Spatial2DView(name=CAMERAS[camera], origin=f"drive/{camera}") for camera in cameras),
        column_shares=[1 if camera == "fisheye" else 2 for camera in cameras],
    )
    return rrb.Horizontal(
        room,
        rrb.Vertical(
            *([pictures] if cameras else []),
            rrb.TimeSeriesView(name="Distance on this segment [m]", origin="drive/distance", time_ranges=recent),
            rrb.TimeSeriesView(
                name="Encoder minus truth, all the way [mm]", origin="drive/difference", axis_x=_whole_axis()
            ),
            rrb.TimeSeriesView(name="Ticks", origin="drive/ticks", time_ranges=recent),
            row_shares=[3, 2, 2, 2] if cameras else [1, 1, 1],
        ),
        column_shares=[5, 4],
        name="Drive",
    )


def _training(space: FreeSpace, trained: Sequence[str]) -> rrb.Vertical:
    return rrb.Vertical(
        rrb.Horizontal(
            *(
                rrb.Spatial3DView(
                    name=f"{method_title(name)}: where it puts the training images",
                    origin="world",
                    contents=["world/outline", f"world/training/{name}"],
                    eye_controls=_eye(space),
                    line_grid=False,
                )
                for name in trained
            )
        ),
        rrb.Horizontal(
            *(
                rrb.TimeSeriesView(
                    name=f"{method_title(name)}: loss, log10", origin=f"training/{name}", axis_x=_whole_axis()
                )
                for name in trained
            )
        ),
        row_shares=[3, 2],
        name="Training",
    )


def _report() -> rrb.Horizontal:
    return rrb.Horizontal(
        rrb.TextDocumentView(name="Report", origin="report/text"),
        rrb.Tabs(
            rrb.Spatial2DView(name="Error fields", origin="report/error_fields"),
            rrb.Spatial2DView(name="Error distribution", origin="report/error_cdf"),
            rrb.Spatial2DView(name="Training", origin="report/training"),
        ),
        column_shares=[2, 3],
        name="Report",
    )


def _whole_axis() -> rrb.TimeAxis:
    """A time axis that shows a series from its first to its last value."""
    infinite = rr.TimeRangeBoundary.infinite
    return rrb.TimeAxis(view_range=rr.TimeRange(start=infinite(), end=infinite()))


def _eye(space: FreeSpace, tilt: float = 0.0, reach: float = 1.0) -> rrb.EyeControls3D:
    """An eye above the room, tilted towards the south by ``tilt`` [rad], ``reach`` times as far as for a plan."""
    low, high = figures.limits(space)
    middle = np.array([*(low + high) / 2, 0.0]) - [0, 0.25, 0]  # the scale lies before the room
    distance = reach * (1.2 * max(high[1] - low[1], 0.62 * (high[0] - low[0])) + 0.8)
    away = distance * np.array([0.0, -np.sin(tilt), np.cos(tilt)])
    # an eye exactly above has no up direction of its own: north is up
    return rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital, position=middle + away, look_target=middle, eye_up=(0.0, 1.0, 0.0)
    )


def _log_room(stream: rr.RecordingStream, scene: Path, space: FreeSpace) -> None:
    stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    if scene.is_file():  # a plane world has no walls to see
        room = rr.Asset3D(contents=playback.open_room(scene, space), media_type="model/gltf-binary")
        stream.log("world/room", room, static=True)
    plan, corner = playback.draw_floor_plan(space)
    stream.log(
        "world/floor_plan",
        rr.GridMap(
            data=plan[::-1].tobytes(),  # Rerun wants the northern row first
            format=rr.components.ImageFormat(
                width=plan.shape[1], height=plan.shape[0], color_model="RGB", channel_datatype="U8"
            ),
            cell_size=space.cell_m,
            translation=[*corner, LAYER_M / 2],
        ),
        static=True,
    )
    strips = [_lift(line, 0.0) for line in playback.find_outline(space)]
    stream.log("world/outline", rr.LineStrips3D(strips, radii=0.008, colors=[120, 130, 150]), static=True)


def _log_scale(stream: rr.RecordingStream, space: FreeSpace) -> None:
    """The colour scale as a strip on the floor before the room."""
    low, high = figures.limits(space)
    width = 0.9 * (high[0] - low[0])
    left, bottom = (low[0] + high[0] - width) / 2, low[1] - 0.35
    share = np.linspace(0, 1, 65)
    ends = np.stack([left + share * width, np.full(65, bottom)], axis=1)
    vertices = np.concatenate([_lift(ends, 0.0), _lift(ends + [0, 0.12], 0.0)])
    first = np.arange(64)
    triangles = np.concatenate(
        [np.stack([first, first + 1, first + 66], axis=1), np.stack([first, first + 66, first + 65], axis=1)]
    )
    decades = np.log(figures.SCALE_M[1] / figures.SCALE_M[0])
    colours = colours_of(figures.SCALE_M[0] * np.exp(share * decades))
    mesh = rr.Mesh3D(vertex_positions=vertices, triangle_indices=triangles, vertex_colors=np.tile(colours, (2, 1)))
    stream.log("world/scale", mesh, static=True)
    ticks = np.array(figures.TICKS_M)
    place = left + np.log(ticks / figures.SCALE_M[0]) / decades * width
    labels = [f"{100 * tick:g} cm" if tick < 1 else f"{tick:g} m" for tick in ticks]
    points = _lift(np.stack([place, np.full(len(ticks), bottom - 0.08)], axis=1), 0.0)
    stream.log(
        "world/scale/ticks",
        rr.Points3D(points, radii=0.015, colors=colours_of(ticks), labels=labels, show_labels=True),
        static=True,
    )


def _log_field(stream: rr.RecordingStream, name: str, field: WorstField) -> None:
    """Arrows from truth to prediction, and a dot at each truth, coloured by magnitude."""
    path, colours = f"world/error_field/{name}", colours_of(field.error)
    arrows = rr.Arrows3D(
        origins=_lift(field.truth, LAYER_M),
        vectors=_lift(field.predicted - field.truth, 0.0),
        colors=colours,
        radii=0.007,
    )
    stream.log(path, arrows, static=True)
    dots = rr.Points3D(_lift(field.truth, LAYER_M), radii=0.018, colors=colours, point_shading="Flat")
    stream.log(f"{path}/places", dots, static=True)


def _log_drive(stream: rr.RecordingStream, recording: Recording, truth: Truth) -> None:
    height_m = _camera(recording).height_m
    _log_robot(stream, float(recording.manifest["odometry"]["track_m"]), height_m)
    segment, observation = recording.reading[:, 0], recording.reading[:, 1]
    place = _lift(truth.pose[observation, :2], LAYER_M)
    indexes = _drive_index(recording.time, recording)
    seen, first = np.unique(observation, return_index=True)
    stream.send_columns(
        ROBOT,
        _drive_index(recording.time[first], recording),
        rr.Transform3D.columns(
            translation=_lift(truth.pose[seen, :2], 0.0), quaternion=_quaternions(truth.pose[seen, 2])
        ),
    )
    start = playback.find_starts(segment)
    end = np.flatnonzero(np.r_[start[1:] != start[:-1], True])
    stream.log("world/drive/path", rr.LineStrips3D.from_fields(radii=0.006, colors=[90, 160, 255, 150]), static=True)
    stream.send_columns(
        "world/drive/path",
        _drive_index(recording.time[end], recording),
        rr.LineStrips3D.columns(strips=np.stack([place[start[end]], place[end]], axis=1)),
    )
    stream.log("world/drive/leg", rr.LineStrips3D.from_fields(radii=0.012, colors=[255, 196, 60]), static=True)
    stream.send_columns(
        "world/drive/leg", indexes, rr.LineStrips3D.columns(strips=np.stack([place[start], place], axis=1))
    )
    _log_distances(stream, recording, truth)
    if recording.observation.ndim == 4:
        _log_images(stream, recording, seen, recording.time[first])
    elif recording.observation.ndim == 3:
        _log_scans(stream, recording, seen, recording.time[first])


def _log_robot(stream: rr.RecordingStream, track_m: float, height_m: float) -> None:
    body_m = 0.14
    stream.log(
        f"{ROBOT}/body",
        rr.Cylinders3D(
            lengths=[body_m, height_m - body_m],
            radii=[0.65 * track_m, 0.012],
            centers=[(0, 0, body_m / 2), (0, 0, (height_m + body_m) / 2)],
            colors=[(60, 66, 80), (180, 184, 190)],
            fill_mode=rr.components.FillMode.Solid,
        ),
        rr.Arrows3D(origins=[(0, 0, body_m + 0.01)], vectors=[(0.25, 0, 0)], colors=[255, 196, 60], radii=0.015),
        static=True,
    )
    stream.log(f"{ROBOT}/lens", rr.Points3D([(0, 0, height_m)], radii=0.03, colors=[232, 37, 79]), static=True)


def _log_distances(stream: rr.RecordingStream, recording: Recording, truth: Truth) -> None:
    encoder, true, difference = playback.measure_distances(recording, truth.pose)
    ticks = recording.reading[:, 2:]
    series = {
        "drive/distance/encoder": (encoder, "by encoder", (255, 150, 40)),
        "drive/distance/truth": (true, "true", (90, 160, 255)),
        "drive/difference": (1000 * difference, "encoder minus truth", (232, 37, 79)),
        "drive/ticks/left": (ticks[:, 0], "left", (90, 160, 255)),
        "drive/ticks/right": (ticks[:, 1], "right", (63, 208, 165)),
    }
    indexes = _drive_index(recording.time, recording)
    for path, (values, label, colour) in series.items():
        _send_series(stream, path, indexes, values, label, colour)


def _log_images(stream: rr.RecordingStream, recording: Recording, seen: np.ndarray, time: np.ndarray) -> None:
    step = -(-len(seen) // IMAGES_AT_MOST)
    seen, indexes = seen[::step], _drive_index(time[::step], recording)
    _, rings, sectors, _ = recording.observation.shape
    warp = playback.make_warp(_camera(recording), rings, sectors, ROUND_PX)
    polar = (np.asarray(recording.observation[observation]) for observation in seen)
    pairs = [(playback.encode_jpeg(image), playback.encode_jpeg(playback.warp_round(image, warp))) for image in polar]
    pictures: dict[str, tuple[bytes, ...]] = dict(
        zip(("drive/polar", "drive/fisheye"), zip(*pairs, strict=True), strict=True)
    )
    if recording.horizontal is not None:
        grey = (np.repeat(recording.horizontal[observation][..., None], 3, axis=2) for observation in seen)
        pictures["drive/horizontal"] = tuple(playback.encode_jpeg(image) for image in grey)
    for path, blobs in pictures.items():
        stream.log(path, rr.EncodedImage.from_fields(media_type="image/jpeg"), static=True)
        stream.send_columns(path, indexes, rr.EncodedImage.columns(blob=list(blobs)))


def _log_scans(stream: rr.RecordingStream, recording: Recording, seen: np.ndarray, time: np.ndarray) -> None:
    """Where each ray ends, as points about the robot."""
    step = -(-len(seen) // IMAGES_AT_MOST)
    scans = np.asarray(recording.observation[seen[::step], 0])
    angle = 2.0 * np.pi * np.arange(scans.shape[1]) / scans.shape[1]
    ends = scans[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    points = _lift(ends.reshape(-1, 2), LAYER_M)
    stream.log(f"{ROBOT}/scan", rr.Points3D.from_fields(radii=0.012, colors=[63, 208, 165]), static=True)
    stream.send_columns(
        f"{ROBOT}/scan",
        _drive_index(time[::step], recording),
        rr.Points3D.columns(positions=points).partition([scans.shape[1]] * len(scans)),
    )


def _log_training(stream: rr.RecordingStream, name: str, history: Data, truth: np.ndarray) -> None:
    last = max(int(history["step"][-1]), 1)
    step, loss = history["step"], np.log10(np.maximum(np.asarray(history["loss"], float), 1e-9))
    colour = tuple(int(255 * part) for part in to_rgb(figures.LINES.get(name, "#888888")))
    _send_series(stream, f"training/{name}/loss", _step_index(step, last), loss, "loss", (*colour, 90))
    _send_series(stream, f"training/{name}/smooth", _step_index(step, last), figures.smooth(loss), "median", colour)
    place = truth[history["snapshot_index"]]
    snapshot = [fit_alignment(points, place, "E2").apply(points) for points in history["snapshot"].astype(float)]
    count = len(place)
    path = f"world/training/{name}"
    stream.log(path, rr.Points3D.from_fields(radii=0.025), static=True)
    stream.send_columns(
        path,
        _step_index(history["snapshot_step"], last),
        rr.Points3D.columns(
            positions=_lift(np.concatenate(snapshot), LAYER_M),
            colors=np.tile(playback.colours_of_places(place), (len(snapshot), 1)),
        ).partition([count] * len(snapshot)),
    )


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
            "Each arrow leads from where the robot stood to where the method put it, for the worst heading there. "
            "One colour scale for all methods.",
            "",
            "The slider below runs through the drive and the training; choose `drive_time` or `step` for seconds "
            "or training steps.",
        ]
    )
    for name, text in {"figures": summary, "text": markdown_report(metrics)}.items():
        stream.log(f"report/{name}", rr.TextDocument(text, media_type="text/markdown"), static=True)
    pictures = {
        "error_fields": figures.draw_comparison(space, fields, metrics),
        "error_cdf": figures.draw_error_cdf(fields),
    }
    if histories:
        pictures["training"] = figures.draw_training(histories)
    for name, figure in pictures.items():
        image = rr.EncodedImage(contents=BytesIO(figures.to_png(figure)), media_type="image/png")
        stream.log(f"report/{name}", image, static=True)


def _send_series(
    stream: rr.RecordingStream,
    path: str,
    indexes: Iterable[rr.TimeColumn],
    values: np.ndarray,
    label: str,
    colour: Sequence[int],
) -> None:
    stream.log(path, rr.SeriesLines(colors=[colour], names=label, widths=1.5), static=True)
    stream.send_columns(path, indexes, rr.Scalars.columns(scalars=np.asarray(values, float)))


def _drive_index(time: np.ndarray, recording: Recording) -> list[rr.TimeColumn]:
    start, end = recording.time[0], recording.time[-1]
    share = (time - start) / max(end - start, 1e-9)
    return [rr.TimeColumn(DRIVE_TIME, duration=time), rr.TimeColumn(PROGRESS, sequence=_progress(share))]


def _step_index(step: np.ndarray, last: int) -> list[rr.TimeColumn]:
    return [rr.TimeColumn(STEP, sequence=step), rr.TimeColumn(PROGRESS, sequence=_progress(step / last))]


def _progress(share: np.ndarray) -> np.ndarray:
    return np.rint(share * PROGRESS_END).astype(np.int64)


def _camera(recording: Recording) -> CameraSettings:
    return CameraSettings.model_validate(recording.manifest["settings"]["camera"])


def _lift(points: np.ndarray, z: float) -> np.ndarray:
    """Points (N, 2) as (N, 3) at height ``z`` [m]."""
    return np.concatenate([points, np.full((len(points), 1), z)], axis=1)


def _quaternions(yaw: np.ndarray) -> np.ndarray:
    """Quaternions (N, 4), x y z w as Rerun has them, of headings (N,) [rad]."""
    zero = np.zeros_like(yaw)
    return np.stack([zero, zero, np.sin(yaw / 2), np.cos(yaw / 2)], axis=1)


def _hash(run: Path) -> str:
    state = hashlib.sha256()
    for path in (run / "metrics.json", run / "error_field.npz", run / "recording" / "manifest.json"):
        state.update(sha256(path).encode())
    return state.hexdigest()[:32]
