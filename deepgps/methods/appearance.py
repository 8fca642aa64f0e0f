"""Learning what is seen where: the features and pixels of images with positions on a map, for registration.

No step of training: features are whitened by what their neighbours do not predict. Errors are calibrated on images of
which the own segments are left out.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch

from deepgps.data.features import Features
from deepgps.data.segments import find_held_out, find_owners, spread_evenly
from deepgps.learning.training_data import TrainingData
from deepgps.positioner.appearance import AppearanceMap
from deepgps.positioner.kriging import KERNELS, Kernel, choose_kernel, choose_neighbours, find_others, krige
from deepgps.positioner.pixels import KnownPixels, grey, turn
from deepgps.positioner.registration import LEVELS, Calibration, Registration, fuse, inflate
from sim.errors import InputError
from sim.geometry import wrap

CHUNK = 64
NOISE_IMAGES, CALIBRATION_IMAGES = 3000, 1500
"""Images without their own segments from which the noise is learned, and on which errors are calibrated, at most."""
TRIAL_IMAGES, ROUNDING_M = 600, 0.001
"""Images on which kernels are tried; a distance to their positions that does not matter [m]."""
MIN_CALIBRATION_IMAGES = 50  # With fewer on segments held out, all are calibrated on
TRUSTED_SHARE, SHRINKAGE = 0.95, 0.1
"""Share of the smallest errors from which the noise is learned; weight of its diagonal alone."""
MIN_NOISE = 0.1  # Least noise of a ring, over the mean of all
HEADING_ROUNDS, REFINED_NOISE = 4, 0.99  # Rounds that refine headings, while the pixels' noise falls below this share
USUAL_SHARE = 0.98  # Share of the left-out images whose distance between two answers is usual
LIKE_SHARE, MARGIN = 0.99, 4.0
"""An image is unlike others if it exceeds this share of the left-out images by this factor."""
RADIUS_MARGIN = 1.3
"""Radii of new images over those of left-out ones: fewer new ones have training images on all sides."""
NORMAL_MEDIAN = np.log(2.0)  # Median of the squared length of a normal vector in the plane, over its mean
UNCALIBRATED = Calibration(1.0, 1.0, 1.0, np.inf, np.inf, 1.0, (1.0, 1.0), 1.0, 0.0, 0.0)


def learn(
    data: TrainingData, places: np.ndarray, heading: np.ndarray, std: np.ndarray | None = None
) -> tuple[AppearanceMap, np.ndarray]:
    """Learn what is seen where; return the map, and the numbers (n,) of the observations on it.

    Positions of all on the map are (N, 2) [m], with standard deviations along one axis (N,) [m] if they are known,
    and headings (N,) [rad]; NaN: unknown. Raises InputError if none has a position and others, of other segments,
    around it.
    """
    placed, directed = np.isfinite(places[:, 0]), np.isfinite(heading)
    has_pixels = data.observation.ndim == 4 and bool((placed & directed).any())
    index = np.flatnonzero(placed & directed if has_pixels else placed)
    places, heading = places[index], heading[index]
    first, last = (owner.numpy()[index] for owner in find_owners(data.segments, len(placed)))
    fresh = find_held_out(data.segments, len(placed)).numpy()[index]  # features were not fitted to these
    around = choose_neighbours(has_pixels)
    left_out = leave_out(places, first, last, np.flatnonzero(~fresh), NOISE_IMAGES, around)
    if not len(left_out.sample):
        raise InputError("too few segments pass one another, so what is seen between them cannot be predicted")
    checked = leave_out(places, first, last, np.flatnonzero(fresh), CALIBRATION_IMAGES, around)
    if len(checked.sample) < MIN_CALIBRATION_IMAGES:
        checked = left_out
    features, kernel, projection = whiten(data, index, places, left_out)
    std = np.zeros(len(index)) if std is None else std[index]
    known = Registration(features, places, std, kernel, UNCALIBRATED)
    if has_pixels:
        small = np.concatenate([grey(data.observation[part]) for part in np.array_split(index, -(-len(index) // 500))])
        known = learn_pixels(known, small, heading, left_out)
        everyone = leave_out(places, first, last, np.arange(len(index)), len(index), around)
        for _ in range(HEADING_ROUNDS):
            refined = refine_headings(known, small, heading, first, everyone)
            again = learn_pixels(known, small, refined, left_out, (known.chirality,))
            assert again.pixels is not None and known.pixels is not None
            if again.pixels.noise.sum() > REFINED_NOISE * known.pixels.noise.sum():
                break
            known, heading = again, refined
    known = replace(known, kernel=choose_kernel_by_errors(known, left_out))
    images = data.observation[index[checked.sample]]
    known = replace(known, calibration=calibrate(known, images, heading[checked.sample], checked))
    return AppearanceMap(projection, known), index


class LeftOut(NamedTuple):
    """Observations that are predicted without their own segments."""

    sample: np.ndarray  # Their numbers (n,)
    others: np.ndarray  # The nearest of other segments (n, k)

    def take_trial(self) -> "LeftOut":
        """Those on which kernels are tried."""
        return LeftOut(*(part[:: -(-len(self.sample) // TRIAL_IMAGES)] for part in self))


def leave_out(
    places: np.ndarray, first: np.ndarray, last: np.ndarray, rows: np.ndarray, count: int, around: int
) -> LeftOut:
    """At most ``count`` of the observations ``rows`` (n,), each with ``around`` others; see ``find_others``."""
    sample = rows[spread_evenly(len(rows)).numpy() < count / max(1, len(rows))]
    others, enough = find_others(places, first, last, sample, around)
    return LeftOut(sample[enough], others[enough])


def whiten(
    data: TrainingData, index: np.ndarray, places: np.ndarray, left_out: LeftOut
) -> tuple[np.ndarray, Kernel, Features]:
    """Features of observations ``index`` (n,) such that errors of prediction are white, their kernel and projection."""
    sample, others = left_out
    features = data.features.numpy()[index]
    kernel = choose_kernel(places, features, *left_out.take_trial())
    weights = krige(places[sample], places, others, kernel)
    error = (features[sample] - weights.predict(features)[:, 0]) / np.sqrt(weights.variance)[:, None]
    size = np.square(error).sum(axis=1)
    error = error[size <= np.quantile(size, TRUSTED_SHARE)].astype(float)
    noise = error.T @ error / len(error)
    diagonal = noise.diagonal() + 1e-9 * noise.diagonal().mean()
    noise = (1.0 - SHRINKAGE) * noise + SHRINKAGE * np.diag(diagonal)
    white = np.linalg.inv(np.linalg.cholesky(noise)).T.astype(np.float32)
    basis = data.projection.basis @ torch.from_numpy(white)
    return features @ white, kernel, replace(data.projection, basis=basis)


def learn_pixels(
    known: Registration,
    images: np.ndarray,
    heading: np.ndarray,
    left_out: LeftOut,
    chiralities: Sequence[int] = (1, -1),
) -> Registration:
    """The registration with the pixels of grey images (n, R, S), seen with headings (n,) [rad].

    Of the map's chiralities, that is taken with which images side by side agree better.
    """
    weights = krige(known.places[left_out.sample], known.places, left_out.others, known.kernel)
    found = []
    for chirality in chiralities:
        turned = np.empty(images.shape, np.uint8)
        for part in np.array_split(np.arange(len(images)), -(-len(images) // 500)):
            angle = chirality * (heading[part] - heading[0])
            turned[part] = np.rint(turn(images[part].astype(float), angle)[0]).clip(0, 255)  # rounds alike in any frame
        flat = turned.reshape(len(turned), -1)
        error = np.abs(flat[left_out.sample] - weights.predict(flat)[:, 0])
        noise = 1.4826 * np.median(error, axis=0).reshape(images.shape[1:])
        noise = np.sqrt(np.square(noise).mean(axis=1))
        noise = np.maximum(noise, MIN_NOISE * noise.mean() + 1e-3)
        found.append((KnownPixels(turned, noise, float(chirality * heading[0])), chirality))
    pixels, chirality = min(found, key=lambda pair: pair[0].noise.sum())
    return replace(known, pixels=pixels, chirality=chirality)


def refine_headings(
    known: Registration, images: np.ndarray, heading: np.ndarray, segment: np.ndarray, left_out: LeftOut
) -> np.ndarray:
    """Headings (n,) [rad] of grey images (n, R, S), each segment turned to agree with the others around it.

    The turn is the median over its images, which are registered by their pixels on those of other segments.
    """
    assert known.pixels is not None
    heading, off = heading.copy(), np.full(len(heading), np.nan)
    for part in np.array_split(np.arange(len(left_out.sample)), -(-len(heading) // CHUNK)):
        rows, others = left_out.sample[part], left_out.others[part]
        found = known.pixels.register(images[rows], known.places[rows], known.tree, known.kernel, others)
        off[rows] = wrap(known.chirality * found.yaw - heading[rows])
    for own in np.split(np.arange(len(heading)), np.flatnonzero(np.diff(segment)) + 1):
        if np.isfinite(off[own]).any():
            heading[own] += np.nanmedian(off[own])
    return heading


def choose_kernel_by_errors(known: Registration, left_out: LeftOut) -> Kernel:
    """The kernel with which left-out observations are registered nearest to their positions, by the geometric mean."""
    sample, others = left_out.take_trial()
    place = known.places[sample]

    def find_cost(kernel: Kernel) -> float:
        match = replace(known, kernel=kernel).match(known.known[sample], place, index=others)
        return float(np.log(np.square(match.position - place).sum(axis=1) + ROUNDING_M**2).mean())

    return min(KERNELS, key=find_cost)


def calibrate(known: Registration, images: np.ndarray, heading: np.ndarray, left_out: LeftOut) -> Calibration:
    """What registrations of the observations left out (n, ...), with headings (n,) [rad], tell of the errors."""
    sample, others = left_out
    place = known.places[sample]
    match = known.match(known.known[sample], place, index=others)
    unlike = match.residual / match.variance
    low, usual = np.maximum(np.quantile(unlike, [0.1, 0.5]), 1e-12)
    components = 2.0 / (max(np.log(usual / low), 0.01) / 1.2816) ** 2  # as of a chi-squared variable
    features = _find_factor(match.position - place, match.covariance)
    position, covariance, light = match.position, features * match.covariance, 0.0
    pixels, yaw, pixels_limit = 0.0, 1.0, 1.0
    if known.pixels is not None:
        found = known.pixels.register(grey(images), place, known.tree, known.kernel, others)
        pixels = _find_factor(found.position - place, found.covariance[:, :2, :2])
        pixels_limit = _find_limit(found.spread**2 / found.variance)
        off = np.abs(wrap(known.chirality * found.yaw - heading)) / np.sqrt(found.covariance[:, 2, 2])
        yaw = float(np.quantile(off, 0.68))
        light = float(np.quantile(np.abs(np.log(np.maximum(found.gain, 1e-3))), LIKE_SHARE))
        position, covariance = fuse(position, covariance, found.position, pixels * found.covariance[:, :2, :2])
    away, size = np.linalg.norm(position - place, axis=1), np.sqrt(find_trace(covariance) * inflate(unlike / usual))
    small, large = (RADIUS_MARGIN * float(np.quantile(away / size, level)) for level in LEVELS)
    limits, distances = (_find_limit(unlike), pixels_limit), np.quantile(away, (USUAL_SHARE, LEVELS[0])).tolist()
    return Calibration(
        features, pixels, float(usual), *limits, float(components), (small, large), yaw, light, *distances
    )


def _find_limit(unlike: np.ndarray) -> float:
    return MARGIN * float(np.quantile(unlike, LIKE_SHARE))


def _find_factor(error: np.ndarray, covariance: np.ndarray) -> float:
    return float(np.median(np.square(error).sum(axis=1) / find_trace(covariance)) / NORMAL_MEDIAN)


def find_trace(covariance: np.ndarray) -> np.ndarray:
    """Traces (n,) of covariances (n, 2, 2), which are positive."""
    return np.maximum(np.trace(covariance, axis1=1, axis2=2), 1e-12)
