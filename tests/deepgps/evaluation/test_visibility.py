import numpy as np
import pytest

from deepgps.evaluation.measures import measure_visible
from sim.occupancy import FreeSpace

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


def test_a_place_in_a_wall_reaches_nothing():
    assert measure_visible(make_space([(0, 4, 0, 1)]), np.array([(2.0, 2.0), (-9.0, 0.0)])) == pytest.approx(0.0)
