"""The compass: the angle that the robot turned between two polar images, from the images alone.

A turn in place shifts the polar image in a circle, so the peaks of the circular cross-correlation are hypotheses of the
angle (Labrosse, "The visual compass: performance and limitations of an appearance-based method", Journal of Field
Robotics 23(10), 2006). Angles are to the left [rad]: second image (azimuth) = first image (azimuth + angle).

The camera's lean against the robot is found from the relative leans of pairs: both images of a pair lean alike in the
robot's frame, but not in the room's: Rz(angle) swing(relative lean) = tilt(l)^T Rz(turn) tilt(l). A camera off the
turning axis moves in a turn, which shifts what is above it as a lean does. At the camera's own height, a lean moves
things up and down, and parallax only sideways: the lean is measured there.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from sim.errors import InputError
from sim.geometry import wrap
from sim.sensors.camera.lens import Lens
from sim.sensors.camera.mount import tilt
from sim.sensors.compass_fit import Grid, fit_rotation, make_grid, sample_spectra, swing, take_spectra


def find_highest(curve: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The highest peaks of curves (..., n), the highest first.

    Returns the angle of each (..., count) [rad], between the samples as ``find_top`` says, and its sample's value (...,
    count), -inf where a curve has fewer peaks.
    """
    before, after = np.roll(curve, 1, axis=-1), np.roll(curve, -1, axis=-1)
    peaks = np.where((curve > before) & (curve >= after), curve, -np.inf)
    angle, height = np.empty((*curve.shape[:-1], count)), np.empty((*curve.shape[:-1], count))
    for number in range(count):
        place = peaks.argmax(axis=-1)[..., None]
        height[..., number] = np.take_along_axis(peaks, place, axis=-1)[..., 0]
        low, top, high = (np.take_along_axis(one, place, axis=-1)[..., 0] for one in (before, curve, after))
        angle[..., number] = 2.0 * np.pi / curve.shape[-1] * (place[..., 0] + find_top(low, top, high))
        np.put_along_axis(peaks, place, -np.inf, axis=-1)
    return angle, height


