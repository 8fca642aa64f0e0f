"""The map by compass: exact where nothing is wrong, straightened by loop closures, never pulled apart by false ones."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch

from deepgps.alignment import fit_alignment
from deepgps.data.compass_turns import CompassTurns
from deepgps.data.segments import Segments
from deepgps.initial_map.compass_map import CompassMap, find_compass_map
from deepgps.initial_map.isomap import LoopClosures

SPACING_M = 0.08
ROOM_M = np.array([4.0, 3.0])
ANGLE_STD, JUMP_STD = np.radians(0.5), 0.002


@dataclass(frozen=True)
class Drive:
    """A drive in a rectangle, segment by segment, as its encoders and its compass measure it."""

    place: np.ndarray
    segments: Segments
    turns: CompassTurns
    closures: LoopClosures


def drive(segments: int, seed: int = 0, noise: float = 0.0, lengths: float = 0.0) -> Drive:
    """Drive; turns are wrong by ``noise`` standard deviations, lengths by the fraction ``lengths``."""
    rng = np.random.default_rng(seed)
    here, heading, place, rows, headings = ROOM_M / 2, 0.0, [ROOM_M / 2], [], []
    while len(rows) < segments:
        heading = heading + rng.uniform(-np.pi, np.pi)
        axis = np.array([np.cos(heading), np.sin(heading)])
        steps = int(rng.integers(6, 30))
        points = here + SPACING_M * np.arange(1, steps + 1)[:, None] * axis
        if ((points < 0) | (points > ROOM_M)).any():
            continue
        rows.append(np.arange(len(place) - 1, len(place) + steps))
        headings.append(heading)
        place.extend(points)
        here = points[-1]
    longest = max(map(len, rows))
    index, distance = np.zeros((segments, longest), int), np.zeros((segments, longest))
    for number, row in enumerate(rows):
        index[number, : len(row)] = row
        scale = 1.0 + lengths * rng.standard_normal()
        distance[number, : len(row)] = SPACING_M * scale * np.arange(len(row))
    count = torch.tensor([len(row) for row in rows])
    table = Segments(torch.from_numpy(index), torch.from_numpy(distance).float(), count, 0)
    angle = np.diff(headings) + noise * ANGLE_STD * rng.standard_normal(segments - 1)
    between = segments - 1
    turns = CompassTurns(angle, np.full(between, ANGLE_STD), np.zeros((between, 2)), np.full(between, JUMP_STD))
    return Drive(np.array(place), table, turns, find_closures(np.array(place), rows))


def find_closures(place: np.ndarray, rows: list[np.ndarray]) -> LoopClosures:
    owner = np.full(len(place), -1)
    for number, row in enumerate(rows):
        owner[row] = number
    apart = np.linalg.norm(place[:, None] - place[None], axis=2)
    apart[np.abs(owner[:, None] - owner[None]) < 2] = np.inf
    nearest = apart.argmin(axis=1)
    first = np.flatnonzero((nearest[nearest] == np.arange(len(place))) & (apart.min(axis=1) < 0.1))
    return first, nearest[first], apart[first, nearest[first]]


def find_map(made: Drive, closures: LoopClosures, lengths: float = 0.0) -> CompassMap:
    spread, rng = np.full(len(made.segments.count), lengths), np.random.default_rng(0)
    return find_compass_map(made.segments, made.turns, closures, len(made.place), spread, rng)


def error(found: np.ndarray, place: np.ndarray) -> float:
    return float(np.sqrt(((fit_alignment(found, place, "SE2").apply(found) - place) ** 2).sum(axis=1).mean()))


NONE = (np.empty(0, int), np.empty(0, int), np.empty(0))


def test_exact_turns_and_lengths_give_the_exact_map():
    made = drive(60)
    assert error(find_map(made, NONE).places, made.place) < 1e-4
    assert error(find_map(made, made.closures).places, made.place) < 0.01


@pytest.mark.parametrize("seed", range(3))
def test_loop_closures_straighten_a_path_whose_compass_errs(seed: int):
    made = drive(150, seed, noise=1.0)
    alone, refined = find_map(made, NONE), find_map(made, made.closures)
    assert error(refined.places, made.place) < min(0.02, 0.4 * error(alone.places, made.place))
    assert refined.believed.mean() > 0.45, "each loop closure is listed in both orders, and one of them is used"


@pytest.mark.parametrize("seed", range(3))
def test_false_loop_closures_that_the_covariance_excludes_change_nothing(seed: int):
    made, rng = drive(150, seed, noise=1.0), np.random.default_rng(seed)
    first, second = rng.integers(0, len(made.place), (2, 600))
    false = np.linalg.norm(made.place[first] - made.place[second], axis=1) > 1.0
    added = (first[false], second[false], np.full(false.sum(), 0.03))
    both = tuple(np.concatenate(pair) for pair in zip(made.closures, added, strict=True))
    found = find_map(made, (both[0], both[1], both[2]))
    assert not found.believed[len(made.closures[0]) :].any()
    assert error(found.places, made.place) < 0.02


def test_free_lengths_are_mended_and_the_map_does_not_shrink():
    made = drive(200, noise=1.0, lengths=0.1)
    rigid, free = find_map(made, made.closures), find_map(made, made.closures, lengths=0.1)
    assert error(free.places, made.place) < 0.5 * error(rigid.places, made.place)
    size = [np.sqrt(((place - place.mean(axis=0)) ** 2).sum()) for place in (free.places, made.place)]
    assert size[0] == pytest.approx(size[1], rel=0.03)


@pytest.mark.parametrize("scale", [1 / 3, 3.0])
def test_covariances_that_are_three_times_too_small_or_large_hardly_change_the_map(scale: float):
    made = drive(150, noise=1.0)
    turns = replace(made.turns, angle_std=scale * made.turns.angle_std, jump_std=scale * made.turns.jump_std)
    right, other = find_map(made, made.closures), find_map(replace(made, turns=turns), made.closures)
    assert error(other.places, made.place) < 1.5 * error(right.places, made.place) + 0.005


def test_without_loop_closures_errors_are_as_large_as_their_standard_deviations():
    ratios = []
    for seed in range(30):
        made = drive(40, seed, noise=1.0)
        found = find_map(made, NONE)
        start = made.segments.index[0, :2].numpy()
        begin, ahead = made.place[start[0]], made.place[start[1]] - made.place[start[0]]
        axis = ahead / np.linalg.norm(ahead)
        true = (made.place - begin) @ np.array([[axis[0], -axis[1]], [axis[1], axis[0]]])
        ratios.append((((found.places - true) / found.std[:, None]) ** 2)[-1].mean())
    assert 0.5 < np.mean(ratios) < 2.0
