"""Positions by registration: the place of the map from which an image like this one is the likeliest to be seen.

This is appearance-map registration by maximum likelihood (Huhle et al., IROS 2010, with Gaussian processes). The
features of the training images, whitened by the errors of their prediction, are kriged to any position. Gauss-Newton
starts at the places of the images most alike, at several where these are apart, and the pixels refine what it finds.

The noise of one image is unknown: integrated out with Jeffreys' prior, the likelihood of a position is
``|r|^-D``, with the residual r and D independent components. That of the pixels counts half.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from deepgps.positioner.kriging import Kernel, Surroundings, choose_neighbours, compare, find_nearest, limit
from deepgps.positioner.pixels import KnownPixels

CANDIDATES, STARTS, START_DISTANCE_M = 128, 8, 0.4  # Images most alike, starts among these, distance of two [m]
ROUNDS, SHARED_ROUNDS, STEP_M = 6, 2, 0.15  # Rounds from each start, with the same places, largest step of one [m]
START_FEATURES = 96  # Features, the slowest, by which images are alike; other observations are by all
LEAST_SLOPE = 1e-7  # Least eigenvalue of the derivatives' products, over the mean of both
MODES, MODE_DISTANCE_M = 5, 0.5  # Modes that are kept, and the distance between two [m]
PIXEL_MARGIN, CLEAR_MARGIN = 1.4, 1.0
"""Modes whose cost exceeds the best by less than this are compared by pixels, too; if by less than this, none is sure.

The cost is minus twice the logarithm of the likelihood, over the number of independent components.
"""
MAX_INFLATION = 16.0
"""Largest factor of the covariance of an image that differs more than usual from those around it.

