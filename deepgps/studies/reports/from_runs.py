"""What reports take from the files of runs: columns for the study's table, and pictures of rooms."""

import json
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from safetensors import safe_open
from scipy.spatial import KDTree

from deepgps.config.methods import folder_of
from deepgps.evaluation.error_field import find_rms, read_all_headings, read_fields
from deepgps.evaluation.evaluate import measure_heading_spread
from deepgps.evaluation.measures import SEEN_RADIUS_M, measure_visible
from deepgps.evaluation.navigate_run import Order, navigate_run
from deepgps.navigation.simulate import TRUE_POSE, WHEELS
from deepgps.positioner.positioner import Positioner
from deepgps.positioner.stored_positioner import load_positioner
from deepgps.reports.plots import add_scale, print_error_field
from deepgps.reports.run_report import read_metrics
from deepgps.runs.collect import choose_renderer, find_parts
from deepgps.runs.run_folder import open_run
from deepgps.studies.reports.encoder import NEARNESS_M, name_near
from deepgps.studies.reports.explore import DONE_SHARE
from deepgps.studies.reports.maps import BINS, EDGES, SHAPE
from deepgps.studies.reports.navigating import CHANGED, DRIVES
from deepgps.studies.reports.record import PAPERS_ERRORS
from deepgps.studies.table import Row, split_by
from deepgps.terminal.progress import ignore
from sim.errors import InputError
from sim.recording.format import open_recording, open_truth, read_manifest
from sim.settings import SimSettings

TURNED_IMAGES = 30
FLOOR_STRIDE = 5  # Of so many cells of the floor one is looked at
ENTERED_M, DOOR_M = 0.5, 0.6  # An image this near is in a room; test positions this near are beside a door [m]
MAX_GOALS, GOAL_IMAGES = 50, 80  # Goals of a run, at most, and images of its drive for each


def add_errors(run: Path, row: Row) -> Row:
    """Columns for the part of test positions with small errors, errors of complete segments, and doubted segments."""
    error = read_fields(run)[row["method"]].error
    near = {name_near(near): float(np.mean(error <= near)) for near in NEARNESS_M}
    return {**near, **read_metrics(run)["distances"]}


def add_turn_spread(run: Path, row: Row) -> Row:
    """A column for how much a trained network's prediction changes when an image is turned."""
    images = open_recording(run / "recording").test_observation
    few = np.linspace(0, len(images) - 1, min(TURNED_IMAGES, len(images))).round().astype(int)
    return {"turn_spread_m": measure_turn_spread(load_positioner(folder_of(run, row["method"])), images[few, 0])}


def measure_turn_spread(positioner: Positioner, images: np.ndarray) -> float:
    """RMS distance [m] of predictions from their mean over all turns of each image (n, rings, sectors, 3)."""
    turned = np.stack([np.roll(images, turn, axis=2) for turn in range(images.shape[2])], axis=1)
    return measure_heading_spread(positioner(turned.reshape(-1, *images.shape[1:])).reshape(*turned.shape[:2], 2))


def add_reach(run: Path, row: Row) -> Row:
    """A column for each bin of reach: the errors of all its positions [m]."""
    field = read_fields(run)[row["method"]]
    part = np.digitize(measure_visible(open_truth(run / "recording").free_space, field.truth), EDGES[1:-1])
    return {f"errors_{number}_m": field.error[part == number].astype(np.float32) for number in range(BINS)}


def add_scans(run: Path, row: Row) -> Row:
    """Columns for the errors over single scans, and for how many numbers the method stores for positioning."""
    error = read_all_headings(run)[row["method"]].error
    errors = {"each_rms_m": find_rms(error), "each_median_m": np.median(error), "each_max_m": error.max()}
    with safe_open(folder_of(run, row["method"]) / "weights.safetensors", "np") as weights:
        stored = sum(int(np.prod(weights.get_slice(name).get_shape())) for name in weights.offset_keys())
    return {**{name: float(value) for name, value in errors.items()}, "stored": stored}


