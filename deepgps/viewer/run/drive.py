"""The drive along its timeline: the robot and its path below ``world``, sensor data below ``drive``."""

from collections.abc import Iterable

import numpy as np
import rerun as rr

from deepgps.data import runs
from deepgps.evaluation import segment_errors
from deepgps.viewer import playback
from deepgps.viewer.scene import LAYER_M, lift
from deepgps.viewer.timeline import drive_index, send_series
from sim.recording.format import Recording, Truth
from sim.sensors.catalog import SENSORS
from sim.settings import CameraSettings

ROBOT = "world/drive/robot"
Colour = tuple[int, int, int]
TRUE: Colour = (90, 160, 255)
LEG: Colour = (255, 196, 60)
WRONG: Colour = (232, 37, 79)
RIGHT: Colour = (63, 208, 165)
IMAGES_AT_MOST = 4_000  # more pictures than anyone plays; keeps a long drive's file small
ROUND_PX = 144
POLAR_PICTURES = {"fisheye": "Fisheye", "polar": "Polar image, zenith at the top"}
"""Pictures of a polar image by name, with their titles."""


def log_drive(stream: rr.RecordingStream, recording: Recording, truth: Truth) -> None:
    height_m = camera_of(recording).height_m
    _log_robot(stream, _find_track_m(recording), height_m)
    observation = recording.reading[:, 1]
    seen, first = np.unique(observation, return_index=True)
    stream.send_columns(
        ROBOT,
        drive_index(recording.time[first], recording),
        rr.Transform3D.columns(translation=lift(truth.pose[seen, :2], 0.0), quaternion=turn_up(truth.pose[seen, 2])),
    )
    log_path(stream, "world/drive", truth.pose[observation, :2], (TRUE, LEG), recording)
    _log_distances(stream, recording, truth)
    log_images(stream, recording, seen, recording.time[first])
    if recording.kind == "scan":
        _log_scans(stream, recording, seen, recording.time[first])


def log_path(
    stream: rr.RecordingStream, root: str, place: np.ndarray, colours: tuple[Colour, Colour], recording: Recording
) -> None:
    """Log complete segments below ``root``, one row each, and at each reading the part of its segment driven so far.

    Args:
        stream: Stream to log to.
        root: Entity below which the path is logged.
        place: Position at each reading, true or dead-reckoned (R, 2) [m].
        colours: Colours of the segments and of the current part.
        recording: The recording.
    """
    segment, place = recording.reading[:, 0], lift(place, LAYER_M)
    start = runs.find_starts(segment)
    end = runs.find_lasts(start)
    stream.log(f"{root}/path", rr.LineStrips3D.from_fields(radii=0.006, colors=[*colours[0], 150]), static=True)
    stream.send_columns(
        f"{root}/path",
        drive_index(recording.time[end], recording),
        rr.LineStrips3D.columns(strips=np.stack([place[start[end]], place[end]], axis=1)),
    )
    stream.log(f"{root}/leg", rr.LineStrips3D.from_fields(radii=0.012, colors=colours[1]), static=True)
    stream.send_columns(
        f"{root}/leg",
        drive_index(recording.time, recording),
        rr.LineStrips3D.columns(strips=np.stack([place[start], place], axis=1)),
    )


def find_pictures(recording: Recording) -> dict[str, str]:
    """Titles of the pictures that a recording has, by name; scans and distances to landmarks are no pictures."""
    polar = POLAR_PICTURES if recording.kind == "polar_image" else {}
    return polar | {name: SENSORS[name].title if name in SENSORS else name for name in _find_images(recording)}


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
        rr.Arrows3D(origins=[(0, 0, body_m + 0.01)], vectors=[(0.25, 0, 0)], colors=LEG, radii=0.015),
        static=True,
    )
    stream.log(f"{ROBOT}/lens", rr.Points3D([(0, 0, height_m)], radii=0.03, colors=[232, 37, 79]), static=True)


def _log_distances(stream: rr.RecordingStream, recording: Recording, truth: Truth) -> None:
    encoder, true, difference = segment_errors.measure_distances(recording, truth.pose)
    series = {
        "drive/distance/encoder": (encoder, "by encoder", (255, 150, 40)),
        "drive/distance/truth": (true, "true", TRUE),
        "drive/segment_error": (1000 * (encoder - true), "encoder minus truth", WRONG),
        "drive/difference": (1000 * difference, "encoder minus truth, cumulative", WRONG),
    }
    indexes = drive_index(recording.time, recording)
    for path, (values, label, colour) in series.items():
        send_series(stream, path, indexes, values, label, colour)
    log_ticks(stream, recording)


