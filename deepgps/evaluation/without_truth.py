"""What can be said of trained methods without the truth: of lengths, turns and refusals.

Nothing here is an error of a position. The last segments of a drive that were held out tell most: their lengths and
turns are known to the wheels and the compass, and no method was trained on them.
"""

from pathlib import Path
from typing import Any

import numpy as np
import torch

from deepgps.config.methods import folder_of
from deepgps.config.scenario import Scenario
from deepgps.data.segments import find_runs, travel
from deepgps.data.turns import compare_images, find_in_place, take_images, turns_with_images
from deepgps.diagnosis.diagnosis import diagnose
from deepgps.diagnosis.findings import find_faults
from deepgps.diagnosis.store import read_diagnosis
from deepgps.evaluation.deployment import adapt, check_predicted, find_causes, open_deployment
from deepgps.evaluation.error_field import find_rms
from deepgps.evaluation.segment_errors import describe_drive
from deepgps.learning.trainer import find_device
from deepgps.positioner.pose import Poses, find_poses
from deepgps.positioner.positioner import Positioner
from deepgps.positioner.stored_positioner import load_positioner, read_training
from deepgps.runs.run_folder import TRUTHLESS_METRICS
from deepgps.terminal.progress import Report, ignore
from sim.errors import DamagedError, InputError
from sim.files.checksums import read_json
from sim.geometry import wrap
from sim.recording.format import Recording, open_recording
from sim.recording.turns import from_array

MIN_IMAGES = 3  # Fewest images of a segment that can be off a straight line


def judge(run: Path, scenario: Scenario, progress: Report = ignore) -> dict[str, Any]:
    """Judge all methods of a run on a recording without truth.

    Returns the contents of ``without_truth.json``: what was driven, and for each method what is known of it.
    """
    recording = open_recording(run / "recording")
    held_out = open_deployment(recording)
    methods = {}
    device = find_device(scenario.learn.train.device)
    for number, name in enumerate(scenario.methods):
        progress("evaluate", number, len(scenario.methods))
        methods[name] = _judge_method(folder_of(run, name), recording, held_out, device)
    progress("evaluate", len(scenario.methods), len(scenario.methods))
    return {
        **describe_drive(recording, methods),
        # Observations, segments and distance of the drive that is held out
        **({} if held_out is None else {"held_out": describe_drive(held_out)}),
        "wheels": _diagnose_wheels(run, recording),  # What is wrong with the wheels; None: it cannot be known
        "methods": methods,  # What is known of each method, and what training.json holds
    }


def _diagnose_wheels(run: Path, recording: Recording) -> list[str] | None:
    """What is wrong with the wheels, by a method's diagnosis or a new one; None: that cannot be known."""
    try:
        return [fault.text for fault in find_faults(read_diagnosis(run, recording) or diagnose(recording))]
    except InputError:
        return None


def read_judged(run: Path) -> dict[str, Any] | None:
    """The contents of a run's ``without_truth.json``; None if there is no such file or it is damaged."""
    try:
        return read_json(run / TRUTHLESS_METRICS) if (run / TRUTHLESS_METRICS).is_file() else None
    except DamagedError:
        return None


def _judge_method(
    folder: Path, recording: Recording, held_out: Recording | None, device: torch.device
) -> dict[str, Any]:
    positioner = load_positioner(folder, device)
    place = positioner.locate_training(recording.observation)
    check_predicted(folder, place)
    found: dict[str, Any] = {
        "segments": judge_segments(place, recording),  # Figures of the segments trained on
    }
    if held_out is not None:
        adapted, lean = adapt(positioner, held_out)
        poses = find_poses(adapted, held_out.observation)
        # Figures of the segments held out
        found["held_out"] = {
            **judge_segments(poses.position, held_out, poses.accepted),
            **judge_turns(adapted, held_out),
            **_judge_trust(poses),
            **lean,
            **find_causes(positioner, recording, held_out),
        }
    return {**found, **read_training(folder)}


def judge_segments(place: np.ndarray, recording: Recording, accepted: np.ndarray | None = None) -> dict[str, Any]:
    """How well positions (N, 2) [m] agree with what the wheels say of a recording's segments.

    Figures are None where there is too little. ``accepted`` (N,) bool says which observations are, if it is known.
    """
    reading = recording.reading
    distance = travel(reading[:, 2:], recording.manifest.odometry).mean(axis=1)
    runs = [run for run in find_runs(recording) if len(run) > 1]
    if not runs:
        return dict.fromkeys(("length_rms_m", "length_median_m", "scale", "straight_rms_m"))
    first, last = np.array([[run[0], run[-1]] for run in runs]).T
    wheels = np.abs(distance[last] - distance[first])
    found = np.linalg.norm(place[reading[last, 1]] - place[reading[first, 1]], axis=1)
    both = np.ones(len(last), bool) if accepted is None else accepted[reading[first, 1]] & accepted[reading[last, 1]]
    # The RMS of segments of which both ends are accepted [m]
    kept = {} if accepted is None or not both.any() else {"length_rms_accepted_m": find_rms((found - wheels)[both])}
    off = [_measure_bend(place[reading[run, 1]]) for run in runs if len(run) >= MIN_IMAGES]
    return {
        # RMS difference of a segment's length by positions from that by the wheels [m]
        "length_rms_m": find_rms(found - wheels),
        **kept,
        "length_median_m": float(np.median(np.abs(found - wheels))),  # Median of these differences [m]
        "scale": float((found * wheels).sum() / (wheels**2).sum()),  # Factor of all lengths that fits best
        # RMS distance of positions from the straight line through their segment [m]
        "straight_rms_m": find_rms(np.concatenate(off)) if off else None,
    }


def _measure_bend(places: np.ndarray) -> np.ndarray:
    """Distance of each of some positions (n, 2) from the straight line that fits them best (n,)."""
    middle = places - places.mean(axis=0)
    return middle @ np.linalg.svd(middle, full_matrices=False)[2][1]


def judge_turns(positioner: Positioner, drive: Recording) -> dict[str, Any]:
    """How well the yaws before and after turns in place agree with the compass, which compares both images alone.

    Nothing is returned where there are neither turns nor yaws.
    """
    turns = turns_with_images(drive)
    if turns is None or not len(rows := find_in_place(turns)):
        return {}
    some = from_array(turns.array[rows])
    one, other = (find_poses(positioner, images).yaw for images in take_images(drive, some))
    if one is None or other is None:
        return {}
    angle = compare_images(drive, some).hypotheses.angle[:, 0]
    turned = other - one
    known = np.isfinite(turned) & np.isfinite(angle)
    if not known.any():
        return {}
    sign = -1.0 if positioner.mirrored else 1.0
    differ = np.sqrt(np.mean(wrap(sign * turned[known] - angle[known]) ** 2))
    # Turns in place compared; RMS difference of yaws after and before from the compass [deg]
    return {"turns": int(known.sum()), "turn_rms_deg": float(np.degrees(differ))}


def _judge_trust(poses: Poses) -> dict[str, Any]:
    """Share of images that are accepted, and the median radii of these [m], for methods that tell them."""
    if poses.accepted is None:
        return {}
    accepted = {"accepted": float(poses.accepted.mean())}
    if poses.radius_68 is None or poses.radius_95 is None or not poses.accepted.any():
        return accepted
    medians = (float(np.median(radius[poses.accepted])) for radius in (poses.radius_68, poses.radius_95))
    return {**accepted, **dict(zip(("radius_68_median_m", "radius_95_median_m"), medians, strict=True))}
