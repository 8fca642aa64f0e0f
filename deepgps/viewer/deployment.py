"""The deployment drive: errors along it, by single images and as tracked, beside what the camera saw.

The timeline ``deployment`` has its seconds; an arrow's tooltip says at which it was seen.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import rerun as rr

from deepgps.config.methods import folder_of
from deepgps.evaluation.error_field import ErrorField, read_all_headings
from deepgps.evaluation.stored_alignment import read_alignment
from deepgps.evaluation.track_run import FOLDER, take_in_world
from deepgps.reports.plots import colours_of
from deepgps.tracking.track import PATHS, read_track
from deepgps.viewer.drive import MAX_IMAGES, ODOMETRY_COLOUR, RIGHT_COLOUR, TRUE_COLOUR, camera_of
from deepgps.viewer.error_field import REFUSED_RGBA, log_field
from deepgps.viewer.pictures import log_polar
from deepgps.viewer.scene import LAYER_M, lift
from deepgps.viewer.stream import DEPLOYMENT, Span, deployment_clock, send_rows, send_series
from sim.recording.format import Recording, open_truth
from sim.recording.turns import NO_IMAGE

COLOURS = {"single": TRUE_COLOUR, "causal": RIGHT_COLOUR, "odometry": ODOMETRY_COLOUR}
ROBOT_COLOUR, MIN_ERROR_CM = (255, 255, 255), 1e-2


class Way(NamedTuple):
    """Positions along a drive."""

    title: str  # How they are found
    field: ErrorField  # Their errors, each image at a place of its own
    time: np.ndarray  # Times of the images (n,) [s]


def find_ways(run: Path, drive: Recording) -> tuple[str, dict[str, Way]]:
    """A method and its positions along the deployment drive: the first that was tracked there, or else the first."""
    fields, truth = read_all_headings(run, "use_field.npz"), open_truth(drive.folder)
    tracks = {name: path for name in fields if (path := run / FOLDER / f"{name}.npz").is_file()}
    method = next(iter([*tracks, *fields]))
    ways = {"single": Way(PATHS["single"], fields[method], np.asarray(drive.observation_time))}
    if method in tracks:
        track, alignment = read_track(tracks[method]), read_alignment(folder_of(run, method))
        for name in set(COLOURS) - set(ways):
            path = track.paths[name]
            pose = take_in_world(path, alignment)
            known = (track.observation != NO_IMAGE) & np.isfinite(pose[:, 0])
            true = truth.pose[track.observation[known]]
            field = ErrorField(true[:, :2], true[:, 2:], pose[known, None, :2], accepted=path.accepted[known, None])
            ways[name] = Way(PATHS[name], field, track.time[known])
    return method, {name: ways[name] for name in COLOURS if name in ways}


def log_deployment(
    stream: rr.RecordingStream, method: str, ways: Mapping[str, Way], drive: Recording, span: Span
) -> None:
    """Log the true path in the colours of each way's errors, its arrows, its errors over time, and the images."""
    clock = deployment_clock(drive, span)
    for name, (title, field, time) in ways.items():
        root, error, place = f"world/{DEPLOYMENT}/{name}", field.error[:, 0], lift(field.truth, LAYER_M)
        log_field(stream, method, field, root=root, marks={row: f", {one:.1f} s" for row, one in enumerate(time)})
        colours = np.where(field.is_accepted, colours_of(error), REFUSED_RGBA)[1:]
        path = rr.LineStrips3D(np.stack([place[:-1], place[1:]], axis=1), radii=0.01, colors=colours)
        stream.log(f"{root}/path", path, static=True)
        here = {"positions": lift(field.truth, 6 * LAYER_M)}
        send_rows(stream, f"{root}/robot", rr.Points3D, clock(time), here, {"radii": 0.06, "colors": ROBOT_COLOUR})
        logarithm = np.log10(np.maximum(100 * error, MIN_ERROR_CM))
        send_series(stream, f"{DEPLOYMENT}/error/{name}", clock(time), logarithm, title, COLOURS[name])
    if drive.kind == "polar_image":
        images, time = drive.observation, np.asarray(drive.observation_time)
        step = -(-len(images) // MAX_IMAGES)
        log_polar(stream, np.asarray(images[::step]), camera_of(drive), clock(time[::step]), DEPLOYMENT)
