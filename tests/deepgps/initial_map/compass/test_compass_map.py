"""The map by compass: exact where nothing is wrong, never pulled apart by false closures; bars err as expected."""

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from scipy.spatial import KDTree

from deepgps.data.segments import Segments
from deepgps.data.turns import CompassTurns
from deepgps.initial_map.compass.bars import Bars, lay_out
from deepgps.initial_map.compass.closures import Closures, find_doubted
from deepgps.initial_map.compass.compass_map import CompassMap, find_compass_map, refine
from deepgps.initial_map.compass.factors import Factors, add_factors
from deepgps.initial_map.compass.least_squares import CURVATURE_STD, Equations
from sim.alignment import fit_alignment

SPACING_M = 0.08
ROOM_M = np.array([4.0, 3.0])
ANGLE_STD, JUMP_STD = np.radians(0.5), 0.002


@dataclass(frozen=True)
class Drive:
    """A drive in a rectangle, as its encoders and its compass measure it, with the camera's true places."""

    place: np.ndarray
    segments: Segments
    turns: CompassTurns
    closures: Closures


def drive(
    segments: int,
    seed: int = 0,
    noise: float = 0.0,
    gaps: float = 0.0,
    curvature: float = 0.0,
    mount: tuple[float, float] = (0.0, 0.0),
    tick_m: float = 0.0,
) -> Drive:
    """Drive; turns are wrong by ``noise`` standard deviations, each gap between readings by the fraction ``gaps``, and
    the distance driven is known in ticks."""
    rng = np.random.default_rng(seed)
    poses, rows, turned = [np.array([*ROOM_M / 2, 0.0])], [], []
    while len(rows) < segments:
        angle, steps = rng.uniform(-np.pi, np.pi), int(rng.integers(6, 30))
        driven = SPACING_M * np.arange(1, steps + 1)
        begin = poses[-1][2] + angle
        yaw = begin + curvature * driven
        middle = begin + curvature * driven / 2.0
        chord = driven * np.sinc(curvature * driven / (2.0 * np.pi))
        points = poses[-1][:2] + chord[:, None] * np.stack([np.cos(middle), np.sin(middle)], axis=1)
        if ((points < 0) | (points > ROOM_M)).any():
            continue
        rows.append(np.arange(len(poses) - 1, len(poses) + steps))
        turned.append(angle)
        poses.extend(np.column_stack([points, yaw]))
    pose = np.array(poses)
    longest = max(map(len, rows))
    index, distance, variance = np.zeros((segments, longest), int), *np.zeros((2, segments, longest))
    for number, row in enumerate(rows):
        gap = SPACING_M * (1.0 + gaps * rng.standard_normal(len(row) - 1))
        index[number, : len(row)] = row
        distance[number, 1 : len(row)] = np.cumsum(gap)
        if tick_m:
            driven = np.floor((distance[number, : len(row)] + rng.uniform(0.0, tick_m)) / tick_m) * tick_m
            distance[number, : len(row)] = driven - driven[0]
        variance[number, 1 : len(row)] = (gaps * SPACING_M) ** 2 * np.arange(1, len(row))
    count = torch.tensor([len(row) for row in rows])
    tables = torch.from_numpy(index), torch.from_numpy(distance).float(), count, 0
    table = Segments(*tables, variance=torch.from_numpy(variance).float(), rounding_m2=tick_m**2 / 6.0)
    angle = np.array(turned[1:]) + noise * ANGLE_STD * rng.standard_normal(segments - 1)
    between = segments - 1
    turns = CompassTurns(angle, np.full(between, ANGLE_STD), np.zeros((between, 2)), np.full(between, JUMP_STD))
    cos, sin = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    camera = pose[:, :2] + np.stack([cos * mount[0] - sin * mount[1], sin * mount[0] + cos * mount[1]], axis=1)
    return Drive(camera, table, turns, find_closures(camera, pose[:, 2], rows))


def find_closures(place: np.ndarray, yaw: np.ndarray, rows: list[np.ndarray]) -> Closures:
    owner = np.full(len(place), -1)
    for number, row in enumerate(rows):
        owner[row] = number
    apart = np.linalg.norm(place[:, None] - place[None], axis=2)
    apart[np.abs(owner[:, None] - owner[None]) < 2] = np.inf
    nearest = apart.argmin(axis=1)
    first = np.flatnonzero((nearest[nearest] == np.arange(len(place))) & (apart.min(axis=1) < 0.1))
    first = first[first < nearest[first]]
    second = nearest[first]
    return Closures(first, second, apart[first, second], yaw[second] - yaw[first])