def add_drives(run: Path, row: Row) -> Row:
    """A column for figures of drives to goals, by the source of positions; it drives them if that is not done."""
    scenario = open_run(run)
    if row["method"] != scenario.methods[0]:
        return {}
    goals = min(MAX_GOALS, max(2, scenario.drive.samples // GOAL_IMAGES))
    choose_renderer()
    driven = navigate_run(run, Order(goals, (*scenario.methods, WHEELS, TRUE_POSE)), ignore)
    changed = navigate_run(run, Order(goals, scenario.methods[:1], changes=True), ignore)
    return {DRIVES: json.dumps({**driven.figures, CHANGED: changed.figures[scenario.methods[0]]})}


def add_labels(run: Path, row: Row) -> Row:
    """Columns for errors against labels, and for the errors of the labels themselves."""
    metrics = read_metrics(run)
    if "labels" not in metrics:
        raise InputError(f"{run}: the report lab needs a recording with labels, as tag_camera.mounted gives it")
    labels, against = metrics["labels"], metrics["methods"][row["method"]]["against_labels"]
    return {
        **{f"label_{name}": against[name] for name in PAPERS_ERRORS},
        **{name: labels[name] for name in ("unlabelled", "test_unlabelled")},
        "labels_rms_m": labels["rms_m"],
        "labels_max_m": labels["max_m"],
    }


def add_explored(run: Path, row: Row) -> Row:
    """Columns for the images until the floor is seen, and the share unseen at the end, by the robot's map and truly."""
    manifest, truth = read_manifest(run / "recording"), open_truth(run / "recording")
    space, said = truth.free_space, (manifest.model_extra or {}).get("unseen", (None, None, None))
    floor = space.places()[::FLOOR_STRIDE]
    near = KDTree(truth.pose[:, :2]).query_ball_point(floor, SEEN_RADIUS_M)
    first = np.sort([min(images, default=np.inf) for images in near])
    last = float(first[math.ceil((1 - DONE_SHARE) * len(first)) - 1])
    reached = math.isfinite(last)
    needed = {"images_needed": int(last) + 1 if reached else len(truth.pose), "reached": reached}
    names = ("unseen", "unseen_low", "unseen_high")
    return {**needed, **dict(zip(names, said, strict=True)), "unseen_true": float(np.isinf(first).mean())}


def add_home(run: Path, row: Row) -> Row:
    """Columns for the rooms of a flat and those entered, the median error beside doors, and the run's own radius."""
    settings = SimSettings.model_validate(read_manifest(run / "recording").settings)
    rooms, doors = find_parts(settings)
    field, pose = read_fields(run)[row["method"]], open_truth(run / "recording").pose
    entered = KDTree(pose[:, :2]).query(rooms)[0] < ENTERED_M
    beside = KDTree(doors).query(field.truth)[0] < DOOR_M
    found = read_metrics(run)["methods"][row["method"]].get("left_out_m")
    return {
        **{"rooms": len(rooms), "entered": int(entered.sum()), "missed": bool((~entered).any())},
        **{"door_median_m": float(np.median(field.error[beside])) if beside.any() else None, "left_out_m": found},
    }


def draw_shapes(rows: Sequence[Row], varied: Sequence[str], folder: Path) -> Figure:
    """Draw a room of each shape: how much of it each position reaches, and DeepGPS's error there."""
    shapes = split_by([row for row in rows if row["method"] == "deepgps" and row["kind"] == "run"], SHAPE)
    figure = Figure(figsize=(9.6, 2.9 * len(shapes) + 0.2), layout="constrained")
    panels = figure.subplots(len(shapes), 2, squeeze=False, sharex=True, sharey=True)
    dots = None
    for (left, right), (shape, (row, *_)) in zip(panels, shapes.items(), strict=True):
        run = folder / "runs" / row["run"]
        field = print_error_field(right, run, "deepgps")
        right.set_title(f"{shape}: RMS {100 * row['rms_m']:.1f} cm", fontsize=9)
        visible = measure_visible(open_truth(run / "recording").free_space, field.truth)
        dots = left.scatter(*field.truth.T, s=6, c=100 * visible, norm=Normalize(0, 100), cmap="viridis", linewidths=0)
        left.set_title(f"{shape}: reach", fontsize=9)
        left.set(aspect="equal", ylabel="y [m]")
    if dots is not None:
        label = "share of the floor reached [%]"
        figure.colorbar(dots, ax=list(panels[:, 0]), shrink=0.5, label=label, location="left")
    add_scale(figure, list(panels[:, 1]))
    return figure
