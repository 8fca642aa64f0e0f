"""DeepGPS that also uses the images after turns in place: by compass, its map is never folded or mirrored."""

from pathlib import Path

import numpy as np
import torch

from deepgps.data.closure_headings import compare_headings
from deepgps.data.compass_turns import CompassTurns, measure_turns
from deepgps.data.encoder_noise import expect_errors
from deepgps.data.lean import describe_lean, ignore_small
from deepgps.initial_map.closures import Closures
from deepgps.initial_map.compass_map import NEIGHBOURS, CompassMap, find_compass_map
from deepgps.initial_map.isomap import find_loop_closures
from deepgps.initial_map.wheel_turns import find_chirality
from deepgps.learning.training_data import TrainingData, prepare
from deepgps.methods.deepgps import Sample, Variant, fit_data, make_initial_map
from deepgps.methods.positioner import Fitted
from deepgps.progress import Report
from deepgps.settings import LearnSettings, Start
from sim.recording.format import Recording
from sim.rng import stream


def fit(recording: Recording, settings: LearnSettings, seed: int, folder: Path, progress: Report) -> Fitted:
    """Train DeepGPS from the map by the compass, which also determines the chirality.

    Images of a camera that leans are set upright first.
    """
    turns = measure_turns(recording)
    assert turns.upright is not None
    data = prepare(recording, settings, seed, folder.parent, ignore_small(turns.upright))

    def start_from_compass(sample: Sample, start: Start, seed: int, number: int) -> torch.Tensor:
        if start != "paths" or number > 0:
            return make_initial_map(sample, start, seed, number)
        return torch.from_numpy(make_compass_map(recording, data, turns, seed).places)[sample.chosen]

    def orient(positions: torch.Tensor) -> int:
        return find_chirality(positions.double().numpy(), data.segments, turns.angle)

    variant = Variant(make_initial_map=start_from_compass, orient=orient)
    positioner, training = fit_data(data, variant, settings, seed, folder, progress)
    return Fitted(positioner, {**training, **describe_lean(turns.upright.lean)})


def make_compass_map(recording: Recording, data: TrainingData, turns: CompassTurns, seed: int) -> CompassMap:
    """The map of all training observations by compass, encoders and loop closures."""
    first, second, length = find_loop_closures(data.features, data.segments, (NEIGHBOURS,))[0]
    once = first < second
    first, second, length = first[once], second[once], length[once]
    headings = compare_headings(recording.observation, first, second)
    closures = Closures(first, second, length, np.where(headings.clear, headings.turn, np.nan))
    segments, rng = expect_errors(recording, data.segments), stream(seed, "compass map")
    return find_compass_map(segments, turns, closures, len(data.features), rng)
