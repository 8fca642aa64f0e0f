"""Rough maps by straightness: exact where bars cross, whatever the room's shape, and none where they do not."""

import itertools

import numpy as np
import pytest
import torch

from deepgps.data.segments import Segments
from deepgps.initial_map.distances.dense import find_affine_maps, find_modes, find_plane
from deepgps.initial_map.distances.isomap import LoopClosures, map_by_paths
from deepgps.initial_map.distances.pose_graph import build_pose_graph, relax
from sim.alignment import fit_alignment

Crossed = tuple[np.ndarray, Segments, LoopClosures]


def cross(ends: np.ndarray) -> Crossed:
    """Segments between ends (n, 2, 2) [m], with a reading and an exact loop closure wherever two of them cross."""
    ahead = ends[:, 1] - ends[:, 0]
    at: list[list[tuple[float, int]]] = [[] for _ in ends]
    for number, (i, j) in enumerate(itertools.combinations(range(len(ends)), 2)):
        ways = np.linalg.solve(np.stack([ahead[i], -ahead[j]], axis=1), ends[j, 0] - ends[i, 0])
        if (np.abs(ways - 0.5) < 0.5).all():
            at[i].append((ways[0], number))
            at[j].append((ways[1], number))
    lines = [(row, sorted(some)) for row, some in enumerate(at) if len(some) >= 2]
    count = torch.tensor([len(some) for _, some in lines])
    index, distance = (torch.zeros(len(lines), int(count.max()), dtype=kind) for kind in (torch.int64, torch.float64))
    place, crossing = [], []
    for line, (row, some) in enumerate(lines):
        way = np.array([way for way, _ in some])
        index[line, : len(some)] = torch.arange(len(some)) + len(place)
        distance[line, : len(some)] = torch.from_numpy((way - way[0]) * np.linalg.norm(ahead[row]))
        place += list(ends[row, 0] + way[:, None] * ahead[row])
        crossing += [number for _, number in some]
    order = np.argsort(crossing, kind="stable")
    same = np.flatnonzero(np.diff(np.array(crossing)[order]) == 0)
    a, b = order[same], order[same + 1]
    closures = np.concatenate([a, b]), np.concatenate([b, a]), np.zeros(2 * len(a))
    return np.array(place), Segments(index, distance, count, 0), closures


def draw(low: tuple[float, float], high: tuple[float, float], count: int, rng: np.random.Generator) -> np.ndarray:
    """Ends (n, 2, 2) of lines between random places in a rectangle."""
    return rng.uniform(low, high, (count, 2, 2))


def keep_off_pillar(ends: np.ndarray) -> np.ndarray:
    """Lines that keep 0.8 m away from the middle, so that every path around it is a detour."""
    along = np.linspace(0.0, 1.0, 50)[:, None]
    return np.array([one for one in ends if np.abs(one[0] + along * (one[1] - one[0])).max(axis=1).min() > 0.8])


def rms(found: np.ndarray, place: np.ndarray) -> float:
    """RMS distance after the best rigid motion, mirrored or not, where the map is known [m]."""
    known = np.isfinite(found).all(axis=1)
    laid = fit_alignment(found[known], place[known], "E2").apply(found[known])
    return float(np.sqrt(((laid - place[known]) ** 2).sum(axis=1).mean()))


@pytest.fixture(scope="module")
def pillar() -> Crossed:
    return cross(keep_off_pillar(draw((-2.0, -2.0), (2.0, 2.0), 250, np.random.default_rng(1))))


def test_exact_crossings_give_the_exact_map_where_shortest_paths_are_detours(pillar: Crossed):
    place, segments, closures = pillar
    by_paths = map_by_paths(len(place), segments, closures, torch.Generator().manual_seed(0))
    first = next(find_affine_maps(len(place), segments, closures))
    assert rms(by_paths, place) > 0.1
    assert rms(first, place) < 1e-5
    assert np.isfinite(first).all()


