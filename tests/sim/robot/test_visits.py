"""Visits: dead reckoning, and which floor was not visited for longest."""

import numpy as np
import pytest

from sim.robot.headings import UNVISITED_AGE_M, Visits
from sim.robot.model import BURGER

SHORT_DISTANCE_M = 1.0


def wheels(forward_m: float, turned_rad: float) -> np.ndarray:
    """Wheel angles of an arc of this length and turn to the left."""
    half = turned_rad * BURGER.track_m / 2
    return np.array((forward_m - half, forward_m + half)) / BURGER.wheel_radius_m


def start() -> Visits:
    return Visits(BURGER, np.array((3.0, -1.0)))


def follow(visits: Visits, *moves: tuple[float, float], steps: int = 1) -> Visits:
    """Follow arcs of (length, turn), each in some steps."""
    angle = visits.state()["visit_angle"]
    for move in moves:
        for _ in range(steps):
            angle = angle + wheels(*move) / steps
            visits.move(angle)
    return visits


def place(visits: Visits) -> np.ndarray:
    return visits.state()["visit_pose"][:2]


def test_turns_in_place_do_not_move_the_robot():
    visits = follow(start(), (0.0, 2.0), (0.0, -5.0))
    assert np.allclose(place(visits), 0.0, atol=1e-12)


def test_square_closes():
    side = [(1.0, 0.0), (0.0, np.pi / 2)]
    assert np.allclose(place(follow(start(), *side * 4)), 0.0, atol=1e-12)
    assert np.linalg.norm(place(follow(start(), *side * 2))) == pytest.approx(np.sqrt(2))


def test_arc_in_one_step_is_the_arc_in_many():
    for arc in ((0.7, 2.5), (0.7, -0.1), (-0.06, 0.3), (1.5, 5.0)):
        assert np.allclose(place(follow(start(), arc)), place(follow(start(), arc, steps=50)), atol=1e-9)


def test_segment_passed_over_is_fresh_and_what_is_beside_it_stale():
    visits = start()
    angle = visits.state()["visit_angle"] + wheels(2.0, 0.0)
    never = visits.staleness(0.0, SHORT_DISTANCE_M)
    visits.pass_over(angle)
    back, ahead, aside = (visits.staleness(turned, SHORT_DISTANCE_M) for turned in (np.pi, 0.0, np.pi / 2))
    assert back < 1e-6 * ahead
    assert ahead == pytest.approx(never * ((UNVISITED_AGE_M + 2.0) / UNVISITED_AGE_M) ** 2, rel=0.15)  # end passed over
    assert back < aside < ahead * 1.01


def test_floor_becomes_stale_with_the_distance_driven_elsewhere():
    visits = start()
    visits.pass_over(visits.state()["visit_angle"] + wheels(2.0, 0.0))
    rates = []
    for _ in range(4):
        rates.append(visits.staleness(np.pi, SHORT_DISTANCE_M))
        follow(visits, (0.5, 0.0), (-0.5, 0.0))
    assert rates == sorted(rates) and rates[0] < rates[1]


def test_staleness_further_on_is_that_after_having_moved_there():
    visits = start()
    visits.pass_over(visits.state()["visit_angle"] + wheels(1.0, 0.4))
    before = visits.staleness(np.pi / 2, SHORT_DISTANCE_M, 0.3)
    unmoved = visits.state()
    follow(visits, (0.3, 0.0))
    visits.set_state(visits.state() | {"visit_pose": np.array((*place(visits), unmoved["visit_pose"][2]))})
    assert visits.staleness(np.pi / 2, SHORT_DISTANCE_M) == pytest.approx(before)


def test_state_restores_everything():
    visits, rng = start(), np.random.default_rng(0)
    for _ in range(20):
        visits.pass_over(visits.state()["visit_angle"] + wheels(*rng.uniform(-1, 1, 2)))
    other = Visits(BURGER, np.zeros(2))
    other.set_state(visits.state())
    assert all(np.array_equal(other.state()[name], value) for name, value in visits.state().items())
    assert other.staleness(1.0, SHORT_DISTANCE_M) == visits.staleness(1.0, SHORT_DISTANCE_M)


def test_forgotten_floor_was_never_visited():
    visits = start()
    visits.pass_over(visits.state()["visit_angle"] + wheels(2.0, 0.0))
    visits.forget()
    assert visits.state()["visit_cell"].size == 0
    assert visits.staleness(np.pi, SHORT_DISTANCE_M) == visits.staleness(0.3, SHORT_DISTANCE_M)
