"""Registration on a map by compass or by distances alone: no step of training, since what is seen where is enough."""

from pathlib import Path

import numpy as np

from deepgps.config.learning import LearnSettings
from deepgps.data.segments import find_runs
from deepgps.initial_map.compass.factors import Factors
from deepgps.initial_map.distances.dense import refine
from deepgps.initial_map.distances.folding import find_ambiguous, score_folding
from deepgps.learning.trainer import make_generator
from deepgps.learning.training_data import TrainingData, prepare
from deepgps.methods.appearance import learn
from deepgps.methods.compass import find_mount, keep_chosen, map_by_compass
from deepgps.methods.deepgps import choose_start, make_initial_map, record_undecided
from deepgps.methods.refinement import DistanceMap, refine_map
from deepgps.positioner.positioner import Fitted, RegistrationPositioner
from deepgps.terminal.progress import Report
from sim.errors import InputError
from sim.recording.format import Recording
from sim.rng import stream

MIN_LEFT_OUT_SHARE, MAX_LEFT_OUT_SHARE = 0.001, 0.5
"""Least share of the readings in a part that is left out, since it could be mirrored; most that are left out in all."""


def fit(recording: Recording, settings: LearnSettings, seed: int, folder: Path, progress: Report) -> Fitted:
    """Learn on the map by compass."""
    data, found, record = map_by_compass(recording, settings, seed, folder, progress)
    places, mount = keep_chosen(found), find_mount(found)
    return finish(data, places, found.heading, progress, folder, found.std, mount).note(record)


def fit_distances(recording: Recording, settings: LearnSettings, seed: int, folder: Path, progress: Report) -> Fitted:
    """Learn on the map from distances along segments alone; headings are the segments' directions on it."""
    data = prepare(recording, settings, seed, folder.parent, progress=progress)
    if (kind := choose_start(settings, data.segments)) == "lifting":
        raise InputError("registration_distances: a map needs segments with more than two readings each")
    progress(f"{folder.name}: initial map", 0, 1)
    places = make_initial_map(data.features, data.segments, kind, seed, 0)[0].numpy()
    undecided = np.zeros(len(places), bool)
    if kind == "paths":
        undecided = find_ambiguous(places, data.features, data.segments, MIN_LEFT_OUT_SHARE)
        if undecided.mean() <= MAX_LEFT_OUT_SHARE:
            places[undecided] = np.nan
        places = refine_distances(recording, data, places, stream(seed, "map by distances, registered"))
    progress(f"{folder.name}: initial map", 1, 1)
    fitted = finish(data, places, find_headings(recording, places), progress, folder)
    fold = score_folding(places, data.features, data.segments, make_generator(seed, "fold", 0))
    return fitted.note({"fold": fold.record(), "map": record_undecided(undecided)})


def refine_distances(
    recording: Recording, data: TrainingData, places: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Positions (N, 2) [m] on a map by distances with its images registered on one another."""

    def move(found: DistanceMap, factors: Factors) -> DistanceMap:
        moved = refine(found.places, data.features, data.segments, factors, rng)
        return DistanceMap(moved, find_headings(recording, moved))

    start = DistanceMap(places, find_headings(recording, places))
    return refine_map(data, start, lambda found: found.places, move).places


def finish(
    data: TrainingData,
    places: np.ndarray,
    heading: np.ndarray,
    progress: Report,
    folder: Path,
    std: np.ndarray | None = None,
    mount: tuple[float, float] = (0.0, 0.0),
) -> Fitted:
    """Learn what is seen where; see ``learn``."""
    appearance, index = learn(data, places, heading, std)
    positioner = RegistrationPositioner(index, upright=data.upright, appearance=appearance, mount=mount)
    progress(folder.name, 1, 1)
    stored = sum(tensor.numel() for tensor in appearance.pack().tensors.values())
    return Fitted(positioner, {"parameters": stored, "left_out_m": appearance.registration.calibration.left_out})


def find_headings(recording: Recording, positions: np.ndarray) -> np.ndarray:
    """Headings (N,) [rad] on the map of the positions (N, 2) [m] of a drive's images; NaN where they are unknown.

    They are the directions of straight lines through the positions of each segment, along which images are evenly
    spaced. Observations that belong to two segments are left out, unless the first of these has no others: it was seen
    at its end, before the robot turned. No tick is read.
    """
    uses, heading = np.bincount(recording.reading[:, 1], minlength=len(positions)), np.full(len(positions), np.nan)
    for run in find_runs(recording):
        index = recording.reading[run, 1]
        x, y = (index - index.mean()) @ (positions[index] - positions[index].mean(axis=0))
        if len(run) > 1 and np.hypot(x, y):
            own = index[uses[index] == 1]
            heading[own if len(own) else index[1:]] = np.arctan2(y, x)
    return heading
