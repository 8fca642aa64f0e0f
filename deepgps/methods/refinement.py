"""Better maps: images registered on those of other segments tell where they lie relative to these."""

from collections.abc import Callable
from typing import NamedTuple, TypeVar

import numpy as np

from deepgps.data.segments import find_owners
from deepgps.initial_map.compass.compass_map import CompassMap
from deepgps.initial_map.compass.factors import Factors
from deepgps.learning.training_data import TrainingData
from deepgps.methods.appearance import CHUNK, find_trace, learn, leave_out
from deepgps.positioner.kriging import choose_neighbours, krige
from deepgps.positioner.pixels import grey
from deepgps.positioner.registration import fuse
from sim.errors import InputError

ROUNDS, FACTORS, HELD_OUT_FACTORS = 2, 4000, 8
"""Times that a map is refined, images that are registered, at most, and of how many one checks the map."""


class DistanceMap(NamedTuple):
    """Positions (N, 2) [m] and headings (N,) [rad] of observations; NaN: unknown."""

    places: np.ndarray
    heading: np.ndarray


AnyMap = TypeVar("AnyMap", CompassMap, DistanceMap)


def refine_map(
    data: TrainingData,
    found: AnyMap,
    choose: Callable[[AnyMap], np.ndarray],
    move: Callable[[AnyMap, Factors], AnyMap],
) -> AnyMap:
    """The map ``found`` with registrations of its images on one another, as long as it predicts held-out ones better.

    It is learned from the positions that ``choose`` returns (N, 2) [m]; all others are NaN. ``move`` returns the map
    moved to where registrations say, too.
    """
    checks, error = None, np.inf
    for number in range(ROUNDS):
        try:
            factors = find_factors(data, choose(found), found.heading, slice(number, None, ROUNDS), FACTORS)
        except InputError:
            break
        if checks is None:
            held_out = np.arange(len(factors.one)) % HELD_OUT_FACTORS == 0
            factors, checks = factors.take(~held_out), factors.take(held_out)
            error = measure_error(checks, found)
        better = move(found, factors)
        if not measure_error(checks, better) < error:
            break
        found = better
    return found


def measure_error(factors: Factors, found: CompassMap | DistanceMap) -> float:
    """Median distance of observations from where the factors predict them on a map [m]; NaN where there are none."""
    return float(np.nanmedian(np.linalg.norm(factors.compare(found.places), axis=1)))


def find_factors(data: TrainingData, places: np.ndarray, heading: np.ndarray, every: slice, count: int) -> Factors:
    """Registrations of ``every`` such observation, at most ``count``, on those of other segments; see ``learn``."""
    appearance, index = learn(data, places, heading)
    known = appearance.registration
    first, last = (owner.numpy()[index] for owner in find_owners(data.segments, len(places)))
    around = choose_neighbours(known.pixels is not None)
    sample, others = leave_out(known.places, first, last, np.arange(len(index))[every], count, around)
    position, covariance = np.empty((len(sample), 2)), np.empty((len(sample), 2, 2))
    for part in np.array_split(np.arange(len(sample)), -(-len(sample) // CHUNK)):
        there = known.places[sample[part]]
        match = known.match(known.known[sample[part]], there, index=others[part])
        position[part], covariance[part] = match.position, known.calibration.features * match.covariance
        if known.pixels is not None:
            images = grey(data.observation[index[sample[part]]])
            found = known.pixels.register(images, there, known.tree, known.kernel, others[part])
            of_pixels = known.calibration.pixels * found.covariance[:, :2, :2]
            position[part], covariance[part] = fuse(position[part], covariance[part], found.position, of_pixels)
    weight = krige(position, known.places, others, known.kernel).both[:, 0]
    offset = position - np.einsum("nk,nkd->nd", weight, known.places[others])
    return Factors(index[sample], index[others], weight, offset, find_trace(covariance) / 2.0)