def find_map(made: Drive, closures: Closures | None = None) -> CompassMap:
    closures = made.closures if closures is None else closures
    return find_compass_map(made.segments, made.turns, closures, len(made.place), np.random.default_rng(0))


def error(found: np.ndarray, place: np.ndarray) -> float:
    known = np.isfinite(found[:, 0])
    found, place = found[known], place[known]
    return float(np.sqrt(((fit_alignment(found, place, "SE2").apply(found) - place) ** 2).sum(axis=1).mean()))


def add(closures: Closures, first: np.ndarray, second: np.ndarray, turn: np.ndarray) -> Closures:
    """The loop closures with others, whose images look as if they were 3 cm apart."""
    others = first, second, np.full(len(first), 0.03), turn
    return Closures(*(np.concatenate(pair) for pair in zip(vars(closures).values(), others, strict=True)))


SEEDS = [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))]
NONE = Closures(np.empty(0, int), np.empty(0, int), np.empty(0), np.empty(0))


def test_exact_turns_and_lengths_give_the_exact_map():
    made = drive(60)
    assert error(find_map(made, NONE).places, made.place) < 1e-4
    assert error(find_map(made).places, made.place) < 0.01


@pytest.mark.parametrize("seed", SEEDS)
def test_loop_closures_straighten_a_path_whose_compass_errs(seed: int):
    made = drive(150, seed, noise=1.0)
    alone, refined = find_map(made, NONE), find_map(made)
    assert error(refined.places, made.place) < min(0.02, 0.4 * error(alone.places, made.place))
    assert refined.stages[-1].inliers.mean() > 0.95 and not refined.undecided.any()


@pytest.mark.parametrize("seed", SEEDS)
def test_false_loop_closures_that_the_covariance_excludes_change_nothing(seed: int):
    made, rng = drive(150, seed, noise=1.0), np.random.default_rng(seed)
    first, second = rng.integers(0, len(made.place), (2, 600))
    false = np.linalg.norm(made.place[first] - made.place[second], axis=1) > 1.0
    found = find_map(made, add(made.closures, first[false], second[false], np.full(false.sum(), np.nan)))
    assert not found.stages[-1].inliers[len(made.closures.first) :].any()
    assert error(found.places, made.place) < 0.02


@pytest.mark.parametrize("segments", [100, pytest.param(200, marks=pytest.mark.slow)])
def test_noisy_gaps_are_mended_and_the_map_does_not_shrink(segments: int):
    made = drive(segments, noise=1.0, gaps=0.3)
    assert made.segments.variance is not None
    stiff = replace(made, segments=replace(made.segments, variance=1e-6 * made.segments.variance))
    turns_only = find_map(replace(made, closures=NONE))
    free, rigid = find_map(made), find_map(stiff)
    assert error(free.places, made.place) < 0.3 * error(turns_only.places, made.place)
    assert error(free.places, made.place) < 1.1 * error(rigid.places, made.place)
    size = [np.sqrt(((place - place.mean(axis=0)) ** 2).sum()) for place in (free.places, made.place)]
    assert size[0] == pytest.approx(size[1], rel=0.02)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_segment_without_loop_closures_keeps_its_measured_length(seed: int):
    made = drive(120, seed, gaps=0.3)
    last = made.segments.index[-1, : made.segments.count[-1]].numpy()
    known = ~np.isin(made.closures.first, last) & ~np.isin(made.closures.second, last)
    kept = Closures(*(part[known] for part in vars(made.closures).values()))
    end, begin = find_map(made, kept).places[last[[-1, 0]]]
    assert np.linalg.norm(end - begin) == pytest.approx(float(made.segments.distance[-1].max()), rel=0.005)


@pytest.mark.parametrize(
    ("scale", "gaps"),
    [(1 / 3, 0.1), (3.0, 0.1), *(pytest.param(scale, 0.0, marks=pytest.mark.slow) for scale in (1 / 3, 3.0))],
)
def test_expected_errors_that_are_three_times_too_small_or_large_hardly_change_the_map(scale: float, gaps: float):
    made = drive(150, noise=1.0, gaps=gaps)
    assert made.segments.variance is not None
    turns = replace(made.turns, angle_std=scale * made.turns.angle_std, jump_std=scale * made.turns.jump_std)
    segments = replace(made.segments, variance=scale**2 * made.segments.variance)
    right, other = find_map(made), find_map(replace(made, turns=turns, segments=segments))
    assert error(other.places, made.place) < 1.1 * error(right.places, made.place) + 0.001


