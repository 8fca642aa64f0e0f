"""The map by compass, and a network that learns its positions.

The compass compares the images before and after turns in place, so the map is neither folded nor mirrored. Distances
have the errors that diagnosis finds. Images of a camera that leans are set upright first.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from deepgps.config.learning import LearnSettings
from deepgps.data.encoder_noise import expect_errors
from deepgps.data.turns import (
    CompassTurns,
    compare_headings,
    describe_lean,
    ignore_small,
    measure_curvature,
    measure_turns,
)
from deepgps.diagnosis.store import take_diagnosed
from deepgps.initial_map.compass.closures import Closures
from deepgps.initial_map.compass.compass_map import NEIGHBOURS, CompassMap, find_compass_map, refine
from deepgps.initial_map.distances.isomap import find_loop_closures
from deepgps.initial_map.stored_map import write_map
from deepgps.learning.training_data import TrainingData, prepare
from deepgps.methods.deepgps import record_undecided
from deepgps.methods.refinement import refine_map
from deepgps.methods.regression import fit_positions
from deepgps.positioner.positioner import Fitted, NetworkPositioner
from deepgps.terminal.progress import Report
from sim.recording.format import Recording
from sim.rng import stream

MIN_MOUNT_M, MIN_MOUNT_DEVIATIONS = 0.005, 3.0
"""A camera that is nearer to the axle than this [m], or than so many standard deviations, is taken to be on it."""


def map_by_compass(
    recording: Recording, settings: LearnSettings, seed: int, folder: Path, progress: Report
) -> tuple[TrainingData, CompassMap, dict[str, Any]]:
    """The data set upright, its map by compass, and the record of both and of the wheels' diagnosis."""
    progress("compass: turns", 0, 1)
    recording, record = take_diagnosed(recording, folder.parent)
    turns = measure_turns(recording)
    progress("compass: turns", 1, 1)
    assert turns.upright is not None
    data = prepare(recording, settings, seed, folder.parent, ignore_small(turns.upright), progress)
    data = replace(data, segments=expect_errors(recording, data.segments))
    progress("compass: initial map", 0, 1)
    rng = stream(seed, "compass map, registered")
    found = make_compass_map(data, turns, seed)
    found = refine_map(data, found, keep_chosen, lambda one, factors: refine(one, factors, rng))
    write_map(folder, found, data.segments, turns)
    progress("compass: initial map", 1, 1)
    return data, found, {**describe_lean(turns.upright), "map": describe_map(found), **record}


def fit(recording: Recording, settings: LearnSettings, seed: int, folder: Path, progress: Report) -> Fitted:
    """Train the network of DeepGPS on the map's positions."""
    data, found, record = map_by_compass(recording, settings, seed, folder, progress)
    index = choose_positions(found)
    place = torch.from_numpy(found.places[index])
    fitted = fit_positions(data, torch.from_numpy(index), place, settings, seed, folder, progress)
    assert isinstance(fitted.positioner, NetworkPositioner)
    return fitted._replace(positioner=replace(fitted.positioner, mount=find_mount(found))).note(record)


def choose_positions(found: CompassMap) -> np.ndarray:
    """Observations (n,) whose positions are learned from: those that are decided; if none is, all that are known."""
    known = np.isfinite(found.places[:, 0])
    decided = known & ~found.undecided
    return np.flatnonzero(decided if decided.any() else known)


def keep_chosen(found: CompassMap) -> np.ndarray:
    """Positions (N, 2) [m] that are learned from; all others are NaN."""
    places, index = np.full(found.places.shape, np.nan), choose_positions(found)
    places[index] = found.places[index]
    return places


def make_compass_map(data: TrainingData, turns: CompassTurns, seed: int) -> CompassMap:
    """The map of all training observations by compass, encoders and loop closures; segments have expected errors."""
    first, second, length = find_loop_closures(data.features, data.segments, (NEIGHBOURS,))[0]
    once = first < second
    first, second, length = first[once], second[once], length[once]
    headings = compare_headings(data.observation, first, second)
    closures = Closures(first, second, length, np.where(headings.clear, headings.turn, np.nan))
    rng, curvature = stream(seed, "compass map"), measure_curvature(data.observation, data.segments)
    return find_compass_map(data.segments, turns, closures, len(data.features), rng, curvature)


def find_mount(found: CompassMap) -> tuple[float, float]:
    """Camera ahead of the axle and to its left [m]; zero if the map does not tell it from a camera on the axle."""
    mount, std = found.shared[1:], float(np.hypot(*found.shared_std[1:]))
    if np.hypot(*mount) < max(MIN_MOUNT_M, MIN_MOUNT_DEVIATIONS * std):
        return 0.0, 0.0
    return float(mount[0]), float(mount[1])


def describe_map(found: CompassMap) -> dict[str, Any]:
    """What ``training.json`` holds of a map: how well it is known, what is undecided, and what all segments share."""
    known, inliers, repeats_m = found.std[np.isfinite(found.std)], found.stages[-1].inliers, found.fit.inliers.repeats_m
    curvature, ahead, left = zip(found.shared.round(5).tolist(), found.shared_std.round(5).tolist(), strict=True)
    return {
        # RMS error that turns, encoders and loop closures allow, after alignment [m]
        "expected_rms_m": round(float(np.sqrt(2.0 * (known**2).mean())), 5),
        **record_undecided(found.undecided),
        # Distance after which the world repeats [m]; None: it does not; 0: unknown
        "repeats_m": round(repeats_m, 2) if np.isfinite(repeats_m) else None,
        # Share of the loop closures that are inliers
        "believed": round(float(inliers.mean()), 4) if len(inliers) else None,
        # Curvature of what the robot drives for straight, and its standard deviation [1/m]
        "curvature_per_m": curvature,
        "camera_ahead_m": ahead,  # The camera's place ahead of the axle, and its standard deviation [m]
        "camera_left_m": left,  # The same to the left [m]
    }