The factor is the square of the residual over its median: where surfaces line up with the pixels, or things have moved,
errors of all features have one cause, and do not average out.
"""
MAX_DIFFERENCE_M = 0.05  # Distance between two answers, as of features and pixels, up to which they are accepted [m]
LEVELS = (0.68, 0.95)  # Probabilities with which the radii hold the true position
REASONS = ("accepted", "unlike", "ambiguous", "contradicting")
"""Reasons, by number: the image is unlike all others near its place; two places look alike; both answers differ."""


class Match(NamedTuple):
    """Registrations of n images by features."""

    position: np.ndarray  # (n, 2) [m]
    residual: np.ndarray  # Squared residual (n,)
    variance: np.ndarray  # Of the prediction, relative (n,)
    covariance: np.ndarray  # Of the position, but for a common factor (n, 2, 2)


@dataclass(frozen=True)
class Registered:
    """Where B images were taken."""

    position: np.ndarray  # Of the camera (B, 2) [m]
    yaw: np.ndarray  # Of the robot (B,) [rad]; NaN where pixels are not compared
    covariance: np.ndarray  # Of the position (B, 2, 2) [m^2]
    yaw_std: np.ndarray  # (B,) [rad]
    mode: np.ndarray  # Positions that are as good or nearly, the best first (B, MODES, 2) [m]; NaN: there is none
    mode_yaw: np.ndarray  # Yaw of the robot there (B, MODES) [rad]; NaN where pixels are not compared
    weight: np.ndarray  # Probability of each (B, MODES)
    reason: np.ndarray  # Number in ``REASONS`` (B,)
    near: np.ndarray  # Nearest training image (B,)
    unlike_features: np.ndarray  # Squared residual of the features over the largest that is usual (B,)
    # By the pixels (B,), NaN where none are compared:
    unlike_pixels: np.ndarray  # Squared residual of most pixels over the largest that is usual
    gain: np.ndarray  # Brightness over that of the training images

    @property
    def unlike(self) -> np.ndarray:
        """The smaller of both residuals (B,): what is hidden spoils the features, and few pixels."""
        return np.fmin(self.unlike_features, self.unlike_pixels)

    def move(self, position: np.ndarray, usual_m: float = 0.0) -> "Registered":
        """What this says of other positions (B, 2) [m] for the same images.

        The covariance is the second moment of the true position about them. Those are refused that are farther away
        than is usual.
        """
        away = position - self.position
        far = (self.reason == 0) & (np.linalg.norm(away, axis=1) > max(MAX_DIFFERENCE_M, usual_m))
        covariance = self.covariance + away[:, :, None] * away[:, None]
        reason = np.where(far, REASONS.index("contradicting"), self.reason)
        return replace(self, position=position, covariance=covariance, reason=reason)


@dataclass(frozen=True)
class Calibration:
    """What left-out segments say of the errors."""

    features: float  # Factor of the features' covariances
    pixels: float  # Factor of the pixels' covariances; 0: none are compared
    features_usual: float  # Median of the squared residual of features over its variance
    features_limit: float  # Largest such residual that is usual
    pixels_limit: float  # Largest squared spread of pixels over its variance that is usual
    components: float  # Independent components of the features
    radius: tuple[float, float]  # Radii of 68 and 95 %, over the root of the covariance's trace
    yaw: float  # Standard deviation of the yaw over that by the pixels alone
    light: float  # Largest usual change of the logarithm of the brightness; 0 without pixels
    difference: float  # Largest usual distance of a left-out image from its position on the map [m]


@dataclass(frozen=True)
class Registration:
    """Training images with their positions on the map, on which others are registered."""

    known: np.ndarray  # Their whitened features (N, K) float32
    places: np.ndarray  # Their positions (N, 2) [m]
    place_std: np.ndarray  # Standard deviation of each along one axis (N,) [m]
    kernel: Kernel
    calibration: Calibration
    pixels: KnownPixels | None = None  # None: observations are no polar images, or no headings are known
    chirality: int = 1  # -1 where the map is mirrored

    def find_radii(self, found: Registered) -> np.ndarray:
        """Radii (B, 2) [m] that hold the true positions with probabilities of 68 and 95 %."""
        size = np.sqrt(np.trace(found.covariance, axis1=1, axis2=2))
        of_map = self.place_std[found.near, None] * find_normal_radius(np.array(LEVELS))
        return np.hypot(size[:, None] * self.calibration.radius, of_map)

    def match(
        self, features: np.ndarray, start: np.ndarray, rounds: int = ROUNDS, index: np.ndarray | None = None
    ) -> Match:
        """Register features (n, K) from positions (n, 2) [m].

        They are predicted from the nearest training images, or from those with numbers ``index`` (n, k).
        """
        position, eye = start.copy(), np.eye(2)
        count = choose_neighbours(self.pixels is not None)
        for step in range(rounds + 1):
            if step == 0 or (index is None and step % SHARED_ROUNDS == 0 and step < rounds):
                near = find_nearest(self.tree, position, count)[1] if index is None else index
                around = Surroundings.find(self.places, near, self.kernel)
                products = compare(self.known, features, near)
            weights = around.krige(position)
            product = weights.both @ products @ np.swapaxes(weights.both, 1, 2)  # of minus the residual and derivatives
            slopes = product[:, 1:, 1:]
            mean, half = (slopes[:, 0, 0] + slopes[:, 1, 1]) / 2.0, (slopes[:, 0, 0] - slopes[:, 1, 1]) / 2.0
            least = mean - np.hypot(half, slopes[:, 0, 1])  # eigenvalue, which rounding may leave below zero
            lift = np.maximum(LEAST_SLOPE * np.abs(mean) + 1e-9 - least, 1e-9)
            inverse = np.linalg.inv(slopes + lift[:, None, None] * eye)
            if step < rounds:
                position -= limit((inverse @ product[:, 1:, :1])[..., 0], STEP_M)
        squared = np.maximum(product[:, 0, 0], 1e-6)
        return Match(position, squared, weights.variance, squared[:, None, None] * inverse)

    def find_starts(self, features: np.ndarray) -> np.ndarray:
        """Training images (B, STARTS) that look most like features (B, K), apart from one another."""
        known, squares = self._slowest
        apart = squares - (2.0 * features[:, : known.shape[1]]) @ known.T
        count, rows = min(CANDIDATES, len(known)), np.arange(len(apart))[:, None]
        near = np.argpartition(apart, count - 1, axis=1)[:, :count]
        near = near[rows, np.argsort(apart[rows, near], axis=1)]
        return near[rows, thin(self.places[near], STARTS, START_DISTANCE_M)]

    def register(self, features: np.ndarray, images: np.ndarray) -> Registered:
        """Register observations by their whitened features (B, K), and grey images (B, R, S) if pixels are known."""
        calibration, modes = self.calibration, self._find_modes(features)
        count, rows = len(modes.residual), np.arange(len(modes.residual))
        cost, position = np.log(modes.residual), modes.position.copy()
        covariance = calibration.features * modes.covariance
        yaw, yaw_std, unlike_pixels, gain = np.full((4, *cost.shape), np.nan)
        differ, residual = np.zeros(cost.shape), modes.residual / modes.variance
        if self.pixels is not None and count:
            close = np.nonzero(cost < cost[:, :1] + PIXEL_MARGIN)
            found = self.pixels.register(images[close[0]], modes.position[close], self.tree, self.kernel)
            of_pixels = calibration.pixels * found.covariance[:, :2, :2]
            differ[close] = np.hypot(*(found.position - modes.position[close]).T)
            position[close], covariance[close] = fuse(position[close], covariance[close], found.position, of_pixels)
            yaw[close] = np.angle(np.exp(1j * self.chirality * found.yaw))
            yaw_std[close] = calibration.yaw * np.sqrt(found.covariance[:, 2, 2])
            unlike_pixels[close] = found.spread**2 / found.variance / calibration.pixels_limit
            gain[close] = found.gain
            with_pixels = np.full(cost.shape, np.inf)
            with_pixels[close] = cost[close] + np.log(found.spread)
            cost = with_pixels
        order = (rows[:, None], np.argsort(cost, axis=1, kind="stable"))
        cost, best = cost[order], order[1][:, 0]
        weight = np.exp(calibration.components / 2.0 * (cost[:, :1] - cost))
        ambiguous = (cost[:, 1:] < cost[:, :1] + CLEAR_MARGIN).any(axis=1)
        covariance *= inflate(residual / calibration.features_usual)[..., None, None]
        unlike_features = residual / calibration.features_limit
        unlike = np.fmin(unlike_features, unlike_pixels)[rows, best]
        conditions = (unlike > 1.0, ambiguous, differ[rows, best] > MAX_DIFFERENCE_M)
        place = position[rows, best]
        return Registered(
            place,
            yaw[rows, best],
            covariance[rows, best],
            yaw_std[rows, best],
            np.where(np.isfinite(cost)[..., None], position[order], np.nan),
            yaw[order],
            weight / weight.sum(axis=1, keepdims=True),
            np.select(conditions, list(range(1, len(REASONS))), 0),
            find_nearest(self.tree, place, 1)[1][:, 0],
            unlike_features[rows, best],
            unlike_pixels[rows, best],
            gain[rows, best],
        )

    def _find_modes(self, features: np.ndarray) -> Match:
        """The best positions of features (B, K), as parts (B, MODES, ...); an infinite residual where there is none."""
        start = self.places[self.find_starts(features)]
        shape = start.shape[:2]
        found = self.match(np.repeat(features, shape[1], axis=0), start.reshape(-1, 2))
        order = np.argsort(found.residual.reshape(shape), axis=1, kind="stable")
        order += shape[1] * np.arange(shape[0])[:, None]
        chosen = thin(found.position[order], MODES, MODE_DISTANCE_M)
        again = np.diff(chosen, axis=1, prepend=-1) <= 0  # ``thin`` repeats the first where there are no more
        modes = Match(*(part[np.take_along_axis(order, chosen, axis=1)] for part in found))
        modes.residual[again], modes.position[again] = np.inf, np.nan
        return modes

    @cached_property
    def tree(self) -> KDTree:
        """The places, for queries."""
        return KDTree(self.places)

    @cached_property
    def _slowest(self) -> tuple[np.ndarray, np.ndarray]:
        known = self.known if self.pixels is None else np.ascontiguousarray(self.known[:, :START_FEATURES])
        return known, np.square(known).sum(axis=1)


def thin(places: np.ndarray, count: int, apart_m: float) -> np.ndarray:
    """Of places (B, n, 2) [m], the first and those after it that are apart from all chosen, as indices (B, count).

    Where there are fewer, the first again.
    """
    rows, free = np.arange(len(places)), np.ones(places.shape[:2], bool)
    chosen = np.zeros((len(places), min(count, places.shape[1])), int)
    for number in range(chosen.shape[1]):
        chosen[:, number] = free.argmax(axis=1)
        away = places - places[rows, chosen[:, number]][:, None]
        free &= np.hypot(away[..., 0], away[..., 1]) > apart_m
    return chosen


def fuse(
    one: np.ndarray, one_cov: np.ndarray, other: np.ndarray, other_cov: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Mean of two positions (n, 2), weighted by their covariances (n, 2, 2), and its covariance."""
    least = 1e-12 * np.eye(2)
    first, second = np.linalg.inv(one_cov + least), np.linalg.inv(other_cov + least)
    covariance = np.linalg.inv(first + second)
    sum_ = np.einsum("nij,nj->ni", first, one) + np.einsum("nij,nj->ni", second, other)
    return np.einsum("nij,nj->ni", covariance, sum_), covariance


def inflate(residual: np.ndarray) -> np.ndarray:
    """Factors of the covariances of images by their squared residuals of features, over the usual one."""
    return np.minimum(residual**2, MAX_INFLATION)


def find_normal_radius(probability: float | np.ndarray) -> np.ndarray:
    """Radius within which a vector in the plane lies with a probability, in standard deviations along one axis."""
    return np.sqrt(-2.0 * np.log1p(-probability))


def subtract_mount(camera: np.ndarray, yaw: np.ndarray, mount: tuple[float, float], mirrored: bool) -> np.ndarray:
    """Positions of the axle (B, 2) [m] by those of the camera and the yaw (B,) [rad]; where it is NaN, the same.

    The camera is ``mount`` ahead of the axle and to its left [m].
    """
    ahead, left = mount[0], -mount[1] if mirrored else mount[1]
    cos, sin = np.cos(yaw), np.sin(yaw)
    return camera - np.nan_to_num(np.stack([cos * ahead - sin * left, sin * ahead + cos * left], axis=1))
