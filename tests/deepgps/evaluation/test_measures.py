"""Measures of errors on maps, headings and rooms whose figures are known."""

from types import SimpleNamespace

import numpy as np
import pytest

from deepgps.evaluation.error_field import ErrorField
from deepgps.evaluation.evaluate import MISPLACED_M, measure_heading_spread, measure_misplaced
from deepgps.evaluation.measures import measure_flipped, summarise_yaw

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


def test_only_what_is_farther_off_than_the_limit_is_misplaced():
    rng = np.random.default_rng(0)
    pose = rng.uniform(-5.0, 5.0, (40, 3))
    angle, off = rng.uniform(-np.pi, np.pi, 40), np.r_[np.full(30, 0.99 * MISPLACED_M), np.full(10, 1.01 * MISPLACED_M)]
    places = pose[:, :2] + off[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    assert measure_misplaced(places, SimpleNamespace(pose=pose)) == pytest.approx(0.25)  # pyright: ignore[reportArgumentType]