@pytest.mark.parametrize("drives", [2, pytest.param(8, marks=pytest.mark.slow)])
@pytest.mark.parametrize(("gaps", "tick_m"), [(0.0, 0.0), (0.1, 0.0), (0.0, 0.05)])
def test_errors_are_as_large_as_their_standard_deviations(gaps: float, tick_m: float, drives: int):
    ratios = []
    for seed in range(drives):
        made = drive(120, seed, noise=1.0, gaps=gaps, tick_m=tick_m)
        found = find_map(made)
        ratios.append(error(found.places, made.place) ** 2 / 2.0 / (found.std**2).mean())
    assert 0.25 < np.mean(ratios) < 1.5


def test_without_loop_closures_errors_are_as_large_as_their_standard_deviations():
    ratios, rng = [], np.random.default_rng(0)
    for seed in range(20):
        made = drive(40, seed, noise=1.0, curvature=CURVATURE_STD * rng.standard_normal())
        found = find_map(made, NONE)
        ratios.append(error(found.places, made.place) ** 2 / 2.0 / (found.std**2).mean())
    assert 0.5 < np.mean(ratios) < 2.0


def register(made: Drive, found: CompassMap, std_m: float) -> Factors:
    """Places as registered, ``std_m`` off, on the mean of four around each that were passed at another time."""
    true = fit_alignment(made.place, found.places, "SE2").apply(made.place)  # in the map's frame
    around = np.asarray(KDTree(true).query(true, 40)[1])
    apart = [row[np.abs(row - row[0]) > 30][:4] for row in around]
    one = np.flatnonzero([len(row) == 4 for row in apart])
    others = np.array([row for row in apart if len(row) == 4])
    off = std_m * np.random.default_rng(0).standard_normal((len(one), 2))
    offset = true[one] - true[others].mean(axis=1) + off
    return Factors(one, others, np.full(others.shape, 0.25), offset, np.full(len(one), std_m**2))


@pytest.mark.parametrize(("noise", "gaps"), [(0.0, 0.0), (1.0, 0.0), (1.0, 0.1)])
def test_registrations_of_images_mend_a_map(noise: float, gaps: float):
    made = drive(100, noise=noise, gaps=gaps)
    found = find_map(made)
    better = refine(found, register(made, found, 0.003), np.random.default_rng(0))
    assert error(better.places, made.place) < 0.5 * error(found.places, made.place)
    assert np.array_equal(found.places, find_map(made).places), "the map before is not touched"


def test_the_derivatives_of_registrations_agree_with_finite_differences():
    made = drive(40, noise=1.0, gaps=0.1, curvature=0.02, mount=(0.05, 0.02))
    found = find_map(made)
    bars = found.layout.bars
    factors = register(made, found, 1e6).number(bars.find_readings(len(made.place)))  # so that no weight is robust
    equations = Equations()
    add_factors(equations, bars, factors, 1e-6)
    jacobian, residual = equations.assemble(bars.count)
    step = 1e-5 * np.random.default_rng(0).standard_normal(bars.count)
    bars.move(step)
    moved = Equations()
    add_factors(moved, bars, factors, 1e-6)
    np.testing.assert_allclose(moved.assemble(bars.count)[1] - residual, jacobian @ step, atol=1e-8)


def begin(made: Drive, segments: int) -> Drive:
    """The first segments of a drive."""
    first = made.segments.take(torch.arange(segments))
    seen = int(first.index.max()) + 1
    turns = CompassTurns(*(values[: segments - 1] for values in list(vars(made.turns).values())[:4]))
    closures = vars(made.closures).values()
    within = np.maximum(made.closures.first, made.closures.second) < seen
    return Drive(made.place[:seen], first, turns, Closures(*(values[within] for values in closures)))


