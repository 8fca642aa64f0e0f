"""Measures of errors on maps, headings and rooms whose figures are known."""

from types import SimpleNamespace

import numpy as np
import pytest

from deepgps.evaluation.error_field import ErrorField
from deepgps.evaluation.evaluate import MISPLACED_M, measure_heading_spread, measure_misplaced
from deepgps.evaluation.measures import measure_flipped, measure_flipped_patch, measure_visible, summarise_yaw
from sim.geometry import FreeSpace

SPACING_M = 0.08
X, Y = (axis.ravel() * SPACING_M - 0.4 for axis in np.meshgrid(np.arange(21), np.arange(11)))
TRUTH = np.column_stack([X, Y])
TURN = np.array([[0.6, -0.8], [0.8, 0.6]])
MIRROR = np.diag([1.0, -1.0])


def fold(share: float) -> np.ndarray:
    """The plane folded along a line of x, so that this share of the neighbourhoods lies face down."""
    crease = X.min() + (1 - share) * (X.max() - X.min())
    return np.column_stack([np.where(crease + 1e-9 < X, 2 * crease - X, X), Y])


def test_a_fold_shows_with_its_share_whatever_the_frame():
    for share in (0.0, 0.1, 0.25, 0.5):
        for motion in (np.eye(2), TURN, MIRROR, TURN @ MIRROR):
            assert measure_flipped(TRUTH, fold(share) @ motion.T + [3.0, -2.0], SPACING_M) == pytest.approx(share)


def test_gaps_in_the_grid_are_left_out_and_order_does_not_matter():
    kept = np.random.default_rng(0).permutation(len(TRUTH))[:150]
    assert measure_flipped(TRUTH[kept], TRUTH[kept], SPACING_M) == 0.0
    assert 0.1 < measure_flipped(TRUTH[kept], fold(0.25)[kept], SPACING_M) < 0.4
    assert measure_flipped(TRUTH[:1], TRUTH[:1], SPACING_M) == 0.0


SCATTERED_PLACES = np.random.default_rng(1).uniform([0.0, 0.0], [4.0, 3.0], (8000, 2))


def test_a_patch_that_is_turned_over_has_its_area_and_small_errors_turn_none():
    for radius_m in (0.3, 0.5):
        away = SCATTERED_PLACES - [2.0, 1.5]
        inside = np.linalg.norm(away, axis=1) < radius_m
        positions = np.where(inside[:, None], [2.0, 1.5] + away * [-1.0, 1.0], SCATTERED_PLACES)
        found = measure_flipped_patch(SCATTERED_PLACES, positions)
        assert found == pytest.approx(np.pi * radius_m**2, abs=2 * np.pi * radius_m * 0.1), "a cell wide at its edge"
    noise = np.random.default_rng(2).normal(0.0, 0.01, SCATTERED_PLACES.shape)
    assert measure_flipped_patch(SCATTERED_PLACES, SCATTERED_PLACES + noise) == 0.0
    assert measure_flipped_patch(SCATTERED_PLACES[:1], SCATTERED_PLACES[:1]) == 0.0


def test_the_largest_of_several_patches_counts_and_not_their_sum():
    positions = SCATTERED_PLACES.copy()
    for centre, radius_m in (([1.0, 1.5], 0.4), ([3.0, 1.5], 0.4)):
        away = SCATTERED_PLACES - centre
        positions = np.where(np.linalg.norm(away, axis=1)[:, None] < radius_m, centre + away * [1.0, -1.0], positions)
    assert 0.3 < measure_flipped_patch(SCATTERED_PLACES, positions) < 0.8


def test_the_spread_is_that_of_a_loop_over_positions_and_headings():
    predicted = np.random.default_rng(0).normal(size=(7, 4, 2))
    squares = []
    for place in predicted:
        middle = sum(place) / 4
        squares += [float((one - middle) @ (one - middle)) for one in place]
    assert measure_heading_spread(predicted) == pytest.approx((sum(squares) / 28) ** 0.5)
    assert measure_heading_spread(np.stack([TRUTH, TRUTH + (0.3, 0.4)], axis=1)) == pytest.approx(0.25)
    assert measure_heading_spread(np.repeat(TRUTH[:, None], 4, axis=1)) == pytest.approx(0.0, abs=1e-12)


