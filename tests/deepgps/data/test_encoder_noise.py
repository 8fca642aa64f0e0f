"""What theory expects of encoders, held against encoders that were simulated; and doubt, which needs no truth."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from deepgps.data.encoder_noise import (
    MAX_DISAGREEMENT,
    expect_errors,
    find_inliers,
    find_wrong,
    predict_rms,
    weigh_pairs,
    weigh_places,
)
from deepgps.data.segments import read_segments
from deepgps.learning import losses
from deepgps.learning.batches import sample_batch
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
    assert segments.variance is not None and segments.weight is not None
    assert segments.weight.eq(1.0).all() and find_inliers(segments).equal(torch.arange(len(segments.count)))
    assert weigh_pairs(segments.variance, segments.rounding_m2).min() > 0.9999
    assert not find_wrong(segments, measure(recording, distance)).any()
    recording, _ = drive(EncoderSettings(radius_error_left=0.1, slip_per_m=0.01))
    weight = expect_errors(recording, read_segments(recording)).weight
    assert weight is not None and (weight < 0.5).sum() <= 1


@pytest.mark.parametrize("stuck_fraction", [0.05, 0.2, 0.4])
def test_a_wheel_that_sticks_is_found_without_the_truth(stuck_fraction: float):
    encoder = EncoderSettings(stuck_fraction=stuck_fraction, step_noise=0.1, slip_per_m=0.005, radius_error_left=0.03)
    recording, distance = drive(encoder)
    segments = expect_errors(recording, read_segments(recording))
    assert segments.weight is not None
    steady = measure(drive(encoder.model_copy(update={"stuck_fraction": 0.0}))[0], distance)
    wrong = np.abs(measure(recording, distance) - steady) > 0.2
    doubted = segments.weight.numpy() < 0.5
    assert wrong.sum() == pytest.approx(stuck_fraction * SEGMENTS, abs=2)
    assert doubted[wrong].all() and (doubted & ~wrong).sum() <= 3
    assert len(find_inliers(segments)) == SEGMENTS - doubted.sum()


def test_what_is_left_from_the_mean_is_that_of_random_walks_with_padding_or_without():
    rng = np.random.default_rng(0)
    step = rng.uniform(0.01, 0.05, 11)
    walk = np.concatenate([np.zeros((20_000, 1)), np.cumsum(rng.normal(0.0, step, (20_000, 11)), axis=1)], axis=1)
    left = (walk - walk.mean(axis=1, keepdims=True)).var(axis=0)
    variance = torch.from_numpy(np.concatenate([[0.0], np.cumsum(step**2)]))[None]
    trust = weigh_places(variance, torch.ones(1, 12, dtype=torch.bool), 0.0)
    np.testing.assert_allclose(trust[0].numpy(), 1.0 / np.sqrt(1.0 + left / 0.003**2), rtol=0.03)
    padded = weigh_places(torch.nn.functional.pad(variance, (0, 3)), torch.arange(15)[None] < 12, 0.0)
    torch.testing.assert_close(padded[:, :12], trust)


@given(st.integers(0, 10_000), st.floats(0.0, 0.01))
@settings(max_examples=25, deadline=None)
def test_pairs_farther_apart_are_trusted_less(seed: int, rounding: float):
    variance = torch.rand(2, 6, generator=torch.Generator().manual_seed(seed)).cumsum(dim=1)
    trust = weigh_pairs(variance, rounding)
    torch.testing.assert_close(trust, trust.mT)
    assert (trust[:, 0].diff(dim=1) <= 0).all() and (trust > 0).all() and (trust <= 1).all()


def test_full_trust_is_the_plain_loss_and_no_trust_leaves_only_what_lies_across():
    generator = torch.Generator().manual_seed(1)
    positions, along = torch.randn(3, 5, 2, generator=generator), torch.rand(3, 5, generator=generator).cumsum(dim=1)
    valid = torch.ones(3, 5, dtype=torch.bool)
    plain = losses.dense(positions, along, valid, "absolute")
    torch.testing.assert_close(losses.dense(positions, along, valid, "absolute", torch.ones(3, 5, 5)), plain)
    plain = losses.straight(positions, along, valid)
    torch.testing.assert_close(losses.straight(positions, along, valid, torch.ones(3, 5)), plain)
    bent = torch.stack([along * 3.0, torch.zeros(3, 5)], dim=-1)  # straight, and three times too long
    assert losses.straight(bent, along, valid) > 0.5
    torch.testing.assert_close(losses.straight(bent, along, valid, torch.zeros(3, 5)), torch.tensor(0.0))


def test_doubted_segments_are_drawn_as_rarely_as_they_are_believed():
    recording, _ = drive(EncoderSettings())
    segments = read_segments(recording)
    weight = torch.ones(SEGMENTS)
    weight[:300] = (MAX_DISAGREEMENT / 40.0) ** 2
    batch = sample_batch(replace(segments, weight=weight), 20_000, 2, torch.Generator().manual_seed(0))
    share = (batch.index[:, 0] < 300 * GAPS).float().mean().item()
    assert share == pytest.approx(0.01 / 1.01, abs=0.003)