@pytest.mark.parametrize("drives", [1, pytest.param(6, marks=pytest.mark.slow)])
@pytest.mark.parametrize("gaps", [0.0, 0.1])
def test_the_map_of_a_drive_agrees_with_that_of_its_beginning_within_their_standard_deviations(
    gaps: float, drives: int
):
    ratios = []
    for seed in range(drives):
        made = drive(160, seed, noise=1.0, gaps=gaps)
        long, short = find_map(made), find_map(begin(made, 80))
        seen = len(short.places)
        expected = (short.std**2).mean() + (long.std[:seen] ** 2).mean()
        ratios.append(error(short.places, long.places[:seen]) ** 2 / 2.0 / expected)
    assert np.mean(ratios) < 1.0 and max(ratios) < 3.0


@pytest.mark.parametrize("segments", [200, pytest.param(300, marks=pytest.mark.slow)])
def test_in_a_long_drive_all_drifts_are_mended_one_after_another(segments: int):
    made = drive(segments, noise=1.0, gaps=0.1)
    found = find_map(made)
    assert found.stages[-1].inliers.mean() > 0.99 and not found.undecided.any()
    assert error(found.places, made.place) < 0.02


def test_what_the_robot_drives_for_straight_and_where_its_camera_is_are_found():
    made = drive(150, noise=0.2, curvature=0.01, mount=(0.03, -0.02))
    found = find_map(made)
    np.testing.assert_allclose(found.shared, [0.01, 0.03, -0.02], atol=0.005)
    assert error(found.places, made.place) < 0.01


def carry(made: Drive, times: int, told: bool) -> Drive:
    """The drive with some turns that are wrong, and that the robot knows of or not."""
    rng = np.random.default_rng(1)
    carried = rng.choice(np.arange(10, len(made.turns.angle) - 10), times, replace=False)
    angle, angle_std = made.turns.angle.copy(), made.turns.angle_std.copy()
    jump, jump_std = made.turns.jump.copy(), made.turns.jump_std.copy()
    angle[carried] += rng.uniform(1.0, 5.0, times)
    if told:
        jump[carried], angle_std[carried], jump_std[carried] = rng.uniform(-2.0, 2.0, (times, 2)), 3.0, 10.0
    return replace(made, turns=CompassTurns(angle, angle_std, jump, jump_std))


@pytest.mark.parametrize("told", [True, False])
def test_parts_between_which_the_robot_was_carried_are_joined_by_what_both_saw(told: bool):
    made = drive(200, noise=0.3)
    found = find_map(carry(made, 3, told))
    assert found.undecided.mean() < 0.02
    assert error(found.places, made.place) < 0.02


def test_parts_that_saw_nothing_in_common_are_undecided():
    made = carry(drive(100, noise=0.3), 1, told=True)
    at = int(np.flatnonzero(made.turns.jump_std > 1.0)[0])
    later = int(made.segments.index[at + 1, 1])
    apart = (made.closures.first < later) == (made.closures.second < later)
    found = find_map(made, Closures(*(values[apart] for values in vars(made.closures).values())))
    smaller = np.arange(len(made.place)) >= later
    smaller = smaller if smaller.mean() < 0.5 else ~smaller
    assert np.isnan(found.places[smaller][1:-1]).all() and found.undecided[smaller][1:-1].all()
    assert not found.undecided[~smaller].any()


