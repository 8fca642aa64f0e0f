"""How much of a map is turned over, on maps whose folds are known; and how much headings differ."""

import numpy as np
import pytest

from deepgps.evaluation.evaluate import measure_heading_spread
from deepgps.evaluation.measures import measure_flipped, measure_flipped_patch

SPACING_M = 0.08
X, Y = (axis.ravel() * SPACING_M - 0.4 for axis in np.meshgrid(np.arange(21), np.arange(11)))
TRUTH = np.column_stack([X, Y])
TURN = np.array([[0.6, -0.8], [0.8, 0.6]])
MIRROR = np.diag([1.0, -1.0])


def fold(share: float) -> np.ndarray:
    """The plane folded along a line of x, so that this share of the neighbourhoods lies face down."""
    crease = X.min() + (1 - share) * (X.max() - X.min())
    return np.column_stack([np.where(crease + 1e-9 < X, 2 * crease - X, X), Y])


@pytest.mark.parametrize("share", [0.0, 0.1, 0.25, 0.5])
def test_a_fold_shows_with_its_share(share):
    assert measure_flipped(TRUTH, fold(share), SPACING_M) == pytest.approx(share)


@pytest.mark.parametrize("motion", [TURN, MIRROR, TURN @ MIRROR], ids=["turned", "mirrored", "both"])
@pytest.mark.parametrize("share", [0.0, 0.25])
def test_a_rigid_motion_changes_nothing(motion, share):
    moved = fold(share) @ motion.T + [3.0, -2.0]
    assert measure_flipped(TRUTH, moved, SPACING_M) == pytest.approx(share)


def test_gaps_in_the_grid_are_left_out_and_order_does_not_matter():
    kept = np.random.default_rng(0).permutation(len(TRUTH))[:150]
    assert measure_flipped(TRUTH[kept], TRUTH[kept], SPACING_M) == 0.0
    assert 0.1 < measure_flipped(TRUTH[kept], fold(0.25)[kept], SPACING_M) < 0.4


def test_positions_without_neighbours_have_no_fold():
    assert measure_flipped(TRUTH[:1], TRUTH[:1], SPACING_M) == 0.0


SCATTERED = np.random.default_rng(1).uniform([0.0, 0.0], [4.0, 3.0], (8000, 2))


@pytest.mark.parametrize("radius_m", [0.3, 0.5])
def test_a_patch_that_is_turned_over_has_its_area(radius_m):
    away = SCATTERED - [2.0, 1.5]
    inside = np.linalg.norm(away, axis=1) < radius_m
    positions = np.where(inside[:, None], [2.0, 1.5] + away * [-1.0, 1.0], SCATTERED)
    found = measure_flipped_patch(SCATTERED, positions)
    assert found == pytest.approx(np.pi * radius_m**2, abs=2 * np.pi * radius_m * 0.1), "a cell wide at its edge"


def test_small_errors_turn_no_patch_over():
    noise = np.random.default_rng(2).normal(0.0, 0.01, SCATTERED.shape)
    assert measure_flipped_patch(SCATTERED, SCATTERED + noise) == 0.0
    assert measure_flipped_patch(SCATTERED[:1], SCATTERED[:1]) == 0.0


def test_the_largest_of_several_patches_counts_and_not_their_sum():
    positions = SCATTERED.copy()
    for centre, radius_m in (([1.0, 1.5], 0.4), ([3.0, 1.5], 0.4)):
        away = SCATTERED - centre
        positions = np.where(np.linalg.norm(away, axis=1)[:, None] < radius_m, centre + away * [1.0, -1.0], positions)
    assert 0.3 < measure_flipped_patch(SCATTERED, positions) < 0.8


def test_headings_that_agree_have_no_spread_whatever_the_map():
    assert measure_heading_spread(np.repeat(fold(0.3)[:, None], 4, axis=1)) == pytest.approx(0.0, abs=1e-12)
    assert measure_heading_spread(fold(0.3)[:, None]) == 0.0


def test_the_spread_is_half_of_what_two_headings_differ_by():
    assert measure_heading_spread(np.stack([TRUTH, TRUTH + (0.3, 0.4)], axis=1)) == pytest.approx(0.25)


def test_the_spread_is_that_of_a_loop_over_positions_and_headings():
    predicted = np.random.default_rng(0).normal(size=(7, 4, 2))
    squares = []
    for place in predicted:
        middle = sum(place) / 4
        squares += [float((one - middle) @ (one - middle)) for one in place]
    assert measure_heading_spread(predicted) == pytest.approx((sum(squares) / 28) ** 0.5)
