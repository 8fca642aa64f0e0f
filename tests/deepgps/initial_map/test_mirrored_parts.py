"""Parts that hang on the rest of a map by little: found, and turned over where that fits better."""

import numpy as np
import pytest
import torch

from deepgps.alignment import fit_alignment
from deepgps.data.segments import Segments
from deepgps.initial_map.dense import mirror_parts
from deepgps.initial_map.isomap import LoopClosures, find_loop_closures
from deepgps.initial_map.mirrored_parts import find_weak_parts, mirror
from deepgps.initial_map.pose_graph import relax

STEP_M = 0.1
LEFT, RIGHT = np.array([[-2.5, -1.0], [-0.5, 1.0]]), np.array([[0.5, -1.6], [2.0, 0.6]])


def drive(room: np.ndarray, count: int, rng: np.random.Generator) -> list[np.ndarray]:
    """Places along straight lines between places by chance in a room (2, 2)."""
    lines = lay(rng.uniform(room[0], room[1], (count, 2, 2)))
    return [line for line in lines if len(line) > 3]


def lay(ends: np.ndarray) -> list[np.ndarray]:
    """Places every step along straight lines, from their ends (n, 2, 2) [m]."""
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    ways = [np.arange(0.0, end, STEP_M)[:, None] / end for end in length]
    return [a + way * (b - a) for (a, b), way in zip(ends, ways, strict=True)]


def join(lines: list[np.ndarray]) -> tuple[np.ndarray, Segments, LoopClosures]:
    """Places (N, 2) of lines one after another, their segments, and loop closures of features that are the places."""
    place, longest = np.concatenate(lines), max(map(len, lines))
    count = torch.tensor([len(line) for line in lines])
    first = count.cumsum(0) - count
    along = torch.arange(longest)[None]
    valid = along < count[:, None]
    segments = Segments((first[:, None] + along) * valid, along * STEP_M * valid, count, 0)
    return place, segments, find_loop_closures(torch.from_numpy(place).float(), segments, (3,))[0]


@pytest.fixture(scope="module")
def flat() -> tuple[np.ndarray, Segments, LoopClosures]:
    """Two rooms and a passage of 30 cm between them, through which three lines lead, not quite side by side."""
    rng = np.random.default_rng(0)
    through = np.array([[[-1.0, 0.1], [1.2, -0.12]], [[-1.4, -0.1], [1.5, 0.1]], [[-0.9, 0.0], [1.0, 0.0]]])
    return join([*drive(LEFT, 120, rng), *drive(RIGHT, 90, rng), *lay(through)])


def wrong(found: np.ndarray, place: np.ndarray) -> float:
    """RMS distance after the best rigid move, mirrored or not [m]."""
    laid = fit_alignment(found, place, "E2").apply(found)
    return float(np.sqrt(((laid - place) ** 2).sum(axis=1).mean()))


def test_a_room_behind_a_narrow_passage_is_found(flat):
    place, segments, closures = flat
    (part,) = find_weak_parts(np.ones(len(place), bool), segments, closures)
    left, right = place[:, 0] < LEFT[1, 0] - 0.1, place[:, 0] > RIGHT[0, 0] + 0.1
    assert {(part[left].mean(), part[right].mean())} <= {(0.0, 1.0), (1.0, 0.0)}


def test_one_room_has_no_door():
    place, segments, closures = join(drive(LEFT, 150, np.random.default_rng(1)))
    assert find_weak_parts(np.ones(len(place), bool), segments, closures) == []


def test_what_is_mirrored_twice_is_as_it_was_and_keeps_its_distances(flat):
    place, segments, closures = flat
    (part,) = find_weak_parts(np.ones(len(place), bool), segments, closures)
    once = mirror(place, part, segments, closures)
    assert np.array_equal(once[~part], place[~part]) and np.abs(once[part] - place[part]).max() > 1.0
    inside = [np.linalg.norm(np.diff(some[part], axis=0), axis=1) for some in (once, place)]
    np.testing.assert_allclose(*inside, atol=1e-9)


@pytest.mark.parametrize("turn_rad", [0.0, 0.05])
def test_a_part_that_lies_the_wrong_way_round_is_turned_over(flat, turn_rad: float):
    place, segments, closures = flat
    (part,) = find_weak_parts(np.ones(len(place), bool), segments, closures)
    bent = mirror(place, part, segments, closures)
    cos, sin = np.cos(turn_rad), np.sin(turn_rad)
    bent[part] = bent[part] @ np.array([[cos, sin], [-sin, cos]])
    folded, cost = relax(bent, segments, closures, 4.0)
    assert wrong(folded, place) > 0.3
    assert wrong(mirror_parts(folded, cost, segments, closures), place) < 0.03


def test_a_right_map_stays_as_it_is(flat):
    place, segments, closures = flat
    right, cost = relax(place, segments, closures)
    assert np.array_equal(mirror_parts(right, cost, segments, closures), right)


def test_places_that_are_not_known_have_no_part_in_it(flat):
    place, segments, closures = flat
    placed = np.arange(len(place)) % 50 != 7
    parts = find_weak_parts(placed, segments, closures)
    assert parts and not any(part[~placed].any() for part in parts)
    lost = np.where(placed[:, None], place, np.nan)
    turned = mirror(lost, parts[0], segments, closures)
    assert np.array_equal(np.isfinite(turned).all(axis=1), placed)


def test_the_smallest_recordings_have_none():
    place, segments, closures = join(drive(LEFT, 4, np.random.default_rng(2)))
    assert find_weak_parts(np.ones(len(place), bool), segments, closures) == []
