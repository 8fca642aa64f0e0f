"""How wrong the distances are that a recording teaches, beside what its encoders should make them: evaluation only."""

from typing import Any

import numpy as np

from deepgps.data.encoder_noise import expect_errors, find_wrong, predict_rms
from deepgps.data.segments import read_segments
from deepgps.figures.encoder_plots import measure_segments
from sim.recording.format import Recording, Truth
from sim.settings import EncoderSettings


def judge_encoders(recording: Recording, truth: Truth) -> dict[str, Any]:
    """Errors of whole segments' distances.

    Returns:
        ``segment_rms_m``: RMS of distance by encoder less the true one [m]; ``segment_expected_m``: what theory says
        of these encoders [m]; ``segments_wrong``: segments farther off than noise explains; ``segments_doubted``: those
        that a noise-aware method believes by less than a half; ``wrong_doubted``: those that are both.
    """
    segments = expect_errors(recording, read_segments(recording))
    encoder = EncoderSettings.model_validate(recording.manifest["settings"].get("encoder", {}))
    _, error = measure_segments(recording, truth.pose)
    assert segments.weight is not None
    wrong, doubted = find_wrong(segments, error), segments.weight.numpy() < 0.5
    return {
        "segment_rms_m": float(np.sqrt(np.mean(error**2))),
        "segment_expected_m": predict_rms(segments, encoder),
        "segments_wrong": int(wrong.sum()),
        "segments_doubted": int(doubted.sum()),
        "wrong_doubted": int((wrong & doubted).sum()),
    }
