"""What reports take from the files of runs: columns for the study's table."""

import json
import math
from pathlib import Path

import numpy as np
from safetensors import safe_open
from scipy.spatial import KDTree

from deepgps.config.methods import folder_of
from deepgps.diagnosis.store import FILE as DIAGNOSIS
from deepgps.diagnosis.store import diagnose_once
from deepgps.evaluation.error_field import find_rms, read_all_headings, read_fields
from deepgps.evaluation.measures import SEEN_RADIUS_M
from deepgps.evaluation.navigate_run import Order, navigate_run
from deepgps.navigation.simulate import TRUE_POSE, WHEELS
from deepgps.reports.run_report import read_metrics
from deepgps.runs.collect import choose_renderer, find_parts
from deepgps.runs.run_folder import open_run
from deepgps.studies.reports.diagnose import describe
from deepgps.studies.reports.encoder import NEARNESS_M, name_near
from deepgps.studies.reports.navigating import CHANGED, DRIVES
from deepgps.studies.reports.record import PAPERS_ERRORS
from deepgps.studies.reports.worlds import DONE_SHARE
from deepgps.studies.table import Row
from deepgps.terminal.progress import Report, ignore
from sim.errors import InputError
from sim.files.checksums import read_json
from sim.recording.format import open_recording, open_truth, read_manifest
from sim.settings import SimSettings

FLOOR_STRIDE = 5  # Of so many cells of the floor one is looked at
ENTERED_M, DOOR_M = 0.5, 0.6  # An image this near is in a room; test positions this near are beside a door [m]
MAX_GOALS, GOAL_IMAGES = 50, 80  # Goals of a run, at most, and images of its drive for each


def add_errors(run: Path, row: Row, progress: Report = ignore) -> Row:
    """Columns for the part of test positions with small errors, errors of complete segments, and doubted segments."""
    error = read_fields(run)[row["method"]].error
    near = {name_near(near): float(np.mean(error <= near)) for near in NEARNESS_M}
    return {**near, **read_metrics(run)["distances"]}


def add_scans(run: Path, row: Row, progress: Report = ignore) -> Row:
    """Columns for the errors over single scans, and for how many numbers the method stores for positioning."""
    error = read_all_headings(run)[row["method"]].error
    errors = {"each_rms_m": find_rms(error), "each_median_m": np.median(error), "each_max_m": error.max()}
    with safe_open(folder_of(run, row["method"]) / "weights.safetensors", "np") as weights:
        stored = sum(int(np.prod(weights.get_slice(name).get_shape())) for name in weights.offset_keys())
    return {**{name: float(value) for name, value in errors.items()}, "stored": stored}


def add_drives(run: Path, row: Row, progress: Report = ignore) -> Row:
    """A column for figures of drives to goals, by the source of positions; it drives them if that is not done."""
    scenario = open_run(run)
    if row["method"] != scenario.methods[0]:
        return {}
    goals = min(MAX_GOALS, max(2, scenario.drive.samples // GOAL_IMAGES))
    choose_renderer()
    driven = navigate_run(run, Order(goals, (*scenario.methods, WHEELS, TRUE_POSE)), progress)
    changed = navigate_run(run, Order(goals, scenario.methods[:1], changes=True), progress)
    return {DRIVES: json.dumps({**driven.figures, CHANGED: changed.figures[scenario.methods[0]]})}


def add_labels(run: Path, row: Row, progress: Report = ignore) -> Row:
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


def add_diagnosis(run: Path, row: Row, progress: Report = ignore) -> Row:
    """Columns for what is wrong with the wheels of a run's recording, and what is found."""
    recording = open_recording(run / "recording")
    if diagnose_once(recording, run) is None:
        raise InputError(f"{run}: the report diagnose needs readings of the wheels and images after turns")
    return describe(open_run(run), read_json(run / DIAGNOSIS))


def add_explored(run: Path, row: Row, progress: Report = ignore) -> Row:
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


def add_home(run: Path, row: Row, progress: Report = ignore) -> Row:
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
