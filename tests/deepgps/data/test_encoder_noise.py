"""What theory expects of encoders, held against encoders that were simulated; and doubt, which needs no truth."""

from pathlib import Path

import numpy as np
import pytest

from deepgps.data.encoder_noise import expect_errors, find_wrong, predict_rms
from deepgps.data.segments import read_segments
from sim.recording.format import Recording
from sim.recording.manifest import Manifest
from sim.sensors.encoder import describe_odometry, read_encoders
from sim.settings import EncoderSettings

RADIUS_M, TRACK_M = 0.033, 0.16
SEGMENTS, GAPS, GAP_M = 600, 25, 0.08


def drive(encoder: EncoderSettings, seed: int = 0) -> tuple[Recording, np.ndarray]:
    """A recording of straight segments with turns between them, and the true length of each."""
    rng = np.random.default_rng(seed)
    angle, distance, place, reading, observation = [], [], np.zeros(2), [], 0
    for segment in range(SEGMENTS):
        place = place + np.array([-1, 1]) * rng.uniform(-np.pi, np.pi) * TRACK_M / 2 / RADIUS_M + rng.uniform(0, 0.5)
        gap_m = rng.uniform(0.9, 1.1) * GAP_M  # ticks must not fit a length
        along = gap_m / RADIUS_M * np.arange(GAPS + 1)
        distance.append(GAPS * gap_m)
        angle.append(place + along[:, None])
        reading += [[segment, observation + number] for number in range(GAPS + 1)]
        place, observation = angle[-1][-1], observation + GAPS
    ticks, arrived = read_encoders(np.concatenate(angle), RADIUS_M, encoder, np.random.default_rng(seed))
    table = np.column_stack([reading, ticks])[arrived]
    manifest = Manifest(odometry=dict(describe_odometry(encoder, RADIUS_M, TRACK_M)))
    images = np.zeros((observation + 1, 2))
    recording = Recording(Path("made-up"), manifest, images, table, np.arange(len(table), dtype=float), images[:0])
    return recording, np.array(distance)


def measure(recording: Recording, distance: np.ndarray) -> np.ndarray:
    """Errors of the lengths of whole segments, as far as readings of them arrived [m]."""
    segments = read_segments(recording)
    last = (segments.count - 1)[:, None]
    between = segments.index.gather(1, last)[:, 0] - segments.index[:, 0]
    return segments.distance.gather(1, last)[:, 0].numpy() - distance * between.numpy() / GAPS


@pytest.mark.parametrize(
    "encoder",
    [
        EncoderSettings(ticks_per_rev=16),
        EncoderSettings(ticks_per_rev=4),
        EncoderSettings(step_noise=0.1),
        EncoderSettings(slip_per_m=0.03),
        EncoderSettings(radius_error_left=0.05),
        EncoderSettings(radius_error_left=0.02, radius_error_right=0.02),
        EncoderSettings(stuck_fraction=0.3),
        EncoderSettings(step_noise=0.1, dropout=0.5),
        EncoderSettings(ticks_per_rev=8, step_noise=0.05, slip_per_m=0.02, radius_error_right=0.01),
    ],
    ids=["16 ticks", "4 ticks", "gaps", "slip", "one wheel", "both wheels", "stuck", "lost", "all"],
)
def test_segments_are_as_wrong_as_theory_expects(encoder: EncoderSettings):
    recording, distance = drive(encoder)
    measured = np.sqrt(np.mean(measure(recording, distance) ** 2))
    assert predict_rms(expect_errors(recording, read_segments(recording)), encoder) == pytest.approx(measured, rel=0.1)


def test_a_perfect_encoder_leaves_nothing_to_expect_and_wheels_of_different_size_are_no_reason_to_doubt():
    recording, distance = drive(EncoderSettings(ticks_per_rev=65536))
    segments = expect_errors(recording, read_segments(recording))
    assert predict_rms(segments, EncoderSettings()) < 1e-5
    assert segments.doubted is not None and not segments.doubted.any()
    assert not find_wrong(segments, measure(recording, distance)).any()
    recording, _ = drive(EncoderSettings(radius_error_left=0.1, slip_per_m=0.01))
    doubted = expect_errors(recording, read_segments(recording)).doubted
    assert doubted is not None and doubted.sum() <= 1


@pytest.mark.parametrize("stuck_fraction", [0.05, 0.2, 0.4])
def test_a_wheel_that_sticks_is_found_without_the_truth(stuck_fraction: float):
    encoder = EncoderSettings(stuck_fraction=stuck_fraction, step_noise=0.1, slip_per_m=0.005, radius_error_left=0.03)
    recording, distance = drive(encoder)
    segments = expect_errors(recording, read_segments(recording))
    assert segments.doubted is not None
    steady = measure(drive(encoder.model_copy(update={"stuck_fraction": 0.0}))[0], distance)
    wrong = np.abs(measure(recording, distance) - steady) > 0.2
    doubted = segments.doubted.numpy()
    assert wrong.sum() == pytest.approx(stuck_fraction * SEGMENTS, abs=2)
    assert doubted[wrong].all() and (doubted & ~wrong).sum() <= 3
