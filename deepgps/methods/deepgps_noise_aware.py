"""DeepGPS with the diagnosed noise: residuals are weighted by expected error, and doubtful segments count less."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from deepgps.config.learning import LearnSettings
from deepgps.data.encoder_noise import expect_errors, weigh_pairs, weigh_places
from deepgps.diagnosis.store import take_diagnosed
from deepgps.learning.batches import Batch
from deepgps.learning.losses import Weights
from deepgps.learning.training_data import prepare
from deepgps.methods.deepgps import Variant, fit_data
from deepgps.positioner.positioner import Fitted
from deepgps.terminal.progress import Report
from sim.recording.format import Recording


def fit(recording: Recording, settings: LearnSettings, seed: int, folder: Path, progress: Report) -> Fitted:
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