def test_the_two_slowest_modes_are_the_coordinates_up_to_an_affine_map(pillar: Crossed):
    place, segments, closures = pillar
    graph = build_pose_graph(segments, closures, np.ones(len(place), bool))
    middle, slope, firm = find_modes(graph, np.ones(len(graph.a)))
    modes = middle[graph.bar, :2] + graph.along[:, None] * slope[graph.bar, :2]
    design = np.column_stack([place[graph.observation], np.ones(len(modes))])
    left = modes - design @ np.linalg.lstsq(design, modes, rcond=None)[0]
    assert np.abs(left).max() < 1e-5 * modes.std()
    ahead = slope[:, :2] @ find_plane(slope[:, :2], firm)
    np.testing.assert_allclose(np.linalg.norm(ahead, axis=1), 1.0, atol=1e-5)


def test_twice_the_distances_give_twice_the_map(pillar: Crossed):
    place, segments, closures = pillar
    far = Segments(segments.index, 2.0 * segments.distance, segments.count, 0)
    assert rms(next(find_affine_maps(len(place), far, closures)), 2.0 * place) < 1e-5


def test_distances_that_are_wrong_by_a_tenth_bend_it_by_centimetres(pillar: Crossed):
    place, segments, closures = pillar
    gap = segments.distance.diff(dim=1, prepend=torch.zeros(len(segments.count), 1))
    noise = 1.0 + 0.1 * torch.randn(gap.shape, generator=torch.Generator().manual_seed(0))
    noisy = Segments(segments.index, (gap * noise).cumsum(dim=1), segments.count, 0)
    assert rms(next(find_affine_maps(len(place), noisy, closures)), place) < 0.1


def test_false_loop_closures_lose_their_weight(pillar: Crossed):
    place, segments, (first, second, length) = pillar
    i, j = np.random.default_rng(1).integers(len(place), size=(2, len(first) // 100))
    false = np.concatenate([first, i, j]), np.concatenate([second, j, i]), np.pad(length, (0, 2 * len(i)))
    errors = [rms(found, place) for found in find_affine_maps(len(place), segments, false)]
    assert min(errors[::2]) > 0.1
    assert min(errors[1::2]) < 0.01


def test_of_two_rooms_and_three_lines_between_them_one_map_is_right():
    rng = np.random.default_rng(0)
    through = np.array([[[-1.0, 0.1], [1.2, -0.12]], [[-1.4, -0.1], [1.5, 0.1]], [[-0.9, 0.0], [1.0, 0.0]]])
    rooms = draw((-2.5, -1.0), (-0.5, 1.0), 60, rng), draw((0.5, -1.6), (2.0, 0.6), 50, rng)
    place, segments, closures = cross(np.concatenate([*rooms, through]))
    found = [relax(rough, segments, closures) for rough in find_affine_maps(len(place), segments, closures)]
    assert rms(min(found, key=lambda one: one[1])[0], place) < 0.01


def test_what_is_not_joined_is_nowhere(pillar: Crossed):
    place, segments, closures = pillar
    apart = len(place) + torch.arange(6).reshape(2, 3)
    index = torch.zeros((len(segments.count) + 2, segments.index.shape[1]), dtype=torch.int64)
    index[:-2], index[-2:, :3] = segments.index, apart
    distance = torch.zeros(index.shape, dtype=torch.float64)
    distance[:-2], distance[-2:, :3] = segments.distance, torch.arange(3.0)
    more = Segments(index, distance, torch.cat([segments.count, torch.tensor([3, 3])]), 0)
    for found in find_affine_maps(len(place) + 6, more, closures):
        assert np.isfinite(found[:-6]).all() and np.isnan(found[-6:]).all()


def test_where_bars_do_not_cross_there_is_no_map():
    index, distance = torch.arange(12).reshape(4, 3), torch.arange(3.0, dtype=torch.float64).expand(4, 3)
    segments, none = Segments(index, distance, torch.full((4,), 3), 0), np.empty(0, int)
    assert not list(find_affine_maps(12, segments, (none, none, np.empty(0))))
    chain = np.arange(0, 9, 3), np.arange(3, 12, 3), np.zeros(3)  # bars that hang on one another by an end
    both = np.concatenate([chain[0], chain[1]]), np.concatenate([chain[1], chain[0]]), np.zeros(6)
    assert all(np.isfinite(found).all() for found in find_affine_maps(12, segments, both))
