"""Expected errors of encoders: the map by compass weighs distances by them, and plots draw them as a line.

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

MAX_DISAGREEMENT, MAX_ERROR = 5.66, 4.0
"""Standard deviations by which two wheels may differ on a straight segment, and its length from the true one."""
RESOLUTION_M = 0.003  # Smaller errors of a segment's length do not matter [m]


def expect_errors(recording: Recording, segments: Segments) -> Segments:
    """Return the segments with the expected errors of their distances, and those that are doubted.

    Where a wheel's encoder sticks or slips far, the two wheels of a straight segment disagree.
    """
    odometry = check_odometry(recording.manifest.odometry)
    gap = segments.distance.diff(dim=1).clamp_min(0.0) * segments.valid[:, 1:]
    made_of = segments.index.diff(dim=1).clamp_min(1)
    grown = expect_variance(odometry, gap, made_of)
    variance = torch.nn.functional.pad(grown.cumsum(dim=1), (1, 0))
    tick_m = measure_tick(odometry)
    apart = measure_wheel_disagreement(recording, tick_m, odometry.get("slip_per_m", 0.0))
    doubted = torch.from_numpy(apart > MAX_DISAGREEMENT)
    return replace(segments, variance=variance, rounding_m2=tick_m**2 / 12.0, doubted=doubted)


def predict_rms(segments: Segments, encoder: EncoderSettings) -> float:
    """Predict the RMS error of the lengths of complete segments [m]; ``segments`` must have expected errors.

    It includes noise and the faults that are in no data sheet: wrong radii and a stuck encoder (``FAULTS``).
    """
    distance, noise = _measure_complete(segments)
    return float((noise + expect_bias(encoder, distance)).mean().sqrt())


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
    """Mask (L,) of complete segments with true errors (L,) [m] beyond ``MAX_ERROR`` expected deviations."""
    _, expected = _measure_complete(segments)
    return np.abs(error) > MAX_ERROR * np.sqrt(expected.numpy() + RESOLUTION_M**2)


def _measure_complete(segments: Segments) -> tuple[torch.Tensor, torch.Tensor]:
    """Length (L,) [m] of each complete segment, and its expected squared error (L,) [m^2]."""
    assert segments.variance is not None, "expect_errors comes first"
    last = (segments.count - 1)[:, None]
    length, variance = (table.gather(1, last)[:, 0].double() for table in (segments.distance, segments.variance))
    return length, variance + segments.rounding_m2