def log_ticks(stream: rr.RecordingStream, recording: Recording) -> None:
    """Log the ticks of both wheels since the reading before on the same segment; the first reading has none."""
    segment = recording.reading[:, 0]
    later = segment[1:] == segment[:-1]
    rows = 1 + np.flatnonzero(later)
    indexes = drive_index(recording.time[rows], recording)
    ticks = np.diff(recording.reading[:, 2:], axis=0)[later]
    send_series(stream, "drive/ticks/left", indexes, ticks[:, 0], "left", TRUE, width=4.0)  # seen under an equal right
    send_series(stream, "drive/ticks/right", indexes, ticks[:, 1], "right", RIGHT)
    send_series(stream, "drive/tick_difference", indexes, ticks[:, 1] - ticks[:, 0], "right minus left", WRONG)


def log_images(stream: rr.RecordingStream, recording: Recording, seen: np.ndarray, time: np.ndarray) -> None:
    """Log all sensors' pictures of the observations ``seen`` (n,), taken at ``time`` (n,) [s]."""
    step = -(-len(seen) // IMAGES_AT_MOST)
    seen, indexes = seen[::step], drive_index(time[::step], recording)
    if recording.kind == "polar_image":
        polar = recording.observation
        _, rings, sectors, _ = polar.shape
        warp = playback.make_warp(camera_of(recording), rings, sectors, ROUND_PX)
        _log_pictures(stream, "polar", (np.asarray(polar[number]) for number in seen), indexes)
        rounds = (playback.warp_round(np.asarray(polar[number]), warp) for number in seen)
        _log_pictures(stream, "fisheye", rounds, indexes)
    for name in _find_images(recording):
        grey = recording.others[name]
        _log_pictures(stream, name, (np.repeat(grey[number][..., None], 3, axis=2) for number in seen), indexes)


def _find_images(recording: Recording) -> list[str]:
    """Names of the sensors, except the first, that take pictures."""
    return [name for name in recording.others if recording.manifest.sensors[name] == "image"]


def _log_pictures(
    stream: rr.RecordingStream, name: str, images: Iterable[np.ndarray], indexes: list[rr.TimeColumn]
) -> None:
    blobs = [playback.encode_jpeg(image) for image in images]
    stream.log(f"drive/{name}", rr.EncodedImage.from_fields(media_type="image/jpeg"), static=True)
    stream.send_columns(f"drive/{name}", indexes, rr.EncodedImage.columns(blob=blobs))


def _log_scans(stream: rr.RecordingStream, recording: Recording, seen: np.ndarray, time: np.ndarray) -> None:
    """Log the end of each ray as a point in the robot's frame."""
    step = -(-len(seen) // IMAGES_AT_MOST)
    scans = np.asarray(recording.observation[seen[::step], 0])
    angle = 2.0 * np.pi * np.arange(scans.shape[1]) / scans.shape[1]
    ends = scans[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    points = lift(ends.reshape(-1, 2), LAYER_M)
    stream.log(f"{ROBOT}/scan", rr.Points3D.from_fields(radii=0.012, colors=[63, 208, 165]), static=True)
    stream.send_columns(
        f"{ROBOT}/scan",
        drive_index(time[::step], recording),
        rr.Points3D.columns(positions=points).partition([scans.shape[1]] * len(scans)),
    )


def _find_track_m(recording: Recording) -> float:
    """The true distance between the wheels; the one in the odometry contains the error that was set."""
    wrong = recording.manifest.settings.get("encoder", {}).get("track_error", 0.0)
    return float(recording.manifest.odometry["track_m"]) / (1.0 + wrong)


def camera_of(recording: Recording) -> CameraSettings:
    """Settings of the camera that took a recording's images."""
    return CameraSettings.model_validate(recording.manifest.settings.get("camera", {}))


def turn_up(yaw: np.ndarray) -> np.ndarray:
    """Quaternions (N, 4), in Rerun's order x y z w, of headings (N,) [rad]."""
    zero = np.zeros_like(yaw)
    return np.stack([zero, zero, np.sin(yaw / 2), np.cos(yaw / 2)], axis=1)
