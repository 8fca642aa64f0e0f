"""The drive: the robot and its path below ``world``, sensor data below ``drive``, the encoders' errors.

The same functions log a finished drive and, part by part, one that is being collected.
"""

from pathlib import Path

import numpy as np
import rerun as rr

from deepgps.data.segments import find_lasts, find_starts
from deepgps.diagnosis.store import read_diagnosis
from deepgps.evaluation.segment_errors import measure_distances, measure_segments, reckon_path
from deepgps.reports.wheels_page import describe_encoders, draw_segments, write_markdown
from deepgps.viewer.pictures import POLAR_PICTURES, log_figure, log_jpegs, log_polar
from deepgps.viewer.scene import LAYER_M, lift
from deepgps.viewer.stream import Clock, Rows, drive_clock, put_text, send_rows, send_series
from sim.recording.format import Recording, Truth
from sim.sensors.catalog import SENSORS
from sim.settings import CameraSettings

ROBOT = "world/drive/robot"
BODY_M = 0.14
Colour = tuple[int, int, int]
TRUE_COLOUR: Colour = (90, 160, 255)
LEG_COLOUR: Colour = (255, 196, 60)
WRONG_COLOUR: Colour = (232, 37, 79)
RIGHT_COLOUR: Colour = (63, 208, 165)
ODOMETRY_COLOUR: Colour = (255, 150, 40)
MAX_IMAGES = 4_000  # more pictures than anyone plays; keeps a long drive's file small
DIAGNOSIS = "encoders/diagnosis"
NO_DIAGNOSIS = (
    "No diagnosis of the wheels has been made: `deepgps diagnose` makes one, and so do the methods that learn with it, "
    "from a recording with images after turns."
)


def log_drive(stream: rr.RecordingStream, recording: Recording, pose: np.ndarray) -> None:
    """Log a finished drive along its poses at each reading (R, 3) [m, m, rad], true or dead-reckoned."""
    _, first = np.unique(recording.reading[:, 1], return_index=True)
    log_robot(stream, find_track_m(recording), camera_of(recording).height_m)
    log_poses(stream, pose[first], drive_clock(recording.time[first]))
    log_path(stream, "world/drive", recording.reading[:, 0], pose[:, :2], (TRUE_COLOUR, LEG_COLOUR), recording.time)
    log_ticks(stream, recording)
    log_images(stream, recording)


def log_robot(stream: rr.RecordingStream, track_m: float, height_m: float) -> None:
    """Log the robot's shape, with so much between its wheels and its lens so high above the floor."""
    stream.log(
        f"{ROBOT}/body",
        rr.Cylinders3D(
            lengths=[BODY_M, height_m - BODY_M],
            radii=[0.65 * track_m, 0.012],
            centers=[(0, 0, BODY_M / 2), (0, 0, (height_m + BODY_M) / 2)],
            colors=[(60, 66, 80), (180, 184, 190)],
            fill_mode=rr.components.FillMode.Solid,
        ),
        rr.Arrows3D(origins=[(0, 0, BODY_M + 0.01)], vectors=[(0.25, 0, 0)], colors=LEG_COLOUR, radii=0.015),
        static=True,
    )
    stream.log(f"{ROBOT}/lens", rr.Points3D([(0, 0, height_m)], radii=0.03, colors=[WRONG_COLOUR]), static=True)


def log_poses(stream: rr.RecordingStream, pose: np.ndarray, at: Rows) -> None:
    """Log where the robot is: poses (n, 3) [m, m, rad]."""
    zero, half = np.zeros(len(pose)), pose[:, 2] / 2
    quaternion = np.stack([zero, zero, np.sin(half), np.cos(half)], axis=1)  # x y z w
    rows = rr.Transform3D.columns(translation=lift(pose[:, :2], 0.0), quaternion=quaternion)
    stream.send_columns(ROBOT, at, rows)


def log_path(
    stream: rr.RecordingStream,
    root: str,
    segment: np.ndarray,
    place: np.ndarray,
    colours: tuple[Colour, Colour],
    time: np.ndarray,
    clock: Clock = drive_clock,
) -> None:
    """Log complete segments, one row each, and at each reading the part of its segment driven so far.

    Readings have segments (R,), positions (R, 2) [m], true or dead-reckoned, and times (R,) [s]; segments and current
    parts have a colour each.
    """
    place, start = lift(place, LAYER_M), find_starts(segment)
    for name, radius_m, colour, rows in (
        ("path", 0.006, [*colours[0], 150], find_lasts(start)),
        ("leg", 0.012, colours[1], np.arange(len(place))),
    ):
        strips = {"strips": np.stack([place[start[rows]], place[rows]], axis=1)}
        style = {"radii": radius_m, "colors": colour}
        send_rows(stream, f"{root}/{name}", rr.LineStrips3D, clock(time[rows]), strips, style)


