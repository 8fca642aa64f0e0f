"""The camera against the wheels: the scale of turns, and the curve of segments that should be straight."""

from dataclasses import dataclass

import numpy as np

from deepgps.data.turns import take_images, trust_wheels, turns_with_images
from deepgps.diagnosis.gaps import Gaps
from sim.errors import InputError
from sim.geometry import wrap
from sim.recording.format import Recording
from sim.recording.turns import KINDS
from sim.sensors.camera.lens import Lens, make_lens
from sim.sensors.visual_compass import Hypotheses, disambiguate, find_turns
from sim.settings import SimSettings

MAX_PAIRS = 300  # Pairs of images of one place, taken on different segments, that are compared
MIN_SEPARATION, MAX_SEPARATION = 25, 400
"""Observations that lie between the two images of a pair: enough for a curve to show, few enough to know the turns."""
MAX_LOOKS = 3000  # Observations among which alike ones are sought
FREQUENCIES = 6  # Lowest frequencies around the circle in the description of an image
HUBER_SCALE = 2.5  # Standard deviations beyond which a residual counts as one of this size
MEDIAN_TO_STD = 1.4826  # Standard deviation of a normal distribution over the median of its absolute values
TURN_STD_RAD = np.radians(0.05)  # Error of a turn by the camera, beside the one that its images tell [rad]
PLACE_STD_RAD = np.radians(0.5)
"""Error of the angle between two images of about one place, beside the one that they tell [rad]."""
CURVATURES = np.linspace(-1.0, 1.0, 4001)  # Curvatures among which the one of the segments is sought [rad/m]
UNKNOWN_STD = 1.0  # Standard deviation of what was not measured
MIN_EVIDENCE = 8  # Turns or pairs below which nothing is concluded


def see_turns(recording: Recording) -> Hypotheses:
    """Hypotheses of all turns (T) of a recording; raises InputError if it has no turns or no polar images."""
    if (turns := turns_with_images(recording)) is None:
        raise InputError(
            f"{recording.folder} has no images after turns (turns.npy), with which the wheels are compared; record "
            "with drive.turn_images and an upward camera"
        )
    return find_turns(*take_images(recording, turns), _lens(recording))


def find_alike(images: np.ndarray) -> np.ndarray:
    """Pairs (P, 2) of polar images, in the order driven, that look alike from any heading, a while apart; best first.

    An image is described by the amplitudes of the lowest frequencies around each ring, which no turn changes.
    """
    looked = np.unique(np.linspace(0, len(images) - 1, min(len(images), MAX_LOOKS)).astype(int))
    described = np.stack([_describe(images[one]) for one in looked])
    square = (described**2).sum(axis=1)
    found: dict[tuple[int, int], float] = {}
    for row, one in enumerate(looked.tolist()):
        gap = looked - one  # only later ones: each pair is compared once
        fitting = np.flatnonzero((gap >= MIN_SEPARATION) & (gap <= MAX_SEPARATION))
        if len(fitting):
            apart = square[fitting] - 2.0 * described[fitting] @ described[row]
            best = int(apart.argmin())
            found[one, int(looked[fitting[best]])] = float(apart[best] + square[row])
    best_first = sorted(found, key=found.__getitem__)[:MAX_PAIRS]
    return np.array(best_first, int).reshape(-1, 2)


def _describe(image: np.ndarray) -> np.ndarray:
    """Description of a polar image (rings x frequencies,), the same under every heading."""
    spectrum = np.abs(np.fft.rfft(image.mean(axis=2), axis=1))[:, : FREQUENCIES + 1]
    return np.sqrt(spectrum / image.shape[1]).ravel()


def _lens(recording: Recording) -> Lens:
    return make_lens(SimSettings.model_validate(recording.manifest.settings).camera)


@dataclass(frozen=True)
class Slope:
    """A ratio by weighted least squares and its standard deviation; ``UNKNOWN_STD`` where there is too little."""

    value: float
    std: float


def fit_slope(x: np.ndarray, y: np.ndarray, std: np.ndarray) -> Slope:
    """Slope of y over x (n,) through the origin, by iteratively reweighted least squares with Huber's weights.

    The standard deviation grows by the residuals' scale where that exceeds 1: what ``std`` does not know. The scale is
    that of their median, which a few wrong angles do not move.
    """
    weight = 1.0 / std**2
    slope, scale, robust = float(np.median(y / np.where(np.abs(x) > 1e-9, x, np.inf))), 1.0, np.ones(len(x))
    for _ in range(20):
        z = np.abs(y - slope * x) / std
        scale = max(1.0, MEDIAN_TO_STD * float(np.median(z)))
        robust = np.minimum(1.0, HUBER_SCALE * scale / np.maximum(z, 1e-12))
        slope = float((robust * weight * x * y).sum() / max((robust * weight * x**2).sum(), 1e-300))
    return Slope(slope, scale / float(np.sqrt(max((robust * weight * x**2).sum(), 1e-300))))