def repeat(made: Drive, shift_m: float) -> Drive:
    """The drive in a world that looks the same after a shift along x: half as many false loop closures as true ones."""
    shifted = made.place + [shift_m, 0.0]
    apart = np.linalg.norm(shifted[:, None] - made.place[None], axis=2)
    first, second = np.nonzero(apart < 0.04)
    chosen = np.random.default_rng(0).choice(len(first), len(made.closures.first) // 2)
    first, second = first[chosen], second[chosen]
    return replace(made, closures=add(made.closures, first, second, np.full(len(first), np.nan)))


@pytest.mark.parametrize(("held", "doubted"), [(False, [4, 5, 6, 7]), (True, [4])])
def test_what_hangs_on_doubted_segments_alone_is_doubted(held: bool, doubted: list[int]):
    bars: Any = SimpleNamespace(segment=np.arange(8), row=np.arange(8))
    false = [(4, other) for other in (0, 1, 2, 3)] * 5
    true = [(0, 2), (1, 3), (5, 7)] * 10 + [(7, 0)] * held
    one, other = np.array(false + true).T
    links: Any = SimpleNamespace(one=one, other=other)
    inliers: Any = SimpleNamespace(mask=np.arange(len(one)) >= len(false))
    assert np.flatnonzero(find_doubted(bars, links, inliers)).tolist() == doubted


@pytest.mark.parametrize("seeds", [range(1), pytest.param(range(1, 4), marks=pytest.mark.slow)])
def test_in_a_world_that_repeats_a_good_path_decides_and_a_bad_one_says_that_it_cannot(seeds: range):
    made = repeat(drive(150, noise=0.3), shift_m=1.0)
    good = find_map(made)
    assert good.fit.inliers.repeats_m == pytest.approx(1.0, abs=0.1)
    assert good.undecided.mean() < 0.1 and error(good.places, made.place) < 0.05
    for seed in seeds:
        made = repeat(drive(150, seed, noise=3.0, gaps=0.3), shift_m=1.0)
        bad = find_map(replace(made, turns=replace(made.turns, angle_std=3.0 * made.turns.angle_std)))
        decided = np.where(bad.undecided[:, None], np.nan, bad.places)
        assert bad.undecided.mean() > 0.5 or error(decided, made.place) < 0.05, seed


READINGS, DRAWS = 9, 40_000
NO_TURNS = CompassTurns(np.empty(0), np.empty(0), np.empty((0, 2)), np.empty(0))


def lay_bar(noise: float, tick_m: float) -> Bars:
    """One segment whose gaps are wrong by the fraction ``noise`` and whose distance is known in ticks."""
    distance = SPACING_M * np.arange(READINGS)
    variance = (noise * SPACING_M) ** 2 * np.arange(READINGS)
    tables = (torch.arange(READINGS)[None], torch.from_numpy(distance)[None], torch.tensor([READINGS]), 0)
    rounding_m2 = tick_m**2 / 6.0
    segments = Segments(*tables, variance=torch.from_numpy(variance)[None], rounding_m2=rounding_m2)
    bars = lay_out(segments, NO_TURNS, curvature=0.0)
    assert len(bars.unknown) == 1
    return bars


def measure_unevenness(noise: float, tick_m: float) -> np.ndarray:
    """Mean squared error (READINGS,) [m^2] of many such measurements, each scaled so that its ends are right."""
    rng, distance = np.random.default_rng(0), SPACING_M * np.arange(READINGS)
    gap = SPACING_M * (1.0 + noise * rng.standard_normal((DRAWS, READINGS - 1)))
    measured = np.concatenate([np.zeros((DRAWS, 1)), gap.cumsum(axis=1)], axis=1)
    if tick_m:
        measured += rng.uniform(0.0, tick_m, measured.shape)
    begin, end = measured[:, :1], measured[:, -1:]
    scaled = (measured - begin) * distance[-1] / (end - begin)
    return np.square(scaled - distance).mean(axis=0)


def test_readings_of_a_bar_err_as_expected():
    for noise, tick_m in ((0.05, 0.0), (0.0, 0.01), (0.05, 0.01)):
        expected = lay_bar(noise, tick_m).uneven_m2
        assert np.allclose(expected, measure_unevenness(noise, tick_m), rtol=0.03, atol=1e-12)
    assert not lay_bar(0.0, 0.0).uneven_m2.any(), "exact encoders do not err"


def test_coarse_ticks_may_put_readings_at_the_ends_of_a_bar():
    tables = torch.arange(4)[None], torch.tensor([[0.0, 0.0, 0.2, 0.2]]), torch.tensor([4]), 0
    segments = Segments(*tables, variance=torch.zeros(1, 4), rounding_m2=0.01)
    uneven_m2 = lay_out(segments, NO_TURNS, curvature=0.0).uneven_m2
    assert np.allclose(uneven_m2, [0.0, 0.01, 0.01, 0.0])
    still = lay_out(replace(segments, distance=torch.zeros(1, 4)), NO_TURNS, curvature=0.0)
    assert np.isfinite(still.uneven_m2).all()


def test_samples_lie_along_the_bar_and_have_the_expected_variance():
    bars = lay_bar(0.05, 0.01)
    bars.unknown[:, 2] = np.pi / 6.0
    drawn = bars.draw_unevenness(DRAWS, np.random.default_rng(0))
    along = np.cos(np.pi / 6.0) * drawn[:, 0] + np.sin(np.pi / 6.0) * drawn[:, 1]
    assert np.allclose(along**2, (drawn**2).sum(axis=1))
    assert np.allclose((along**2).mean(axis=1), bars.uneven_m2, rtol=0.03, atol=1e-12)