def log_images(stream: rr.RecordingStream, recording: Recording) -> None:
    """Log what the sensors took: pictures, and of a scan the end of each ray in the robot's frame."""
    seen, first = np.unique(recording.reading[:, 1], return_index=True)
    step = -(-len(seen) // MAX_IMAGES)
    seen, at = seen[::step], drive_clock(recording.time[first[::step]])
    if recording.kind == "polar_image":
        log_polar(stream, np.asarray(recording.observation[seen]), camera_of(recording), at)
    if recording.kind == "scan":
        scans = np.asarray(recording.observation[seen, 0])
        angle = 2.0 * np.pi * np.arange(scans.shape[1]) / scans.shape[1]
        ends = scans[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        points, style = {"positions": lift(ends.reshape(-1, 2), LAYER_M)}, {"radii": 0.012, "colors": RIGHT_COLOUR}
        send_rows(stream, f"{ROBOT}/scan", rr.Points3D, at, points, style, [scans.shape[1]] * len(scans))
    for name in _find_images(recording):
        grey = recording.others[name]
        coloured = (np.repeat(grey[number][..., None], 3, axis=2) for number in seen)
        log_jpegs(stream, f"drive/{name}", coloured, at)


def find_pictures(recording: Recording) -> dict[str, str]:
    """Titles of the pictures that a recording has, by name; scans and distances to landmarks are no pictures."""
    polar = POLAR_PICTURES if recording.kind == "polar_image" else {}
    return polar | {name: SENSORS[name].title if name in SENSORS else name for name in _find_images(recording)}


def log_ticks(stream: rr.RecordingStream, recording: Recording) -> None:
    """Log the ticks of both wheels since the reading before on the same segment; the first reading has none."""
    segment = recording.reading[:, 0]
    later = segment[1:] == segment[:-1]
    at = drive_clock(recording.time[1 + np.flatnonzero(later)])
    ticks = np.diff(recording.reading[:, 2:], axis=0)[later]
    send_series(stream, "drive/ticks/left", at, ticks[:, 0], "left", TRUE_COLOUR)
    # wide and pale, so that both are seen where they are equal
    send_series(stream, "drive/ticks/right", at, ticks[:, 1], "right", (*RIGHT_COLOUR, 110), width=5.0)
    send_series(stream, "drive/tick_difference", at, ticks[:, 1] - ticks[:, 0], "right minus left", WRONG_COLOUR)


def log_encoders(stream: rr.RecordingStream, recording: Recording, truth: Truth) -> None:
    """Log the errors of segments along the drive, as text and figure, and the dead-reckoned path with its drift."""
    encoder, travelled = measure_distances(recording, truth.pose)
    true, reckoned = truth.pose[recording.reading[:, 1], :2], reckon_path(recording, truth.pose)
    drift = np.linalg.norm(reckoned - true, axis=1)
    root, at = "world/reckoned", drive_clock(recording.time)
    log_path(stream, root, recording.reading[:, 0], reckoned, (ODOMETRY_COLOUR, ODOMETRY_COLOUR), recording.time)
    place = {"positions": lift(reckoned, 5 * LAYER_M)}
    send_rows(stream, f"{root}/place", rr.Points3D, at, place, {"radii": 0.06, "colors": ODOMETRY_COLOUR})
    ends = {"strips": np.stack([lift(true, 4 * LAYER_M), lift(reckoned, 4 * LAYER_M)], axis=1)}
    send_rows(stream, f"{root}/drift", rr.LineStrips3D, at, ends, {"radii": 0.012, "colors": WRONG_COLOUR})
    send_series(stream, "encoders/drift", at, drift, "dead-reckoning drift", WRONG_COLOUR)
    error_mm = 1000 * (encoder - travelled)
    send_series(stream, "drive/segment_error", at, error_mm, "encoder minus truth", WRONG_COLOUR)
    put_text(stream, "encoders/faults", describe_encoders(recording, truth.pose, drift))
    log_figure(stream, "encoders/segments", draw_segments(*measure_segments(recording, truth.pose)))


def log_diagnosis(stream: rr.RecordingStream, run: Path) -> None:
    """Log the diagnosis of the wheels in a run's folder, as the command prints it, or how to make one."""
    diagnosis = read_diagnosis(run)
    put_text(stream, DIAGNOSIS, NO_DIAGNOSIS if diagnosis is None else write_markdown(diagnosis))


def camera_of(recording: Recording) -> CameraSettings:
    """Settings of the camera that took a recording's images."""
    return CameraSettings.model_validate(recording.manifest.settings.get("camera", {}))


def find_track_m(recording: Recording) -> float:
    """The true distance between the wheels; the one in the odometry contains the error that was set."""
    wrong = recording.manifest.settings.get("encoder", {}).get("track_error", 0.0)
    return float(recording.manifest.odometry["track_m"]) / (1.0 + wrong)


def _find_images(recording: Recording) -> list[str]:
    """Names of the sensors, except the first, that take pictures."""
    return [name for name in recording.others if recording.manifest.sensors[name] == "image"]
