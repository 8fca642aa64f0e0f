"""Variants of DeepGPS that also use the noise of the encoders, or the turns between segments by the wheels.

DeepGPS with the diagnosed noise: residuals are weighted by expected error, and doubtful segments count less.

DeepGPS that also uses the turns between segments: it starts from the dead-reckoned path and is never mirrored.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import torch

from deepgps.config.learning import LearnSettings, Start
from deepgps.data.encoder_noise import expect_errors, weigh_pairs, weigh_places
from deepgps.data.segments import Segments
from deepgps.diagnosis.store import take_diagnosed
from deepgps.initial_map.distances.wheel_turns import find_chirality, read_turns, straighten
from deepgps.learning.batches import Batch
from deepgps.learning.losses import Weights
from deepgps.learning.training_data import prepare
from deepgps.methods.deepgps import Variant, fit_data, make_initial_map
from deepgps.positioner.positioner import Fitted
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
