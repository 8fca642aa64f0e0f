"""Folds are found by two signs, and parts that could be mirrored where one line alone joins them."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csr_array
from scipy.spatial import KDTree

from deepgps.data.segments import Segments, read_segments
from deepgps.initial_map.distances.folding import (
    LENGTH_ERROR_LIMIT,
    OVERLAP_LIMIT,
    FoldScore,
    find_ambiguous_readings,
    score_folding,
)
from deepgps.initial_map.distances.pose_graph import PoseGraph
from tests.helpers.toy import make_toy


@pytest.fixture(scope="module")
def toy(tmp_path_factory: pytest.TempPathFactory):
    recording = make_toy(tmp_path_factory.mktemp("fold") / "toy", samples=1000)
    place = np.load(recording.folder / "truth" / "pose.npy")[:, :2]
    return place, torch.tensor(recording.observation), read_segments(recording)


def signs(place: np.ndarray, toy) -> FoldScore:
    return score_folding(place, toy[1], toy[2], torch.Generator().manual_seed(0))


def fold_at(place: np.ndarray, x: float) -> np.ndarray:
    """Turn over what lies right of ``x``."""
    return np.where(place[:, :1] > x, place * [-1.0, 1.0] + [2.0 * x, 0.0], place)


def test_the_right_map_shows_no_sign_and_noise_of_a_few_centimetres_is_no_fold(toy):
    assert signs(toy[0], toy) == FoldScore(0.0, 0.0)
    noisy = toy[0] + np.random.default_rng(0).normal(0.0, 0.02, toy[0].shape)
    assert not signs(noisy, toy).folded
    assert signs(0.7 * toy[0], toy).length_error_fraction > 0.9


@pytest.mark.parametrize("x", [-0.5, 0.0, 0.7])
def test_a_folded_map_is_found_by_both_signs(toy, x: float):
    found = signs(fold_at(toy[0], x), toy)
    assert found.length_error_fraction > LENGTH_ERROR_LIMIT
    assert found.overlap_fraction > OVERLAP_LIMIT


def test_a_fold_that_no_segment_crosses_is_still_found(toy):
    place, features, segments = toy
    right = place[:, 0] > 0
    sides = [{bool(right[i]) for i in row[:count]} for row, count in zip(segments.index, segments.count, strict=True)]
    keep = torch.tensor([len(side) == 1 for side in sides])
    apart = Segments(segments.index[keep], segments.distance[keep], segments.count[keep], 0)
    found = score_folding(fold_at(place, 0.0), features, apart, torch.Generator().manual_seed(0))
    assert found.length_error_fraction == 0.0
    assert found.overlap_fraction > OVERLAP_LIMIT


@given(angle=st.floats(-4, 4), x=st.floats(-20, 20), mirrored=st.booleans())
@settings(max_examples=5, deadline=None)
def test_signs_do_not_see_rigid_motion(toy, angle: float, x: float, mirrored: bool):
    folded = fold_at(toy[0], 0.3)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    moved = (folded * [1.0, -1.0] if mirrored else folded) @ turn + [x, 0.0]
    there, back = signs(folded, toy), signs(moved, toy)
    assert there.length_error_fraction == pytest.approx(back.length_error_fraction, abs=0.02)
    assert there.overlap_fraction == pytest.approx(back.overlap_fraction, abs=0.02)


def test_the_worst_sign_decides():
    assert FoldScore(2.0 * LENGTH_ERROR_LIMIT, 0.0).folded
    assert FoldScore(0.0, 2.0 * OVERLAP_LIMIT).folded
    assert not FoldScore(0.9 * LENGTH_ERROR_LIMIT, 0.9 * OVERLAP_LIMIT).folded


STEP = 0.1
LEFT_BARS = [((0.0, y), (4.0, 4.0 - y)) for y in (0.5, 1.5, 2.5, 3.5)] + [((x, 0.0), (x, 4.0)) for x in (0.5, 1.5, 3.0)]
RIGHT_BARS = [((6.0, 0.5), (7.5, 3.5)), ((6.0, 3.5), (7.5, 0.5)), ((6.0, 1.0), (8.0, 1.0)), ((6.0, 3.0), (8.0, 3.0))]
LONG_BARS = [((0.0, 2.0), (8.0, 2.0))]
SECOND_BARS = [((0.0, 3.2), (8.0, 2.8))]
DIAGONAL_BARS = [((0.0, 1.0), (8.0, 2.6))]
TURN = np.array([[0.6, -0.8], [0.8, 0.6]])


def make_graph(bars: list) -> tuple[PoseGraph, np.ndarray]:
    """Readings along bars from one point to another, and pairs of readings of two bars that nearly coincide."""
    ways = [np.arange(0.0, np.hypot(*np.subtract(end, start)), STEP) for start, end in bars]
    point = np.concatenate(
        [
            np.array(start) + way[:, None] * np.subtract(end, start) / np.hypot(*np.subtract(end, start))
            for (start, end), way in zip(bars, ways, strict=True)
        ]
    )
    bar = np.repeat(np.arange(len(bars)), [len(way) for way in ways])
    pairs = KDTree(point).query_pairs(STEP, output_type="ndarray")
    a, b = pairs[bar[pairs[:, 0]] != bar[pairs[:, 1]]].T
    along = np.concatenate([way - way.mean() for way in ways])
    count = np.arange(len(point))
    ones, mix = np.ones(len(a)), csr_array((len(a), len(point)))
    return PoseGraph(count, along, bar, a, b, mix, np.zeros((len(a), 2)), ones < 0, ones, ones, STEP), point


def test_a_part_that_meets_the_rest_along_one_line_could_be_mirrored():
    graph, point = make_graph(LEFT_BARS + RIGHT_BARS + LONG_BARS)
    found = find_ambiguous_readings(graph, point)
    moved = np.abs(point[:, 1] - 2.0) > 3 * STEP
    assert (found == ((point[:, 0] > 5.0) & moved)).all()


def test_mirroring_that_part_keeps_every_loop_closure_short():
    graph, point = make_graph(LEFT_BARS + RIGHT_BARS + LONG_BARS)
    mirrored = point.copy()
    right = (point[:, 0] > 5.0) & (graph.bar < len(LEFT_BARS + RIGHT_BARS))
    mirrored[right, 1] = 4.0 - point[right, 1]
    apart, before = (np.linalg.norm(one[graph.a] - one[graph.b], axis=1) for one in (mirrored, point))
    assert np.abs(apart - before).max() < 2 * STEP
    assert np.linalg.norm(mirrored - point, axis=1).max() > 2.5


def test_a_second_line_decides_it_and_a_single_bar_that_hangs_loose_is_no_part():
    for bars in (
        LEFT_BARS + RIGHT_BARS + LONG_BARS + SECOND_BARS,
        LEFT_BARS + RIGHT_BARS + LONG_BARS + DIAGONAL_BARS,
        [*LEFT_BARS, ((3.8, 1.9), (4.2, 2.0))],
    ):
        assert not find_ambiguous_readings(*make_graph(bars)).any()
    assert find_ambiguous_readings(*make_graph([((0.0, y), (4.0, y)) for y in (0.0, 1.0, 2.0)])).mean() > 0.5


def test_the_smaller_part_is_the_one_in_doubt():
    graph, point = make_graph(
        [*RIGHT_BARS, *LONG_BARS, *(((x - 1.0, 0.0), (x + 1.0, 4.0)) for x in (6.0, 6.5)), LEFT_BARS[0], LEFT_BARS[3]]
    )
    found = find_ambiguous_readings(graph, point)
    assert found.any()
    assert (point[found, 0] < 4.0).all()


def test_it_does_not_depend_on_the_frame():
    graph, point = make_graph(LEFT_BARS + RIGHT_BARS + LONG_BARS)
    for mirror in (1.0, -1.0):
        elsewhere = (point * [1.0, mirror]) @ TURN.T + [3.0, -7.0]
        assert (find_ambiguous_readings(graph, elsewhere) == find_ambiguous_readings(graph, point)).all()
