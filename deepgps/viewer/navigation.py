"""Drives to goals in the viewer: route, true and own position with its ellipse, each image and that of the map."""

from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from scipy.spatial import KDTree

from deepgps.evaluation.navigate_run import Driven
from deepgps.learning.trainer import use_threads
from deepgps.navigation.simulate import IMAGE_GOALS, TRUE_POSE, WHEELS
from deepgps.positioner.stored_positioner import load_positioner
from deepgps.viewer.drive import TRUE_COLOUR, camera_of, find_track_m, log_poses, log_robot
from deepgps.viewer.layout import aim_eye, arrange, follow, room_view, series_view
from deepgps.viewer.pictures import log_round
from deepgps.viewer.scene import LAYER_M, draw_ellipses, lift, log_room
from deepgps.viewer.stream import DRIVE_TIME, Rows, Shapes, hash_files, save_recording, send_series, send_shapes
from sim.geometry import limits
from sim.recording.format import open_recording, open_truth

ROOT = "world/navigate"
OWN_COLOUR, ROUTE_COLOUR, GOAL_COLOUR = (240, 80, 120), (255, 196, 60), (63, 208, 165)
DEVIATIONS = 3.0  # Standard deviations that the ellipse shows
PAUSE_S = 1.0  # Time between two drives on the timeline [s]


def write_drives(run: Path, driven: Driven) -> Path:
    """Write the first drives by the run's method as ``navigate/<method>.rrd``; returns its path."""
    name = min(driven.trips, key=(WHEELS, TRUE_POSE).count)
    trip, log, path = driven.trips[name], driven.logs[name], driven.folder / f"{name}.rrd"
    recording, space = open_recording(run / "recording"), open_truth(run / "recording").free_space
    positioner, world, camera = load_positioner(trip.folder), trip.alignment, camera_of(recording)
    with use_threads(1):
        places = KDTree(positioner.locate_training(recording.observation))
    shown = min(IMAGE_GOALS, len(trip.goals))
    last_s = [log["time_s"][log["row_goal"] == number][-1] for number in range(shown)]
    start_s = np.append(0.0, np.cumsum(np.array(last_s) + PAUSE_S))
    rows, ways = log["row_goal"] < shown, log["route_goal"] < shown
    time_s = start_s[log["row_goal"][rows]] + log["time_s"][rows]
    seen_s = start_s[log["image_goal"]] + log["image_time_s"]
    true, own = log["true"][rows], world.apply(log["estimated"][rows, :2])
    spread = DEVIATIONS**2 * world.rotation @ log["covariance"][rows] @ world.rotation.T
    now = np.clip(np.searchsorted(time_s, seen_s), 0, len(time_s) - 1)
    matched = recording.observation[places.query(np.nan_to_num(log["estimated"][rows, :2][now]))[1]]

    def at(seconds: np.ndarray) -> Rows:
        return [rr.TimeColumn(DRIVE_TIME, duration=seconds)]

    def log_all(stream: rr.RecordingStream) -> None:
        log_room(stream, recording.folder / "scene.glb", space)
        log_robot(stream, find_track_m(recording), camera.height_m)
        log_poses(stream, true, at(time_s))
        goals = {"positions": lift(world.apply(trip.goals[:shown]), 2 * LAYER_M)}
        send_shapes(stream, ROOT, at(start_s[:shown]), {"goal": (goals, GOAL_COLOUR, 0.06)})
        route = {"positions": lift(world.apply(log["route"].reshape(-1, 2)[ways]), LAYER_M)}
        lengths = np.bincount(log["route_goal"][ways], minlength=shown).tolist()
        send_shapes(stream, ROOT, at(start_s[:shown]), {"route": (route, ROUTE_COLOUR, 0.012)}, lengths)
        ellipses = {"strips": draw_ellipses(np.nan_to_num(own), np.nan_to_num(spread), 2 * LAYER_M)}
        points = {"positions": lift(own, 2 * LAYER_M)}
        shapes: Shapes = {"own": (points, OWN_COLOUR, 0.035), "ellipse": (ellipses, OWN_COLOUR, 0.006)}
        send_shapes(stream, ROOT, at(time_s), shapes)
        drives = [lift(true[log["row_goal"][rows] == number, :2], LAYER_M) for number in range(shown)]
        stream.log(f"{ROOT}/path", rr.LineStrips3D(drives, colors=[TRUE_COLOUR], radii=0.005), static=True)
        error_cm = 100 * np.linalg.norm(own - true[:, :2], axis=1)
        send_series(stream, "error", at(time_s), error_cm, "own position minus true [cm]", OWN_COLOUR)
        for entity, pictures in (("image", log["image"]), ("matched", matched)):
            log_round(stream, entity, np.asarray(pictures), camera, at(seen_s))

    said = "Robot, its own position with 3 deviations (red), route (yellow), goal (green)"
    shown_paths = ["room", "floor_plan", "drive/**", "navigate/**"]
    room = room_view(said, shown_paths, aim_eye(limits(space), tilt=0.45, reach=1.2, before=-0.3))
    beside = rrb.Vertical(
        rrb.Spatial2DView(name="Image", origin="image"),
        rrb.Spatial2DView(name="Nearest image on its map", origin="matched"),
        series_view("Own position minus true [cm]", "error"),
    )
    layout = arrange([rrb.Horizontal(room, beside, column_shares=[5, 2], name="Drives")], follow(DRIVE_TIME))
    number = hash_files(driven.folder, [path.with_suffix(".npz")])
    save_recording(path, number, f"{run.name}: {name}", layout, log_all)
    return path