def find_top(low: np.ndarray, top: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Where the parabola through three neighbouring samples has its top, from the middle one [samples]; 0: nowhere."""
    bend = low - 2.0 * top + high
    return np.where(bend < 0.0, (low - high) / (2.0 * np.where(bend < 0.0, bend, -1.0)), 0.0)


OVERSAMPLING = 16  # Samples of the correlation in a sector
MIN_WEIGHT = 1e-3  # Hypotheses with a smaller weight are left out
MIN_CONTRAST = 1e-6
"""An image whose variance is a smaller part of the mean square, after filtering, shows no direction."""
MATCH_FLOOR = 1e-3
"""Unexplained part of the energy that two images of one place have at least: steps of brightness and sampling."""
CHUNK = 32  # Pairs that are compared at once, so that they fit into the processor's cache


@dataclass(frozen=True)
class Hypotheses:
    """Hypotheses of the angle turned between P pairs, the likeliest first; at most K for a pair, the others NaN."""

    # Angle turned to the left (P, K) [rad]: from -pi to pi, or with whole turns where wheels give them
    angle: np.ndarray
    std: np.ndarray  # Standard deviation of each angle (P, K) [rad]
    weight: np.ndarray  # Probability of each hypothesis (P, K): a pair's add up to 1, or to 0 where it has none
    lean: np.ndarray  # Lean of the second camera against the first, to the second's right and forward (P, K, 2) [rad]


def find_turns(first: np.ndarray, second: np.ndarray, lens: Lens) -> Hypotheses:
    """Find all angles by which the robot may have turned between polar images (P, rings, sectors, channels) of a lens.

    Peaks of the correlation, weighted by solid angle, are sampled ``OVERSAMPLING`` times finer than the sectors; the
    likeliest are refined by a robust fit. A peak has the profile likelihood of a Gaussian residual, (1 - r^2)^(-n / 2),
    with n = 2 (sum p)^2 / sum p^2 independent values in the power spectrum p: rings and channels count as one. Raises
    InputError if the shapes differ or are not those of polar images.
    """
    first, second = np.asarray(first), np.asarray(second)
    if first.ndim != 4 or first.shape != second.shape or first.shape[1] < 2 or first.shape[2] < 8 or first.shape[3] < 1:
        raise InputError(
            f"images {first.shape} and {second.shape}: both must be (pairs, rings, sectors, channels) with at least 2 "
            "rings and 8 sectors"
        )
    chunks = [
        _find(first[start : start + CHUNK], second[start : start + CHUNK], lens)
        for start in range(0, len(first), CHUNK)
    ]
    pair = np.concatenate([np.empty(0, int), *(chunk[0] + CHUNK * i for i, chunk in enumerate(chunks))])
    found = np.concatenate([np.empty((0, 5)), *(chunk[1] for chunk in chunks)])
    return _pack(len(first), pair, found)


def disambiguate(hypotheses: Hypotheses, turn: np.ndarray, std: np.ndarray) -> Hypotheses:
    """Weigh hypotheses by the turn that the wheels measured, and add the whole turns that it tells.

    The wheels choose, and never change an angle by anything but whole turns. Where they cannot tell peaks apart, all
    remain, with their weights. The turn (P,) [rad] is of any size, with its standard deviation (P,) [rad], and NaN
    where the wheels measured none.
    """
    turn, std = np.asarray(turn, float)[:, None], np.asarray(std, float)[:, None]
    known = np.isfinite(turn) & np.isfinite(std)
    missed = np.where(known, turn, 0.0) - np.where(known, hypotheses.angle, 0.0)
    whole = 2.0 * np.pi * np.rint(missed / (2.0 * np.pi))
    variance = np.where(known, std, 1.0) ** 2 + hypotheses.std**2
    with np.errstate(divide="ignore"):
        score = np.log(hypotheses.weight) - np.where(known, (missed - whole) ** 2 / variance, 0.0) / 2.0
    score = np.where(hypotheses.weight > 0.0, score, -np.inf)
    pair, column = np.nonzero(np.isfinite(score))
    found = np.column_stack(
        [
            (hypotheses.angle + whole)[pair, column],
            hypotheses.std[pair, column],
            score[pair, column],
            hypotheses.lean[pair, column],
        ]
    )
    return _pack(len(score), pair, found)


def _find(first: np.ndarray, second: np.ndarray, lens: Lens) -> tuple[np.ndarray, np.ndarray]:
    """Pairs (M,) of all hypotheses, and their angle, std, log-likelihood and lean (M, 5)."""
    rings, sectors = first.shape[1:3]
    grid = make_grid(rings, sectors, lens)
    one, two = take_spectra(first, grid), take_spectra(second, grid)
    cross, *squares = (_sum(grid, *both) for both in ((one, two), (one, one), (two, two)))
    power = [square.real for square in squares]
    energy = np.sqrt(power[0].sum(axis=1) * power[1].sum(axis=1))
    contrast = np.minimum(_contrast(power[0], first, sectors), _contrast(power[1], second, sectors))
    seen = contrast > MIN_CONTRAST
    fine = sectors * OVERSAMPLING
    correlation = sample_spectra(cross, fine) * (fine / 2) / np.where(seen, energy, 1.0)[:, None]
    before, after = np.roll(correlation, 1, axis=1), np.roll(correlation, -1, axis=1)
    pair, place = np.nonzero((correlation > before) & (correlation >= after) & (correlation > 0.0) & seen[:, None])
    before, peak, after = before[pair, place], correlation[pair, place], after[pair, place]
    aside = find_top(before, peak, after)
    peak = peak - (before - after) * aside / 4.0
    angle = 2.0 * np.pi / fine * (place + aside)
    both = power[0] + power[1]
    values = 2.0 * both.sum(axis=1) ** 2 / np.maximum((both**2).sum(axis=1), 1e-30)
    unexplained = np.maximum(1.0 - peak**2, 0.0) + MATCH_FLOOR
    score = -values[pair] / 2.0 * np.log(unexplained)
    likely = score > _best(len(first), pair, score)[pair] + np.log(MIN_WEIGHT)
    pair, angle, score = pair[likely], angle[likely], score[likely]
    fitted = fit_rotation(one[pair], two[pair], angle, grid)
    return pair, np.column_stack([wrap(fitted.angle), fitted.std, score, fitted.lean])


def _sum(grid: Grid, one: np.ndarray, two: np.ndarray) -> np.ndarray:
    """Cross-spectra (P, frequencies), summed over channels and rings, these by solid angle."""
    return np.einsum("pcrk,pcrk,r->pk", one, two.conj(), grid.weight.mean(axis=1))


def _contrast(power: np.ndarray, images: np.ndarray, sectors: int) -> np.ndarray:
    """Filtered variance around the circle as a part of the mean square (P,)."""
    square = np.einsum("prsc,prsc->p", images, images, dtype=float, casting="same_kind") * sectors
    return power.sum(axis=1) / np.maximum(square, 1e-30)


def _best(count: int, pair: np.ndarray, score: np.ndarray) -> np.ndarray:
    best = np.full(count, -np.inf)
    np.maximum.at(best, pair, score)
    return best


def _pack(count: int, pair: np.ndarray, found: np.ndarray) -> Hypotheses:
    """Hypotheses of ``count`` pairs from a list of angle, std, log-likelihood and lean (M, 5)."""
    weight = np.exp(found[:, 2] - _best(count, pair, found[:, 2])[pair])
    weight /= np.bincount(pair, weight, count)[pair]
    kept = weight > MIN_WEIGHT
    pair, found, weight = pair[kept], found[kept], weight[kept]
    order = np.lexsort((-weight, pair))
    pair, found, weight = pair[order], found[order], weight[order] / np.bincount(pair, weight, count)[pair[order]]
    number = np.bincount(pair, minlength=count)
    column = np.arange(len(pair)) - (np.cumsum(number) - number)[pair]
    shape = count, max(number.max(initial=0), 1)
    angle, std, lean, share = (np.full((*shape, *more), np.nan) for more in ((), (), (2,), ()))
    angle[pair, column], std[pair, column], lean[pair, column] = found[:, 0], found[:, 1], found[:, 3:]
    share[...] = 0.0
    share[pair, column] = weight
    return Hypotheses(angle, std, share, lean)


HORIZON_COSINE = 0.1  # Cosine of the zenith angle within which rings count as at the camera's height
ROUNDS = 12  # Reweighted solutions: each is exact to second order, and each leaves more of the outliers out


def compare_at_horizon(
    first: np.ndarray, second: np.ndarray, angle: np.ndarray, lens: Lens, hidden: float = 0.0
) -> Hypotheses:
    """The likeliest hypothesis of each pair, fitted again to the rings nearest the horizon, for ``find_lean``.

    Polar images (P, rings, sectors, channels), of which an outermost part of the width ``hidden`` [rad] shows nothing,
    were taken before and after turns by angles (P,) [rad]; NaN where these are not known.
    """
    grid = make_grid(*first.shape[1:3], lens)
    cosine, last = grid.rays[:, :1, 2], np.cos(lens.half_angle - hidden)
    away = np.maximum(cosine, last) - max(float(last), 0.0)
    weight = grid.weight * np.exp(-((away / HORIZON_COSINE) ** 2)) * (cosine >= last)
    grid = replace(grid, weight=weight.astype(np.float32))

    def fit() -> Iterator[np.ndarray]:
        for start in range(0, len(angle), CHUNK):
            some = slice(start, start + CHUNK)
            known = np.isfinite(angle[some])
            one, two = take_spectra(first[some], grid), take_spectra(second[some], grid)
            fitted = fit_rotation(one, two, np.where(known, angle[some], 0.0), grid)
            found = np.column_stack([fitted.angle, fitted.std, known, fitted.lean])
            yield np.where(known[:, None], found, np.nan)

    found = np.concatenate([np.empty((0, 5)), *fit()])[:, None]
    return Hypotheses(found[..., 0], found[..., 1], np.nan_to_num(found[..., 2]), found[..., 3:])


def find_lean(hypotheses: Hypotheses) -> np.ndarray:
    """The lean common to all images (2,) [rad], to the robot's right and forward; NaN without any turn.

    Gauss-Newton on the relative lean that is left after correction: to first order l - Rot(-turn) l, with Rot in the
    plane. Cauchy weights, scaled by the median.
    """
    lean = np.zeros(2)
    for _ in range(ROUNDS):
        angle, left = _correct(hypotheses, lean)
        angle, left = angle[:, 0], left[:, 0]
        known = np.isfinite(angle)
        if not known.any():
            return np.full(2, np.nan)
        cos, sin = np.cos(angle[known]), np.sin(angle[known])
        # the lean as a rotation vector (right, ahead) in the robot's plane, seen from the second heading
        design = np.stack([np.stack([1.0 - cos, -sin], -1), np.stack([sin, 1.0 - cos], -1)], axis=1)
        square = (left[known] ** 2).sum(axis=1)
        weight = 1.0 / (1.0 + square / (np.median(square) + 1e-12))
        normal = np.einsum("p,pij,pik->jk", weight, design, design) + 1e-9 * np.eye(2)
        lean = lean + np.linalg.solve(normal, np.einsum("p,pij,pi->j", weight, design, left[known]))
    return lean


def _correct(hypotheses: Hypotheses, lean: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angle (P, K) and relative lean (P, K, 2) that are left of the rotations once the camera's lean is undone."""
    angle, relative = hypotheses.angle, hypotheses.lean
    c, s, zero = np.cos(angle), np.sin(angle), np.zeros_like(angle)
    turn = np.stack([c, -s, zero, s, c, zero, zero, zero, zero + 1.0], axis=-1).reshape(*angle.shape, 3, 3)
    level = tilt(np.asarray(lean, float))
    rotation = level @ turn @ swing(relative) @ level.T
    # Rz(angle) swing(left): the upper left corner has the angle, the last row the rest
    left_angle = np.arctan2(rotation[..., 1, 0] - rotation[..., 0, 1], rotation[..., 0, 0] + rotation[..., 1, 1])
    across = np.stack([rotation[..., 2, 1], -rotation[..., 2, 0]], axis=-1)
    size = np.linalg.norm(across, axis=-1, keepdims=True)
    tipped = np.arctan2(size, rotation[..., 2, 2, None])
    return left_angle, across * np.where(size > 0.0, tipped / np.maximum(size, 1e-30), 1.0)
