"""Laws of the navigator and its parts, on a robot without physics in a room of two halves with a doorway."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepgps.evaluation.navigate_run import keep_same, score
from deepgps.navigation import position, simulate
from deepgps.navigation.follow import ACCELERATION_MPS2, MAX_SPEED_MPS, MAX_TURN_RPS, Follower
from deepgps.navigation.navigator import Navigator, Outcome
from deepgps.navigation.position import Reckoned, Source, Tracked, Wheels
from deepgps.navigation.route import (
    CELL_M,
    DOOR_M,
    EDGE_M,
    MIN_WAY_M,
    Floor,
    check_goal,
    draw_goals,
    lay_floor,
    measure_along,
)
from deepgps.navigation.simulate import TRUE_POSE, WHEELS, Trip, drive_goal, drive_trip
from deepgps.positioner.pose import Poses
from deepgps.positioner.stored_positioner import INDEX
from sim.alignment import Alignment
from sim.errors import InputError
from sim.geometry import FreeSpace, wrap
from sim.recording.format import open_recording, open_truth
from sim.settings import DeploymentSettings, SimSettings

ODOMETRY = {"wheel_radius_m": 0.033, "track_m": 0.16, "ticks_per_rev": 65536, "slip_per_m": 0.02}
M_PER_TICK = 2 * np.pi * 0.033 / 65536
HERE = Alignment(np.eye(2), np.zeros(2), 1.0)


def make_floor() -> Floor:
    """Two halves of 2.5 m x 2 m, with a doorway of 0.35 m between them."""
    free = np.zeros((45, 105), bool)
    free[2:-2, 2:-2] = True
    free[:, 51:54] = False
    free[20:27, 51:54] = True
    return Floor(np.zeros(2), CELL_M, free)


class ToyRobot:
    """Goes exactly as commanded unless a wall stops it; its image is its pose."""

    period_s, body, odometry = 0.04, SimpleNamespace(radius_m=0.105), ODOMETRY

    def __init__(self, floor: Floor, pose=(0.5, 0.5, 0.0), noise: float = 0.0) -> None:
        self.floor, self._pose, self._ticks, self._noise = floor, np.array(pose, float), np.zeros(2), noise
        self._bumped, self.images = False, 0

    def begin(self, rng):
        self._rng = rng

    def drive(self, speed_mps, turn_rate_rps):
        x, y, yaw = self._pose
        middle = yaw + turn_rate_rps * self.period_s / 2
        ahead = speed_mps * self.period_s
        place = np.array([x + ahead * np.cos(middle), y + ahead * np.sin(middle)])
        self._bumped = not self.floor.is_free(place[None])[0]
        self._pose = np.array([*(self._pose[:2] if self._bumped else place), yaw + turn_rate_rps * self.period_s])
        half = turn_rate_rps * self.period_s * ODOMETRY["track_m"] / 2
        wheels = np.array([ahead - half, ahead + half])
        wheels += self._noise * np.sqrt(np.abs(wheels)) * (self._rng.standard_normal(2) if self._noise else 0.0)
        self._ticks = self._ticks + wheels / M_PER_TICK

    def ticks(self):
        return np.rint(self._ticks).astype(np.int64)

    def clear_m(self, reach_m, turned_rad=0.0):
        along, heading = np.arange(0.0, reach_m, 0.01), self._pose[2] + turned_rad
        way = self._pose[:2] + along[:, None] * [np.cos(heading), np.sin(heading)]
        blocked = ~self.floor.is_free(way)
        return float(along[blocked.argmax()]) if blocked.any() else reach_m

    def bumped(self):
        return self._bumped

    def image(self):
        self.images += 1
        return self._pose.copy()

    def pose(self):
        return np.array([*self._pose[:2], wrap(self._pose[2])])

    def is_free(self, place):
        return bool(self.floor.is_free(place[None])[0])

    def put(self, pose):
        self._pose = np.array(pose, float)

    def pack(self):
        return {"robot_pose": self._pose, "robot_ticks": self._ticks}

    def unpack(self, arrays):
        self._pose, self._ticks, self._bumped = arrays["robot_pose"], arrays["robot_ticks"], False


@pytest.fixture
def seeing(monkeypatch: pytest.MonkeyPatch) -> type:
    """A positioner of images that are poses: it tells them to 5 mm and half a degree."""

    def find(positioner, images: np.ndarray) -> Poses:
        one = np.ones(len(images))
        accepted = np.full(len(images), positioner.accepts)
        return Poses(images[:, :2] + 0.003, images[:, 2], 0.01 * one, radius_68=0.008 * one, accepted=accepted)

    monkeypatch.setattr(position, "find_poses", find)
    return type("Seeing", (), {"mirrored": False, "mapped": None, "accepts": True})


def make_trip(floor: Floor, folder: Path, name: str = TRUE_POSE, goals: int = 4) -> Trip:
    (folder / INDEX).write_text("{}")
    placed = {0: np.array([0.5, 0.5, 1.0])}
    return Trip(
        name=name, folder=folder, floor=floor, goals=draw_goals(floor, 0, goals), placed=placed, alignment=HERE,
        settings=SimSettings(), moved=None, seed=0, parts=folder,
    )  # fmt: skip


def make_toys(floor: Floor, noise: float = 0.0) -> Any:
    """A function that makes robots, whatever the settings."""
    return lambda settings: ToyRobot(floor, noise=noise)


def test_goals_are_on_the_floor_and_apart():
    floor = make_floor()
    goals = draw_goals(floor, 3, 30)
    assert floor.is_free(goals).all() and np.array_equal(draw_goals(floor, 3, 10), goals[:10])
    for one, other in pairwise(goals):
        first, last = floor.find(one), floor.find(other)
        assert first is not None and last is not None and floor.ways(first)[0][tuple(last)] >= MIN_WAY_M


@settings(max_examples=15)
@given(st.integers(0, 1000))
def test_a_route_stays_on_the_floor_and_keeps_away_from_its_edge(seed):
    floor = make_floor()
    start, goal = draw_goals(floor, seed, 2)
    route = floor.plan(start, goal)
    assert route is not None and np.allclose(route[[0, -1]], [start, goal])
    assert floor.is_free(route).all() and np.diff(measure_along(route)).max() < 2 * CELL_M
    inside = np.linalg.norm(route - start, axis=1) > 2 * EDGE_M
    inside &= (np.linalg.norm(route - goal, axis=1) > 2 * EDGE_M) & (np.abs(route[:, 0] - 2.6) > 2 * EDGE_M)
    assert (floor.measure_edge(route[inside]) > 0.15).all()  # in the open


def test_no_route_leads_to_what_is_apart():
    floor = make_floor()
    closed = floor.block(np.array([2.6, 1.15]), 0.3)
    assert floor.plan(np.array([0.5, 0.5]), np.array([4.5, 0.5])) is not None
    assert closed.plan(np.array([0.5, 0.5]), np.array([4.5, 0.5])) is None
    assert closed.plan(np.array([0.5, 0.5]), np.array([np.nan, 0.5])) is None


def test_the_floor_is_along_the_segments(small_recording: Path):
    recording, truth = open_recording(small_recording), open_truth(small_recording)
    floor = lay_floor(recording, truth.pose[:, :2])
    cells = floor.places(np.argwhere(floor.free))
    apart = np.linalg.norm(cells[:, None] - truth.pose[None, :, :2], axis=2).min(axis=1)
    assert apart.max() < 0.11 and truth.free_space.is_free(cells).mean() > 0.8
    lost = truth.pose[:, :2].copy()
    lost[::7] += 5.0  # images that the map has elsewhere leave no floor there
    assert (lay_floor(recording, lost).places(np.argwhere(floor.free[:1])) < 5.0).all()
    assert np.ptp(np.argwhere(lay_floor(recording, lost).free), axis=0).max() * CELL_M < 4.0
    assert not lay_floor(recording, np.full((len(lost), 2), np.nan)).free.any()


@settings(max_examples=15)
@given(st.floats(-0.1, 0.1), st.floats(-0.7, 0.7))
def test_pure_pursuit_converges_to_a_line(aside_m, angle):
    route = np.column_stack([np.linspace(0.0, 4.0, 81), np.zeros(81)])
    follower, pose, speeds = Follower(route, np.full(81, 1.0)), np.array([0.0, aside_m, angle]), [0.0]
    for _ in range(1000):
        command = follower.step(pose, 1.0, 0.04)
        speeds.append(command.speed_mps)
        assert abs(command.turn_rps) <= MAX_TURN_RPS and 0.0 <= command.speed_mps <= MAX_SPEED_MPS
        step, middle = 0.04 * np.array(command), pose[2] + 0.02 * command.turn_rps
        pose += (step[0] * np.cos(middle), step[0] * np.sin(middle), step[1])
        if 2.0 < pose[0] < 3.8:
            assert abs(pose[1]) < 0.01
    assert np.linalg.norm(pose[:2] - [4.0, 0.0]) < 0.02 and np.diff(speeds).max() <= ACCELERATION_MPS2 * 0.04 + 1e-9


def test_wheels_follow_an_arc_as_it_was_driven():
    robot = ToyRobot(make_floor())
    wheels, reckoned = Wheels(ODOMETRY), Reckoned(ODOMETRY, robot.pose())
    start = robot.pose()
    mirrored = Reckoned(ODOMETRY, start * (1, -1, -1), -1)
    for speed_mps, turn_rps in [(0.0, 0.0), *[(0.2, 0.7)] * 40, *[(0.0, -1.0)] * 30, *[(0.1, 0.0)] * 20]:
        robot.drive(speed_mps, turn_rps)
        wheels.move(robot.ticks())
        reckoned.move(robot.ticks())
        mirrored.move(robot.ticks())
    assert np.allclose(wheels.follow(start), robot.pose(), atol=1e-3)
    assert np.allclose(reckoned.pose(), robot.pose(), atol=1e-3)
    assert np.allclose(mirrored.pose() * (1, -1, -1), robot.pose(), atol=1e-3)


@pytest.mark.parametrize("hand", [1, -1])
def test_with_the_true_pose_every_goal_is_reached(hand):
    floor = make_floor()
    robot, sign = ToyRobot(floor, noise=0.02), np.array([1.0, hand, hand])
    robot.begin(np.random.default_rng(0))
    own = floor if hand > 0 else Floor(np.array([0.0, -44 * CELL_M]), CELL_M, floor.free[::-1])
    navigator = Navigator(Source(lambda: robot.pose() * sign, hand), own)
    for goal in draw_goals(floor, 1, 6):
        log = drive_goal(navigator, robot, goal * sign[:2])
        assert log["arrived"] and log["contacts"] == 0 and np.linalg.norm(robot.pose()[:2] - goal) < 0.05
        assert floor.is_free(log["true"][:, :2]).all()


def test_tracked_positions_reach_every_goal_and_find_a_robot_that_was_carried(seeing):
    floor = make_floor()
    robot = ToyRobot(floor, noise=0.02)
    robot.begin(np.random.default_rng(0))
    navigator = Navigator(Tracked(seeing(), ODOMETRY), floor)
    for number, goal in enumerate(draw_goals(floor, 2, 6)):
        if number == 3:
            robot.put(np.array([4.5, 0.4, 2.0]))
        log = drive_goal(navigator, robot, goal)
        assert log["arrived"] and np.linalg.norm(robot.pose()[:2] - goal) < 0.05, number
    assert robot.images > 100


def test_a_robot_that_sees_nothing_refuses(seeing):
    seeing.accepts = False
    navigator = Navigator(Tracked(seeing(), ODOMETRY), make_floor())
    log = drive_goal(navigator, ToyRobot(make_floor()), np.array([1.5, 1.5]))
    assert not log["arrived"] and "unsure where it is" in str(log["reason"])


def test_a_robot_without_position_is_refused(seeing):
    seeing.mirrored = None
    with pytest.raises(InputError, match="gives no yaw"):
        Tracked(seeing(), ODOMETRY)


def test_what_stands_on_the_floor_is_driven_around():
    floor = make_floor()
    robot = ToyRobot(floor.block(np.array([1.25, 1.1]), 0.25), pose=(0.4, 1.1, 0.0))
    log = drive_goal(Navigator(Source(robot.pose), floor), robot, np.array([2.1, 1.1]))
    assert log["arrived"] and log["contacts"] <= 1
    closed = ToyRobot(floor.block(np.array([2.6, 1.15]), 0.3), pose=(0.4, 1.1, 0.0))
    log = drive_goal(Navigator(Source(closed.pose), floor), closed, np.array([4.5, 1.1]))
    assert not log["arrived"] and log["reason"]


def test_goals_off_the_floor_are_refused():
    floor = make_floor()
    check_goal(floor, np.array([0.5, 0.5]), "--to")
    for goal, said in (((np.nan, 0.0), "finite"), ((99.0, 0.0), "no floor"), ((2.6, 0.3), "0.1. m away")):
        with pytest.raises(InputError, match=said):
            check_goal(floor, np.array(goal), "--to")
    with pytest.raises(InputError, match="no floor"):
        draw_goals(replace(floor, free=np.zeros_like(floor.free)), 0, 3)


@pytest.mark.parametrize("name", [TRUE_POSE, WHEELS])
def test_a_trip_continues_with_the_same_bytes_and_drives_again_only_what_differs(tmp_path: Path, name):
    floor = make_floor()
    trip = make_trip(floor, tmp_path, name)
    one = drive_trip(trip, make_toys(floor, noise=0.02), lambda: None)
    for left in (1, 3):
        for number in range(left, len(trip.goals)):
            trip.file(number).unlink()
        other = drive_trip(trip, make_toys(floor, noise=0.02), lambda: None)
        assert all(np.array_equal(one[key], other[key]) for key in one)
    assert set(one["row_goal"]) == set(range(len(trip.goals))) and len(one["image"]) == len(one["image_goal"])
    goals = trip.goals + np.where(np.arange(4) == 2, 0.1, 0.0)[:, None]
    for change, kept in (({}, 4), ({"goals": goals}, 2), ({"placed": {0: np.zeros(3)}}, 0), ({"seed": 1}, 0)):
        drive_trip(trip, make_toys(floor, noise=0.02), lambda: None)
        keep_same(replace(trip, **change))
        assert [trip.file(number).is_file() for number in range(4)] == [number < kept for number in range(4)]
    drive_trip(trip, make_toys(floor, noise=0.02), lambda: None)
    trip.file(1).write_bytes(trip.file(1).read_bytes()[:-1])
    keep_same(trip)
    assert not trip.file(1).is_file()


def test_a_third_of_the_goals_are_through_a_door():
    door = np.array([2.6, 1.15])
    goals = draw_goals(make_floor(), 5, 60, door[None])
    open_floor = np.linalg.norm(goals - door, axis=1) > DOOR_M
    left = goals[:, 0] < door[0]
    pairs = open_floor[1::3] & open_floor[2::3]
    assert pairs.sum() > 10 and (left[1::3] != left[2::3])[pairs].all() and open_floor[2::3][open_floor[1::3]].all()


def test_a_changed_room_is_driven_from_where_the_robot_was(tmp_path: Path):
    floor = make_floor()
    moved = SimSettings(deployment=DeploymentSettings(light=0.5))
    trip = replace(make_trip(floor, tmp_path, goals=7), moved=moved)
    covered = floor.block(trip.goals[5], 0.2)
    make: Any = lambda settings: ToyRobot(floor if settings is trip.settings else covered)  # noqa: E731
    log = drive_trip(trip, make, lambda: None)
    assert log["covered"].tolist() == [number == 5 for number in range(7)]
    first = [log["true"][log["row_goal"] == number][0] for number in range(1, 7)]
    last = [log["true"][log["row_goal"] == number][-1] for number in range(6)]
    assert np.allclose(first, last, atol=0.02)


def test_figures_are_those_of_the_log_in_any_frame(tmp_path: Path):
    floor = make_floor()
    trip = make_trip(floor, tmp_path)
    log = drive_trip(trip, make_toys(floor), lambda: None)
    space = FreeSpace(floor.corner_m, CELL_M, floor.free, floor.free, np.zeros(2), 2.0)
    figures = score(log, trip, space)
    assert figures["success_0_1m"] == figures["success_0_2m"] == 1.0 and 0.8 < figures["spl"] <= 1.0
    assert figures["refused"] == figures["collisions_per_run"] == 0.0 and figures["final_distance_p95_m"] < 0.05
    turn = np.array([[np.cos(1.0), -np.sin(1.0)], [np.sin(1.0), np.cos(1.0)]])
    moved = Alignment(turn, np.array([3.0, -2.0]), 1.0)
    there = replace(trip, goals=moved.invert().apply(trip.goals), alignment=moved)
    assert score(log, there, space) == pytest.approx(figures)
    missed = score(log, replace(trip, goals=trip.goals + (0.15, 0.0)), space)
    assert missed["success_0_1m"] == 0.0 and missed["success_0_2m"] == 1.0
    covered = score({**log, "covered": np.arange(4) > 1, "arrived": np.arange(4) < 2}, trip, space)
    assert (covered["success_0_2m"], covered["covered"]) == (1.0, 2.0)
    refused = score({**log, "arrived": np.zeros(4, bool)}, trip, space)
    assert (refused["success_0_2m"], refused["spl"], refused["refused"]) == (0.0, 0.0, 1.0)


def test_a_navigator_at_its_end_rests():
    robot = ToyRobot(make_floor())
    navigator = Navigator(Source(robot.pose), make_floor())
    navigator.start(np.array([0.5, 0.51]))
    log = drive_goal(navigator, robot, np.array([0.5, 0.51]))
    assert navigator.outcome == Outcome(True, "") and log["time_s"][-1] < 1.0
    assert simulate.LOG_STEPS * robot.period_s == pytest.approx(np.diff(log["time_s"])[0])