HEADING = np.radians([0.0, 90.0, 180.0, -90.0])
ERROR_DEG = np.array([[1.0, -1.0, 1.0, np.nan], [2.0, -2.0, 2.0, -20.0]])


def make_field(accepted: np.ndarray | None) -> ErrorField:
    place = np.zeros((2, 2))
    yaw = HEADING + np.radians(ERROR_DEG) + 2.0 * np.pi
    return ErrorField(place, HEADING, np.zeros((2, 4, 2)), accepted=accepted, yaw=yaw)


def test_what_is_refused_counts_in_the_rms_of_all_alone():
    accepted = np.array([[True, True, True, True], [True, True, True, False]])
    figures = summarise_yaw(make_field(accepted))
    assert figures["yaw_rms_deg"] == pytest.approx(np.sqrt((3 + 12 + 400) / 7))
    assert figures["yaw_rms_accepted_deg"] == pytest.approx(np.sqrt((3 + 12) / 6))
    assert figures["yaw_median_deg"] == pytest.approx(2.0)
    assert "yaw_rms_accepted_deg" not in summarise_yaw(make_field(None))
    assert "yaw_rms_accepted_deg" not in summarise_yaw(make_field(np.zeros((2, 4), bool)))


CELL = 0.02


def make_space(rectangles: list[tuple[float, float, float, float]]) -> FreeSpace:
    """Floor of rectangles (left, right, bottom, top) [m] within a square of 6 m, a corner at the origin."""
    middle = CELL * np.arange(-5, 306)
    x, y = np.meshgrid(middle, middle)
    free = np.zeros(x.shape, bool)
    for left, right, bottom, top in rectangles:
        free |= (x > left) & (x < right) & (y > bottom) & (y < top)
    return FreeSpace(np.full(2, middle[0]), CELL, free, free, np.ones(2), 1.0)


def test_from_everywhere_in_a_convex_room_all_of_it_is_reached():
    points = np.random.default_rng(0).uniform((0.05, 0.05), (3.95, 2.95), (40, 2))
    assert measure_visible(make_space([(0, 4, 0, 3)]), points) == pytest.approx(1.0, abs=0.02)


def test_an_l_hides_what_lies_around_its_corner():
    # Arms of 4 m x 1 m and 1 m x 4 m: at an arm's end the other arm is hidden but for a triangle past the inner corner.
    space = make_space([(0, 4, 0, 1), (0, 1, 0, 4)])
    share = measure_visible(space, np.array([(0.5, 0.5), (3.5, 0.5)]))
    assert share[0] == pytest.approx(1.0, abs=0.02)
    # Past (1, 1) the sight rises by 0.5 / 2.5 a metre, to 1.2 m at the wall: 4 m2 and a triangle of 1 m x 0.2 m.
    assert share[1] == pytest.approx(4.1 / 7.0, abs=0.02)


def test_what_is_reached_does_not_change_when_the_world_is_moved():
    space = make_space([(0, 4, 0, 1), (0, 1, 0, 4)])
    moved = FreeSpace(space.origin + (7.0, -3.0), CELL, space.free.T, space.reachable.T, np.ones(2), 1.0)
    points = np.array([(0.5, 2.5), (1.5, 0.3), (3.9, 0.9)])
    expected = measure_visible(space, points)
    assert measure_visible(moved, points[:, ::-1] + (7.0, -3.0)) == pytest.approx(expected, abs=1e-9)
    nowhere = np.array([(2.0, 2.0), (-9.0, 0.0)])
    assert measure_visible(make_space([(0, 4, 0, 1)]), nowhere) == pytest.approx(0.0), "a place in a wall"


def test_only_what_is_farther_off_than_the_limit_is_misplaced():
    rng = np.random.default_rng(0)
    pose = rng.uniform(-5.0, 5.0, (40, 3))
    angle, off = rng.uniform(-np.pi, np.pi, 40), np.r_[np.full(30, 0.99 * MISPLACED_M), np.full(10, 1.01 * MISPLACED_M)]
    places = pose[:, :2] + off[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    assert measure_misplaced(places, SimpleNamespace(pose=pose)) == pytest.approx(0.25)  # pyright: ignore[reportArgumentType]