def measure_turn_scale(
    recording: Recording, gaps: Gaps, seen: Hypotheses, slip_per_m: float, step_noise: float
) -> tuple[Slope, int]:
    """Turns by the wheels over turns by the camera, for turns in place, and the number of turns.

    A turn by an angle ``a`` moves each wheel by ``b a / 2``; its error by the wheels has the variance
    s^2 |a| / b + (w a)^2 + t^2 / (3 b^2).
    """
    turns, track_m = recording.turns, recording.manifest.odometry["track_m"]
    assert turns is not None
    gap, reading = turns.after - 1, recording.reading
    wheels = (gaps.distance[gap, 1] - gaps.distance[gap, 0]) / track_m
    clean = (turns.kind == KINDS.index("in_place")) & (turns.image >= 0) & gaps.good[gap]
    clean &= (reading[gap, 1] == turns.before) & (reading[turns.after, 1] == turns.before)
    slope = Slope(1.0, UNKNOWN_STD)
    for _ in range(3):  # the choice of peaks needs the scale
        found = disambiguate(seen, wheels / slope.value, trust_wheels(turns))
        angle, std = found.angle[:, 0], found.std[:, 0]
        used = clean & np.isfinite(angle) & (np.abs(angle) > 0.1)
        if used.sum() < MIN_EVIDENCE:
            return Slope(1.0, UNKNOWN_STD), int(used.sum())
        x, y = angle[used], wheels[used]
        variance = std[used] ** 2 + TURN_STD_RAD**2 + (step_noise * x) ** 2
        variance += slip_per_m**2 * np.abs(x) / track_m + gaps.tick_m**2 / (3.0 * track_m**2)
        slope = fit_slope(x, y, np.sqrt(variance))
        if not 0.3 < slope.value < 3.0:
            return Slope(1.0, UNKNOWN_STD), int(used.sum())
    return slope, int(used.sum())


def measure_curvature(recording: Recording, gaps: Gaps, seen: Hypotheses, scale: float) -> tuple[Slope, int]:
    """Curvature of the segments, to the left [1/m], and the number of pairs of images that tell it.

    Two images of one place, a while apart, differ in heading by the turns between them, which the camera knows, and by
    the curvature times the distance between them, which no turn explains. The curvature for which most pairs agree is
    sought first, since angles are known but for whole turns. ``scale``: turns by the wheels over those by it.
    """
    turns, reading = recording.turns, recording.reading
    assert turns is not None
    wheels = np.diff(gaps.distance[turns.after - 1])[:, 0] / recording.manifest.odometry["track_m"]
    found = disambiguate(seen, wheels / scale, trust_wheels(turns))
    step, square, broken = (np.zeros(len(reading)) for _ in range(3))
    broken[1:] = ~gaps.good | ~gaps.inside  # a turn that no image shows; those that one shows follow
    known = np.isfinite(found.angle[:, 0]) & (turns.kind != KINDS.index("relocated"))
    rows = turns.after[known]
    step[rows], square[rows] = found.angle[known, 0], found.std[known, 0] ** 2 + TURN_STD_RAD**2
    broken[rows] = ~gaps.good[rows - 1]
    turned, variance, chain = np.cumsum(step), np.cumsum(square), np.cumsum(broken)
    straight = gaps.inside.copy()
    straight[turns.after[turns.kind == KINDS.index("in_place")] - 1] = True  # beside the turn: readings that were lost
    distance = np.append(0.0, np.cumsum(np.where(straight, gaps.distance.mean(axis=1), 0.0)))
    row = np.full(len(recording.observation), -1)
    row[reading[::-1, 1]] = np.arange(len(reading))[::-1]  # at a turn: as it was before the turn
    pairs = find_alike(recording.observation)
    angles = find_turns(recording.observation[pairs[:, 0]], recording.observation[pairs[:, 1]], _lens(recording))
    one, two = row[pairs[:, 0]], row[pairs[:, 1]]
    used = (one >= 0) & (two >= 0) & (chain[one] == chain[two]) & np.isfinite(angles.angle[:, 0])
    if used.sum() < MIN_EVIDENCE:
        return Slope(0.0, UNKNOWN_STD), int(used.sum())
    one, two, angle = one[used], two[used], angles.angle[used, 0]
    std = np.sqrt(angles.std[used, 0] ** 2 + PLACE_STD_RAD**2 + np.abs(variance[two] - variance[one]))
    missed, apart = angle - (turned[two] - turned[one]), distance[two] - distance[one]
    z = wrap(missed - CURVATURES[:, None] * apart) / std
    best = float(CURVATURES[(1.0 / (1.0 + z**2 / 4.0)).sum(axis=1).argmax()])
    left = wrap(missed - best * apart)
    near = np.abs(left) < 8.0 * std
    if near.sum() < MIN_EVIDENCE:
        return Slope(0.0, UNKNOWN_STD), int(near.sum())
    slope = fit_slope(apart[near], left[near], std[near])
    both = reading[one[near], 0] * (int(reading[-1, 0]) + 1) + reading[two[near], 0]
    shared = _spread(apart[near], left[near] - slope.value * apart[near], std[near], both)
    return Slope(best + slope.value, max(slope.std, shared)), int(near.sum())


def _spread(x: np.ndarray, left: np.ndarray, std: np.ndarray, group: np.ndarray) -> float:
    """Standard deviation of a slope whose residuals (n,) are alike within each group, by the sandwich formula.

    Pairs on the same two segments show the same things, and err alike (Liang and Zeger, Biometrika 73(1), 1986).
    """
    _, number = np.unique(group, return_inverse=True)
    sums = np.bincount(number, x * np.clip(left, -HUBER_SCALE * std, HUBER_SCALE * std) / std**2)
    return float(np.sqrt((sums**2).sum()) / (x**2 / std**2).sum())
