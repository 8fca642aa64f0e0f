"""Expected errors of encoders: residuals are divided by them, and plots draw them as a line.

The distance between two readings of a straight segment is the mean of the distances of two wheels. Its expected squared
errors are:

- quantisation: a wheel has the difference of two errors that are uniform over a tick ``t``: t^2 / 6, the mean t^2 / 12;
- gap noise: the wheels share it, and gaps ``g`` add up: sum (w g)^2 (paper, Sec. V-A); where readings were lost, a gap
  is the sum of ``k`` gaps and has (w g)^2 / k;
- slip: for a wheel it grows with the distance ``c`` as s^2 c, for the mean as s^2 c / 2.
"""

from dataclasses import replace

import numpy as np
import torch

from deepgps.data.segments import Segments, find_runs, travel
from sim.recording.format import Recording
from sim.sensors.encoder import check_odometry, expect_bias, expect_variance, measure_tick
from sim.settings import EncoderSettings

MAX_DISAGREEMENT = 4.0  # Standard deviations by which two wheels may differ on a straight segment
RESOLUTION_M = 0.003  # Error of the network itself; smaller encoder errors do not matter. Chosen in one room [m]


def expect_errors(recording: Recording, segments: Segments) -> Segments:
    """Return the segments with the expected errors of their distances and a robust weight for each segment.

    Where a wheel's encoder sticks or slips far, the two wheels of a straight segment disagree. A segment on which they
    disagree by ``z`` standard deviations, more than ``MAX_DISAGREEMENT``, has the weight (MAX_DISAGREEMENT / z)^2.
    """
    odometry = check_odometry(recording.manifest.odometry)
    gap = segments.distance.diff(dim=1).clamp_min(0.0) * segments.valid[:, 1:]
    made_of = segments.index.diff(dim=1).clamp_min(1)
    grown = expect_variance(odometry, gap, made_of)
    variance = torch.nn.functional.pad(grown.cumsum(dim=1), (1, 0))
    tick_m = measure_tick(odometry)
    doubt = torch.from_numpy(measure_wheel_disagreement(recording, tick_m, odometry.get("slip_per_m", 0.0))).float()
    weight = (MAX_DISAGREEMENT / doubt.clamp_min(MAX_DISAGREEMENT)).square()
    return replace(segments, variance=variance, rounding_m2=tick_m**2 / 12.0, weight=weight)


def predict_rms(segments: Segments, encoder: EncoderSettings) -> float:
    """Predict the RMS error of the lengths of complete segments [m]; ``segments`` must have expected errors.

    It includes noise and the faults that are in no data sheet: wrong radii and a stuck encoder (``FAULTS``).
    """
    distance, noise = _measure_complete(segments)
    return float((noise + expect_bias(encoder, distance)).mean().sqrt())


def find_inliers(segments: Segments) -> torch.Tensor:
    """Numbers (n,) int64 of the segments whose weight is at least a half; all of them where they have no weights."""
    if segments.weight is None:
        return torch.arange(len(segments.count))
    return (segments.weight >= 0.5).nonzero()[:, 0]


def measure_wheel_disagreement(recording: Recording, tick_m: float, slip_per_m: float) -> np.ndarray:
    """Disagreement of the wheels on each segment (L,), in standard deviations; a constant ratio is allowed.

    Their difference has the variance t^2 / 3 + 2 s^2 c. A larger wheel causes a difference in proportion to the
    distance on all segments, which is subtracted; the median of the remaining differences counts as normal.
    """
    distance = travel(recording.reading[:, 2:], recording.manifest.odometry)
    ends = np.array([distance[run[-1]] - distance[run[0]] for run in find_runs(recording) if len(run) >= 2])
    driven, apart = np.abs(ends.mean(axis=1)), ends[:, 1] - ends[:, 0]
    apart -= np.median(apart / driven.clip(tick_m)) * driven
    usual = 1.4826 * np.median(np.abs(apart))
    return np.abs(apart) / np.sqrt(tick_m**2 / 3.0 + 2.0 * slip_per_m**2 * driven + usual**2)


def find_wrong(segments: Segments, error: np.ndarray) -> np.ndarray:
    """Mask (L,) of complete segments with true errors (L,) [m] beyond ``MAX_DISAGREEMENT`` expected deviations."""
    _, expected = _measure_complete(segments)
    return np.abs(error) > MAX_DISAGREEMENT * np.sqrt(expected.numpy() + RESOLUTION_M**2)


def _measure_complete(segments: Segments) -> tuple[torch.Tensor, torch.Tensor]:
    """Length (L,) [m] of each complete segment, and its expected squared error (L,) [m^2]."""
    assert segments.variance is not None, "expect_errors comes first"
    last = (segments.count - 1)[:, None]
    length, variance = (table.gather(1, last)[:, 0].double() for table in (segments.distance, segments.variance))
    return length, variance + segments.rounding_m2


def weigh_pairs(variance: torch.Tensor, rounding_m2: float) -> torch.Tensor:
    """Factors (S, m, m) for residuals of distances between all pairs of readings, from the readings' variances (S, m).

    1 / sqrt(1 + v / r^2), ``v`` the expected squared error and ``r`` the network's own error: 1 for perfect encoders.
    """
    between = (variance[:, :, None] - variance[:, None]).abs() + rounding_m2
    return (1.0 + between / RESOLUTION_M**2).rsqrt()


def weigh_places(variance: torch.Tensor, valid: torch.Tensor, rounding_m2: float) -> torch.Tensor:
    """Factors (S, m) for residuals along the line, of readings relative to the mean of their segment.

    Errors that add up have the covariance min(v_i, v_j), so that relative to the mean of n readings the variance is
    v_i - 2 mean_j min(v_i, v_j) + mean_jk min(v_j, v_k). Rounding, ``q`` for a pair, leaves q (1 - 1/n) / 2.
    """
    weight = valid.to(variance.dtype)
    share = weight / weight.sum(dim=1, keepdim=True).clamp_min(1.0)
    common = torch.minimum(variance[:, :, None], variance[:, None])
    mean = (common * share[:, None]).sum(dim=2)
    left = variance - 2.0 * mean + (mean * share).sum(dim=1, keepdim=True)
    rounding = rounding_m2 / 2.0 * (1.0 - share.amax(dim=1, keepdim=True))
    return (1.0 + (left.clamp_min(0.0) + rounding) / RESOLUTION_M**2).rsqrt()
