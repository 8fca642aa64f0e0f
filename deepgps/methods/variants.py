"""Variants of DeepGPS that also use the noise of the encoders, the turns by the wheels, or the images after turns.

With the diagnosed noise, residuals are weighted by expected error, and doubtful segments count less. With the wheels'
turns, training starts from the dead-reckoned path. By the compass, which compares the images before and after turns in
place, the initial map is never folded. Turns of either kind also determine the chirality.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from deepgps.config.learning import LearnSettings, Start
from deepgps.data.encoder_noise import expect_errors, weigh_pairs, weigh_places
from deepgps.data.segments import Segments
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
from deepgps.initial_map.compass.compass_map import NEIGHBOURS, CompassMap, find_compass_map
from deepgps.initial_map.distances.dense import find_chirality, read_turns, straighten
from deepgps.initial_map.distances.isomap import find_loop_closures
from deepgps.initial_map.stored_map import write_map
from deepgps.learning.batches import Batch
from deepgps.learning.losses import Weights
from deepgps.learning.training_data import TrainingData, prepare
from deepgps.methods.deepgps import Variant, fit_data, make_initial_map, record_undecided
from deepgps.positioner.positioner import Fitted, NetworkPositioner
from deepgps.terminal.progress import Report
from sim.recording.format import Recording
from sim.rng import stream


def fit_noise_aware(recording: Recording, settings: LearnSettings, seed: int, folder: Path, progress: Report) -> Fitted:
    """Train DeepGPS with weighted residuals; a segment on which the wheels disagree counts less."""
    recording, record = take_diagnosed(recording, folder.parent)
    data = prepare(recording, settings, seed, folder.parent)
    segments = expect_errors(recording, data.segments)
    variant = Variant(weigh=weigh_by_noise(segments.rounding_m2))
    return fit_data(replace(data, segments=segments), variant, settings, seed, folder, progress).note(record)


def weigh_by_noise(rounding_m2: float) -> Callable[[Batch], Weights]:
    """Returns the weights of residuals of segments with expected errors, whose readings are rounded."""

    def weigh(batch: Batch) -> Weights:
        assert batch.variance is not None, "segments with expected errors make batches with them"
        of_places = weigh_places(batch.variance, batch.valid, rounding_m2)
        return Weights(weigh_pairs(batch.variance, rounding_m2), of_places)

    return weigh


def fit_with_turns(recording: Recording, settings: LearnSettings, seed: int, folder: Path, progress: Report) -> Fitted:
    """Train DeepGPS from the dead-reckoned path, with the chirality that the wheels' turns determine."""
    recording, record = take_diagnosed(recording, folder.parent)
    data, turns = prepare(recording, settings, seed, folder.parent), read_turns(recording)

    def start_from_path(
        features: torch.Tensor, segments: Segments, start: Start, seed: int, number: int
    ) -> tuple[torch.Tensor, Segments]:
        if start != "paths" or number > 0:
            return make_initial_map(features, segments, start, seed, number)
        relaxed = straighten(turns, features, segments, stream(seed, "start"))
        return torch.from_numpy(relaxed.places), relaxed.segments

    def orient(positions: torch.Tensor) -> int:
        return find_chirality(positions.double().numpy(), data.segments, turns.angle)

    variant = Variant(make_initial_map=start_from_path, orient=orient)
    return fit_data(data, variant, settings, seed, folder, progress).note(record)


MAP_WEIGHT = 4.0
"""Weight with which the network is held to the map, which is right to millimetres, beside distances and straightness.

In three worlds, with exact and noisy encoders, it was better than 1 and 16; the map alone lets the network bend a
segment between two images.
"""
MIN_MOUNT_M, MIN_MOUNT_DEVIATIONS = 0.005, 3.0
"""A camera that is nearer to the axle than this [m], or than so many standard deviations, is taken to be on it."""


def map_by_compass(
    recording: Recording, settings: LearnSettings, seed: int, folder: Path, progress: Report
) -> tuple[TrainingData, CompassTurns, CompassMap, dict[str, Any]]:
    """The data set upright, its turns and its map by compass, and the record of the wheels' diagnosis."""
    recording, record = take_diagnosed(recording, folder.parent)
    turns = measure_turns(recording)
    assert turns.upright is not None
    data = prepare(recording, settings, seed, folder.parent, ignore_small(turns.upright))
    data = replace(data, segments=expect_errors(recording, data.segments))
    progress("compass: initial map", 0, 1)
    found = make_compass_map(data, turns, seed)
    write_map(folder, found, data.segments, turns)
    progress("compass: initial map", 1, 1)
    return data, turns, found, {**describe_lean(turns.upright.lean), "map": describe_map(found), **record}


def fit_compass(recording: Recording, settings: LearnSettings, seed: int, folder: Path, progress: Report) -> Fitted:
    """Train DeepGPS from the map by the compass, which also determines the chirality.

    Images of a camera that leans are set upright first.
    """
    data, turns, found, record = map_by_compass(recording, settings, seed, folder, progress)

    def start_from_compass(
        features: torch.Tensor, segments: Segments, start: Start, seed: int, number: int
    ) -> tuple[torch.Tensor, Segments]:
        if number > 0:
            return make_initial_map(features, segments, start, seed, number)
        return torch.from_numpy(found.places), segments

    def orient(positions: torch.Tensor) -> int:
        return find_chirality(positions.double().numpy(), data.segments, turns.angle)

    variant = Variant(
        weigh=weigh_by_noise(data.segments.rounding_m2),
        make_initial_map=start_from_compass,
        orient=orient,
        curvature=float(found.shared[0]),
        any_length=True,
        held=MAP_WEIGHT,
    )
    fitted = fit_data(data, variant, settings, seed, folder, progress)
    assert isinstance(fitted.positioner, NetworkPositioner)
    if fitted.training["attempt"] == 0:  # others did not begin with this map, and may be mirrored
        fitted = fitted._replace(positioner=replace(fitted.positioner, mount=find_mount(found)))
    return fitted.note(record)


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
    known = found.std[np.isfinite(found.std)]
    curvature, ahead, left = zip(found.shared.round(5).tolist(), found.shared_std.round(5).tolist(), strict=True)
    return {
        # RMS error that turns, encoders and loop closures allow, after alignment [m]
        "expected_rms_m": round(float(np.sqrt(2.0 * (known**2).mean())), 5),
        **record_undecided(found.undecided),
        # Distance after which the world repeats [m]; None: it does not; 0: unknown
        "repeats_m": round(found.repeats_m, 2) if np.isfinite(found.repeats_m) else None,
        # Share of the loop closures that are inliers
        "believed": round(float(found.inliers.mean()), 4) if len(found.inliers) else None,
        # Curvature of what the robot drives for straight, and its standard deviation [1/m]
        "curvature_per_m": curvature,
        "camera_ahead_m": ahead,  # The camera's place ahead of the axle, and its standard deviation [m]
        "camera_left_m": left,  # The same to the left [m]
    }
