"""Maps before training: exact where bars cross, by straightness, and by paths; turns tell a mirrored one."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
import torch

from deepgps.data.segments import Segments, dead_reckon, find_runs, read_segments
from deepgps.initial_map.distances import dense
from deepgps.initial_map.distances.dense import (
    find_affine_maps,
    find_chirality,
    find_initial_map,
    find_modes,
    find_plane,
)
from deepgps.initial_map.distances.isomap import LoopClosures, find_loop_closures, map_by_paths
from deepgps.initial_map.distances.pose_graph import Relaxed, build_pose_graph, relax
from sim.alignment import fit_alignment
from sim.recording.format import Recording, open_truth
from sim.sensors.encoder import slip_wheels
from tests.deepgps.initial_map.distances.test_pose_graph import error
from tests.helpers.toy import M_PER_TICK, ODOMETRY, make_toy


def test_the_map_is_exact_to_a_centimetre(toy):
    features, segments, place = toy
    found, _ = find_initial_map(features, segments, torch.Generator().manual_seed(0))
    assert np.sqrt(np.mean(error(found, place) ** 2)) < 0.01


def test_it_is_so_by_straightness_alone_and_by_paths_alone(toy, monkeypatch: pytest.MonkeyPatch):
    features, segments, place = toy
    for name, only in (("find_affine_maps", lambda *_: []), ("NEIGHBOURS", (3,))):
        with monkeypatch.context() as patched:
            patched.setattr(dense, name, only)
            if name == "NEIGHBOURS":
                patched.setattr(dense, "map_by_paths", lambda count, *_: np.zeros((count, 2)))
            found, _ = find_initial_map(features, segments, torch.Generator().manual_seed(0))
        assert np.sqrt(np.mean(error(found, place) ** 2)) < 0.01


@pytest.mark.parametrize(("costs", "overlaps", "best"), [((3, 1, 2), (0, 0, 0), 1), ((3, 1, 2), (0, 0.3, 0), 2)])
def test_the_cheapest_map_is_kept_unless_it_lays_unlike_places_together(
    toy, monkeypatch: pytest.MonkeyPatch, costs: tuple[int, ...], overlaps: tuple[float, ...], best: int
):
    features, segments, _ = toy
    made, cost, overlap = [np.zeros((len(features), 2)) for _ in costs], iter(costs), iter(overlaps)
    monkeypatch.setattr(dense, "map_by_paths", lambda *_: made[0])
    monkeypatch.setattr(dense, "NEIGHBOURS", (3,))
    monkeypatch.setattr(dense, "find_affine_maps", lambda *_: made[1:])
    monkeypatch.setattr(dense, "relax", lambda places, *_: (places, float(next(cost))))
    monkeypatch.setattr(dense, "measure_overlap", lambda *_: next(overlap))
    monkeypatch.setattr(dense, "relax_unevenly", lambda places, *_: Relaxed(places, segments, 0.0))
    assert find_initial_map(features, segments, torch.Generator().manual_seed(0))[0] is made[best]


def test_short_drives_have_a_map_too(toy):
    features, segments, _ = toy
    few = segments.take(torch.arange(8))
    closures = find_loop_closures(features, few, (3,))[0]
    assert len(list(find_affine_maps(len(features), few, closures))) >= 1
    found, _ = find_initial_map(features, few, torch.Generator().manual_seed(0))
    assert np.isfinite(found[few.index[0, 0]]).all()


def test_same_generator_same_map(toy):
    features, segments = toy.features, toy.segments.take(torch.arange(20))
    first, second = (find_initial_map(features, segments, torch.Generator().manual_seed(3))[0] for _ in range(2))
    assert np.array_equal(first, second, equal_nan=True)


def test_encoders_that_count_nothing_in_most_gaps_have_a_map_too(toy):
    features, segments, place = toy
    tick_m = 3.3 * float(segments.distance[0, 1])
    coarse = replace(segments, distance=(segments.distance / tick_m).floor() * tick_m)
    found, _ = find_initial_map(features, coarse, torch.Generator().manual_seed(0))
    assert np.sqrt(np.nanmean(error(found, place) ** 2)) < 2.0 * tick_m


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


def test_twice_the_distances_give_twice_the_map_and_those_wrong_by_a_tenth_bend_it_by_centimetres(pillar: Crossed):
    place, segments, closures = pillar
    far = replace(segments, distance=2.0 * segments.distance)
    assert rms(next(find_affine_maps(len(place), far, closures)), 2.0 * place) < 1e-5
    gap = segments.distance.diff(dim=1, prepend=torch.zeros(len(segments.count), 1))
    noise = 1.0 + 0.1 * torch.randn(gap.shape, generator=torch.Generator().manual_seed(0))
    noisy = replace(segments, distance=(gap * noise).cumsum(dim=1))
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


@pytest.fixture(scope="module")
def driven(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return make_toy(tmp_path_factory.mktemp("turns") / "toy")


def slip(recording: Recording, slip_per_m: float) -> Recording:
    """The same drive with encoders that slip."""
    per_tick = M_PER_TICK / ODOMETRY["wheel_radius_m"]
    angle = slip_wheels(
        recording.reading[:, 2:] * per_tick, slip_per_m, ODOMETRY["wheel_radius_m"], np.random.default_rng(0)
    )
    ticks = np.rint(angle / per_tick).astype(np.int64)
    return replace(recording, reading=np.column_stack([recording.reading[:, :2], ticks]))


@pytest.mark.parametrize("slip_per_m", [0.0, 0.01, 0.05])
def test_a_mirrored_map_is_told_by_its_turns_even_where_the_path_is_lost(driven: Recording, slip_per_m: float):
    recording, place = slip(driven, slip_per_m), open_truth(driven.folder).pose[:, :2]
    yaw, segments = dead_reckon(recording)[:, 2], read_segments(recording)
    angle = np.diff([yaw[run].mean() for run in find_runs(recording) if len(run) >= 2])
    for turned in (0.0, 1.0, -2.5):
        turn = np.array([[np.cos(turned), -np.sin(turned)], [np.sin(turned), np.cos(turned)]])
        assert find_chirality(place @ turn.T + 3.0, segments, angle) == 1
        assert find_chirality(place @ turn.T * [1.0, -1.0], segments, angle) == -1
