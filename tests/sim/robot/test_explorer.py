"""The robot's own map, and the planners that drive by it."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy import ndimage

from deepgps.evaluation.measures import find_seen
from sim.files.checksums import read_arrays, write_arrays
from sim.recording import chunks
from sim.rng import stream
from sim.robot.drive import DriveMode, next_segment
from sim.robot.explorer import AIMS, MOST_AIMS, Explorer, make_planner
from sim.robot.grid_map import CELL_M, CELLS, CONTACT, FLOOR_CELL_M, GridMap, find, scan
from sim.robot.scan_match import match
from sim.robot.world import RoomWorld
from sim.settings import DriveSettings, SimSettings
from tests.helpers.exact_robot import ExactRobot
from tests.helpers.small_room import HALF_X, HALF_Y, add_box, drive, furnished, walls

START = np.array((0.3, -0.6, 0.7))


def make_world(room: mujoco.MjSpec, headings: str = "map") -> RoomWorld:
    settings = SimSettings(drive=DriveSettings(headings=headings, samples=120))  # pyright: ignore[reportArgumentType]
    return RoomWorld(settings, room)


class TouchingRobot(ExactRobot):
    """It touches what it runs into, also where no ray meets it."""

    def bumped(self) -> bool:
        return not self.world.is_free(self.pose[:2])


def explore(
    world: RoomWorld, segments: int, seed: int = 0, robot: ExactRobot | None = None
) -> tuple[Explorer, np.ndarray]:
    """A planner after so many segments of a robot that goes exactly, and where images were taken (n, 2) [m]."""
    robot, settings, rng = robot or ExactRobot(world, START), world.settings.drive, np.random.default_rng(seed)
    planner, mode, places = make_planner(robot, settings), DriveMode(), []
    for _ in range(segments):
        segment = next_segment(robot, settings, rng, mode, planner)
        mode = segment.mode
        places.append(segment.pose[:, :2])
    assert isinstance(planner, Explorer)
    return planner, np.concatenate(places)


def to_own(places: np.ndarray) -> np.ndarray:
    """Places (n, 2) [m] of the room in the frame of a robot that started at START."""
    cos, sin = np.cos(START[2]), np.sin(START[2])
    return (places - START[:2]) @ np.array(((cos, -sin), (sin, cos)))


def to_room(places: np.ndarray) -> np.ndarray:
    cos, sin = np.cos(START[2]), np.sin(START[2])
    return START[:2] + places @ np.array(((cos, sin), (-sin, cos)))


def floor_cells(world: RoomWorld) -> np.ndarray:
    """Places (n, 2) [m] all over the floor that the robot can reach."""
    space = world.free_space
    return space.origin + np.argwhere(space.reachable)[::7, ::-1] * space.cell_m


@pytest.mark.parametrize("room", [walls, furnished])
def test_cells_agree_with_the_floor_up_to_a_cell(room):
    world = make_world(room())
    planner, _ = explore(world, 8)
    floor, space = planner._grid.read_floor(world.body.radius_m), world.free_space
    blocked_m, free_m = (
        np.asarray(ndimage.distance_transform_edt(cells)) * space.cell_m for cells in (space.free, ~space.free)
    )
    places = to_room(floor.places(floor.fits))
    column, row = np.rint((places - space.origin) / space.cell_m).astype(int).T
    assert free_m[row, column].max() < FLOOR_CELL_M
    sure = np.argwhere(space.reachable & (blocked_m > FLOOR_CELL_M))[:, ::-1] * space.cell_m + space.origin
    row, column, inside = floor.find(to_own(sure))
    assert (inside & floor.fits[row, column]).mean() > 0.98


@pytest.mark.parametrize("headings", ["map", "frontier"])
def test_chunk_continued_from_its_file_is_the_uninterrupted_one(headings, tmp_path: Path, monkeypatch):
    monkeypatch.setattr(chunks, "CHUNK", 40)
    whole, rng, chunk = make_world(furnished(), headings), stream(0, "drive"), None
    planner, mode, driven = None, DriveMode(), []
    whole.start(rng)
    planner = make_planner(whole, whole.settings.drive)
    while sum(map(len, driven)) < 100:
        segment = next_segment(whole, whole.settings.drive, rng, mode, planner)
        mode = segment.mode
        driven.append(segment.state[1:] if segment.continues else segment.state)
    parts = []
    for number in range(2):
        fresh = make_world(furnished(), headings)
        chunk = chunks.drive_chunk(fresh, fresh.settings, stream(0, "drive"), chunk)
        write_arrays(tmp_path / f"{number}.npz", chunk)
        chunk = read_arrays(tmp_path / f"{number}.npz")
        parts.append(chunk["state"])
    joined = np.concatenate(parts)
    assert np.array_equal(joined, np.concatenate(driven)[: len(joined)])


def test_share_that_is_unseen_by_its_own_map_is_the_true_one():
    world, apart = make_world(furnished()), []
    for segments in (4, 8, 16, 32):
        planner, places = explore(world, segments)
        likely, low, high = planner.measure_unseen()
        true = 1.0 - find_seen(floor_cells(world), places).mean()
        assert low - 0.01 <= true <= high + 0.01 and low <= likely <= high
        apart.append(likely - true)
    assert np.abs(apart).max() < 0.06 and abs(apart[-1]) < 0.01
    assert true < 0.02


def test_drive_is_done_when_so_much_is_seen_even_within_a_chunk():
    settings = SimSettings.model_validate({"drive": {"headings": "map", "samples": 5000, "until": {"unseen": 0.3}}})
    world, chunk = RoomWorld(settings, furnished()), None
    while chunk is None or chunk["unseen"][0] > 0.3:
        before, chunk = chunk, chunks.drive_chunk(world, settings, stream(0, "drive"), chunk)
    assert before is None or before["unseen"][0] > 0.3
    assert chunk["observations"] % chunks.CHUNK != 0 and chunk["observations"] < 1000


@pytest.mark.slow
def test_stays_on_free_floor_and_covers_it_sooner_than_today_s_drive():
    images = {}
    for headings in ("map", "explore"):
        world = make_world(furnished(), headings)
        world.place(START)
        cells, places = floor_cells(world), np.empty((0, 2))
        for segment in drive(world, world.settings.drive, np.random.default_rng(0)):
            places = np.concatenate([places, segment.pose[segment.continues :, :2]])
            if find_seen(cells, places).mean() >= 0.99:
                break
        images[headings] = len(places)
        assert world.is_free(places).mean() > 0.99
    assert images["map"] < 0.8 * images["explore"]


def test_part_behind_a_grating_is_reported_with_its_place():
    """Bars across the room, through which rays see floor that the robot cannot get to."""
    room = walls()
    for number in range(round(2 * HALF_Y / 0.15) + 1):
        add_box(room, f"bar_{number}", (1.0, -HALF_Y + 0.15 * number, 0.5), (0.01, 0.01, 0.5))
    planner, places = explore(make_world(room), 25)
    assert places[:, 0].max() < 1.0
    (x, y, area) = max(planner.unreached(), key=lambda part: part[2])
    (place,) = to_room(np.array([[x, y]]))
    assert 1.1 < place[0] < HALF_X and abs(place[1]) < 0.6
    assert area > 0.5
    planner, _ = explore(make_world(walls()), 25)
    assert planner.unreached().size == 0


def test_floor_below_a_shelf_that_rays_pass_is_no_floor_to_see_but_may_be_some():
    room = walls()
    add_box(room, "shelf", (0.7, 0.1, 0.2), (0.7, 0.4, 0.01))
    world = make_world(room)
    planner, places = explore(world, 45, robot=TouchingRobot(world, START))
    likely, low, high = planner.measure_unseen()
    assert find_seen(floor_cells(world), places).mean() > 0.97
    assert low <= likely < 0.01
    assert high > 0.02


@pytest.mark.parametrize("width_m", [0.45, 1.2])
def test_touches_cut_off_floor_behind_a_long_front_but_not_behind_a_door(width_m: float):
    """Two rooms, of 2 m x 2 m, with an opening all of which was touched from the first."""
    grid, ahead = GridMap(), np.array((0.0, 0.0, 0.0))
    grid.seen[grid._use(np.full(2, -1.0), np.array((3.0, 1.0)))] = -1
    x, y = np.meshgrid(np.arange(1.0, 1.1, CELL_M), np.arange(-1.2, 1.2, CELL_M / 2))
    wall = np.abs(y) > width_m / 2 + 0.105
    grid.seen[find(np.stack([x[wall], y[wall]], axis=-1))] = 3
    grid.pass_over(np.array((-0.5, 0.0)), np.array((0.5, 0.0)))
    for aside in np.arange(-width_m / 2, width_m / 2 + 0.01, 0.05):
        grid.touch(ahead + (0.9, aside, 0.0), 0.105)
    grid.seen[grid.seen > 9] = -1
    floor = grid.read_floor(0.105)
    row, column, _ = floor.find(np.array((2.0, 0.0)))
    assert np.isfinite(floor.way(floor.passes > 0)[row, column]) == (width_m < 0.6)
    assert floor.shut.any() == (width_m > 0.6) and floor.open[row, column]


def test_goal_that_was_aimed_at_in_vain_is_left_alone_for_a_while():
    planner, _ = explore(make_world(walls()), 1)

    def is_goal() -> bool:
        return bool(next(planner._list_goals(planner._grid.read_floor(planner._body.radius_m)))[row, column].any())

    floor = planner._grid.read_floor(planner._body.radius_m)
    (goal, *_) = floor.places(next(planner._list_goals(floor)))
    row, column, _ = floor.find(goal)
    for _ in range(MOST_AIMS):
        planner._aims = np.vstack([planner._aims, goal])
        assert is_goal()
    planner._aims = np.vstack([planner._aims, goal])
    assert not is_goal()
    planner._aims = np.vstack([planner._aims, np.zeros((AIMS, 2))])[-AIMS:]
    assert is_goal()


@pytest.mark.parametrize("slip", [(0.03, -0.02, 0.1), (0.3, 0.2, -1.4)])
def test_pose_is_found_again_after_a_slip(slip):
    world = make_world(furnished())
    planner, _ = explore(world, 6)
    robot = ExactRobot(world, (0.0, -0.7, 2.0))
    true = np.array((*to_own(robot.pose[None, :2])[0], robot.pose[2] - START[2]))
    found = match(planner._grid, true + slip, scan(robot), doubtful=True)
    assert np.hypot(*(found - true)[:2]) < 2 * CELL_M
    assert abs(found[2] - true[2]) < np.radians(2.0)


def test_robot_carried_to_its_start_finds_its_heading():
    world = make_world(furnished())
    planner, _ = explore(world, 6)
    robot = ExactRobot(world, (*START[:2], -1.1))
    planner.forget()
    planner._scan(robot)
    assert np.hypot(*planner._pose[:2]) < 2 * CELL_M
    assert abs((planner._pose[2] - (robot.pose[2] - START[2]) + np.pi) % (2 * np.pi) - np.pi) < np.radians(2.0)


def test_what_was_touched_is_an_obstacle_for_a_while():
    world, grid = make_world(walls()), GridMap()
    robot, pose, ahead = ExactRobot(world), np.zeros(3), np.array([[0.13, 0.0]])
    seen = scan(robot)
    grid.add(pose, seen)
    grid.touch(pose, 0.105)
    assert (grid.seen[find(ahead)] > 0).all()
    for _ in range(CONTACT):
        grid.add(pose, seen)
    assert not (grid.seen[find(ahead)] > 0).any()


def test_floor_outside_the_grid_is_left_out():
    grid = GridMap()
    edge_m = CELLS / 2 * CELL_M
    grid.add(np.array((edge_m - 0.1, 0.0, 0.0)), scan(ExactRobot(make_world(walls()))))
    grid.pass_over(np.array((edge_m - 0.5, 0.0)), np.array((edge_m + 3.0, 0.0)))
    assert (grid.high <= CELLS).all() and (grid.passes > 0).any()
