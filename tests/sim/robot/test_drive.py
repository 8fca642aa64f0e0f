"""The drive: what it takes, what stops it, and that it uses its own sensors only."""

import itertools

import mujoco
import numpy as np
import pytest

from deepgps.evaluation.measures import find_seen
from sim.errors import WorkError
from sim.robot.drive import TOUCH_ENDINGS, UNCERTAIN_DISTANCE_M, Segment, _go_straight
from sim.robot.drive import next_segment as drive_segment
from sim.robot.headings import STOP_DISTANCE_M, Course, DriveMode, Visits
from sim.robot.model import BURGER, CONTROL_PERIOD_S, RADIUS_M, TRACK_M, WHEEL_RADIUS_M
from sim.robot.range_finder import lay_fan
from sim.robot.world import RoomWorld
from sim.rooms.spec import empty_room
from sim.settings import DriveSettings, RoomSettings, SimSettings
from tests.helpers.small_room import HALF_X, HALF_Y, add_box, drive, furnished, walls

SEED, ANGLE = 5, lay_fan(RADIUS_M).angle


def make_world(room: mujoco.MjSpec, pose=(0.0, 0.0, 0.0), **drive_settings) -> RoomWorld:
    world = RoomWorld(SimSettings(drive=DriveSettings(**drive_settings)), room)
    world.place(np.array(pose))
    return world


def take(world, count: int, seed: int = SEED) -> list[Segment]:
    settings = getattr(world, "settings", SimSettings()).drive
    return list(itertools.islice(drive(world, settings, np.random.default_rng(seed)), count))


def next_segment(robot, settings, rng, mode) -> Segment:
    """The next segment of a robot that has visited nothing."""
    return drive_segment(robot, settings, rng, mode, Visits(robot.body, robot.wheel_angle()))


def distances(segment: Segment) -> np.ndarray:
    return (segment.wheel_angle - segment.wheel_angle[0]).mean(axis=1) * WHEEL_RADIUS_M


def same(a: Segment, b: Segment) -> bool:
    return (
        np.array_equal(a.state, b.state)
        and np.array_equal(a.wheel_angle, b.wheel_angle)
        and np.array_equal(a.time, b.time)
        and (a.continues, a.ended, a.dropped, a.mode) == (b.continues, b.ended, b.dropped, b.mode)
    )


class Blind:
    """A world that gives what a robot senses and nothing else."""

    def __init__(self, world: RoomWorld) -> None:
        self.step, self.wheel_angle, self.ranges = world.step, world.wheel_angle, world.ranges
        self.bumped, self.time, self.carry = world.bumped, world.time, world.carry
        self.body = world.body

    def snapshot(self) -> np.ndarray:
        return np.full(9, np.nan)


def test_drive_needs_no_truth():
    seeing, blind = take(make_world(furnished()), 8), take(Blind(make_world(furnished())), 8)
    assert all(np.array_equal(a.wheel_angle, b.wheel_angle) for a, b in zip(seeing, blind, strict=True))
    assert np.isnan(blind[0].state).all()


def test_resumed_drive_is_the_uninterrupted_one():
    rng, world = np.random.default_rng(SEED), make_world(furnished())
    visits = Visits(world.body, world.wheel_angle())
    before = [drive_segment(world, world.settings.drive, rng, DriveMode(), visits)]
    before.append(drive_segment(world, world.settings.drive, rng, before[-1].mode, visits))
    state, chance, mode = world.state(), rng.bit_generator.state, before[-1].mode
    fresh, generator = make_world(furnished()), np.random.default_rng()
    fresh.set_state(state)
    generator.bit_generator.state = chance
    remembered = Visits(fresh.body, fresh.wheel_angle())
    remembered.set_state(visits.state())
    resumed = [drive_segment(fresh, fresh.settings.drive, generator, mode, remembered)]
    resumed.append(drive_segment(fresh, fresh.settings.drive, generator, resumed[-1].mode, remembered))
    whole = take(make_world(furnished()), 4)
    assert all(same(a, b) for a, b in zip(before + resumed, whole, strict=True))


def test_seed_decides_the_drive():
    assert same(take(make_world(walls()), 2, 1)[1], take(make_world(walls()), 2, 1)[1])
    assert not same(take(make_world(walls()), 2, 1)[1], take(make_world(walls()), 2, 2)[1])


@pytest.mark.parametrize(("spacing_m", "speed_mps"), [(0.08, 0.22), (0.03, 0.1)])
def test_samples_are_spaced_as_asked(spacing_m, speed_mps):
    segments = take(make_world(walls(), spacing_m=spacing_m, speed_mps=speed_mps), 5)
    period_m = speed_mps * CONTROL_PERIOD_S + 1e-4
    for segment in segments:
        distance = distances(segment)
        late = distance[1:-1] - spacing_m * np.arange(1, len(distance) - 1)
        assert ((late >= 0) & (late < period_m)).all()
        assert spacing_m / 2 <= distance[-1] - distance[-2] < 1.5 * spacing_m + period_m
        assert np.allclose(np.hypot(*(segment.pose - segment.pose[0])[:, :2].T), distance, atol=2e-3)


def test_longest_length_ends_a_segment():
    segments = take(make_world(walls(), longest_m=0.5), 4)
    length = [segment for segment in segments if segment.ended == "length"]
    assert length
    assert all(distances(segment)[-1] == pytest.approx(0.5, abs=0.006) for segment in length)


def test_endpoint_strategy_takes_start_and_end():
    segments = take(make_world(walls(), strategy="endpoint"), 5)
    assert all(len(segment.time) == 2 for segment in segments)
    assert max(distances(segment)[-1] for segment in segments) > 1.0


def test_stops_before_the_walls():
    for segment in take(make_world(walls()), 12):
        assert segment.ended not in TOUCH_ENDINGS
        x, y = np.abs(segment.pose[-1, :2])
        room = min(HALF_X - x, HALF_Y - y) - RADIUS_M
        assert room > -1e-4
        assert room < STOP_DISTANCE_M + 0.01 or segment.ended != "range"


def test_turning_place_is_one_observation():
    segments = take(make_world(furnished()), 10)
    assert not segments[0].continues
    for last, this in itertools.pairwise(segments):
        assert this.continues == (last.ended not in TOUCH_ENDINGS)
        if this.continues:
            place = this.pose[0] - last.pose[-1]
            assert np.hypot(*place[:2]) < 0.003
            turned = np.diff(this.wheel_angle[0] - last.wheel_angle[-1])[0] * WHEEL_RADIUS_M / TRACK_M
            assert np.isclose(np.exp(1j * turned), np.exp(1j * place[2]), atol=0.02)


def test_stands_still_at_the_ends_of_a_segment():
    world = make_world(walls())
    for _ in range(3):
        next_segment(world, world.settings.drive, np.random.default_rng(SEED), DriveMode())
        body, wheel = world.data.qvel[:6], world.data.qvel[6:]
        assert np.abs(body).max() < 1e-3
        assert np.abs(wheel).max() < 0.02


def test_contact_ends_a_segment_and_drops_its_last_samples():
    room = walls()
    # A bar between two fans of rays: the range finder cannot see it, the bumper feels it.
    add_box(room, "bar", (0.0, 0.8, 0.055), (2.0, 0.02, 0.015))
    segments = take(make_world(room, (0.0, -0.5, 0.0)), 12)
    touched = [segment for segment in segments if segment.ended == "contact"]
    assert touched
    for segment in touched:
        assert len(segment.time) >= 2
        assert segment.pose[-1, 1] < 0.8 - 0.02 - RADIUS_M
        assert not segment.mode.continues
    assert sum(segment.dropped for segment in touched) >= len(touched)
    after = [this for last, this in itertools.pairwise(segments) if last.ended == "contact"]
    assert after and not any(segment.continues for segment in after)


class Toy:
    """A robot on paper before a wall, whose wheels can be blocked or slip from some distance on."""

    body = BURGER

    def __init__(self, fault: str, free_m: float) -> None:
        self.fault, self.free_m = fault, free_m
        self.angle, self.travelled_m, self.now, self.period = np.zeros(2), 0.0, 0.0, 0.02

    def step(self, wheel_speed):
        speed_mps = WHEEL_RADIUS_M * np.mean(wheel_speed)
        forward, held = speed_mps > 0, self.travelled_m >= self.free_m
        if not (self.fault == "blocked" and forward and held):
            self.angle = self.angle + np.asarray(wheel_speed) * self.period
        if not (forward and held):
            self.travelled_m += speed_mps * self.period
        self.now += self.period

    def wheel_angle(self):
        return self.angle.copy()

    def ranges(self, reach_m, turned_rad=0.0):
        wall = (1.0 - self.travelled_m) / np.maximum(np.cos(ANGLE), 1e-6)
        return np.minimum(wall, reach_m)

    def bumped(self):
        return False

    def time(self):
        return self.now

    def carry(self, rng):
        raise AssertionError("nothing wedges it")

    def snapshot(self):
        return np.array([self.travelled_m])


def test_stall_ends_a_segment_and_drops_its_last_samples():
    for fault in ("blocked", "slipping"):
        segment = next_segment(Toy(fault, 0.7), DriveSettings(), np.random.default_rng(0), DriveMode(True))
        assert segment.ended == "stall" and segment.dropped >= 1
        assert distances(segment)[-1] == pytest.approx(segment.state[-1, 0], abs=1e-6)
        assert 0.7 - 2 * UNCERTAIN_DISTANCE_M < distances(segment)[-1] < 0.7
    free = next_segment(Toy("none", np.inf), DriveSettings(), np.random.default_rng(0), DriveMode(True))
    assert free.ended == "range"
    assert distances(free)[-1] == pytest.approx(1.0 - RADIUS_M - 0.04, abs=0.004)


class TouchedOnce(Toy):
    """It touches something after some distance, until it rolls back."""

    def __init__(self, touch_m: float) -> None:
        super().__init__("none", np.inf)
        self.touch_m, self.taken, self.rolled_back, self.period = touch_m, 0, False, CONTROL_PERIOD_S

    def step(self, wheel_speed):
        super().step(wheel_speed)
        self.rolled_back |= np.mean(wheel_speed) < -0.1

    def bumped(self):
        return self.travelled_m >= self.touch_m and not self.rolled_back

    def snapshot(self):
        self.taken += not self.rolled_back
        return super().snapshot()


def test_samples_of_a_segment_too_short_to_keep_are_counted_as_dropped():
    for touch_m in (0.02, 0.05, 0.1):
        toy = TouchedOnce(touch_m)
        segment = next_segment(toy, DriveSettings(spacing_m=0.01), np.random.default_rng(0), DriveMode())
        assert segment.ended == "range"
        assert segment.dropped == toy.taken > touch_m / 0.01


def test_robot_walled_in_is_stuck(monkeypatch):
    monkeypatch.setattr("sim.robot.drive.MAX_ESCAPES", 2)
    room = empty_room()
    reach = RADIUS_M + 0.003 + 0.05
    for name, x, y in (("a", 1, 0), ("b", -1, 0), ("c", 0, 1), ("d", 0, -1)):
        add_box(room, name, (x * reach, y * reach, 0.5), (0.05 + 0.1 * abs(y), 0.05 + 0.1 * abs(x), 0.5))
    with pytest.raises(WorkError, match=r"the robot is stuck at .* s"):
        take(make_world(room), 1)


@pytest.mark.slow  # quick: it leaves a narrow pocket, and is relocated where it is wedged for good
@pytest.mark.parametrize("pinch_m", [0.001, 0.002, 0.004])
def test_robot_wedged_between_two_legs_frees_itself(pinch_m):
    room = walls()
    for name, side in (("left", 1), ("right", -1)):
        add_box(room, name, (0.0, side * (RADIUS_M - pinch_m + 0.02), 0.3), (0.02, 0.02, 0.3))
    world, rng = make_world(room, (0.0, 0.0, 1.5)), np.random.default_rng(SEED)
    first = next_segment(world, world.settings.drive, rng, DriveMode(continues=True))
    assert not first.continues  # it rolled away from where the last segment ended
    for _ in range(2):
        last = next_segment(world, world.settings.drive, rng, DriveMode())
    assert np.hypot(*last.pose[-1, :2]) > 0.5


def test_robot_wedged_for_good_is_relocated_to_the_start(monkeypatch):
    monkeypatch.setattr("sim.robot.drive.MAX_ESCAPES", 2)
    room = walls()
    for name, x, y in (("a", 1, 0), ("b", -1, 0), ("c", 0, 1), ("d", 0, -1)):
        add_box(room, name, (1.2 + 0.158 * x, -0.6 + 0.158 * y, 0.5), (0.05 + 0.1 * abs(y), 0.05 + 0.1 * abs(x), 0.5))
    world, rng = make_world(room, (1.2, -0.6, 0.0)), np.random.default_rng(SEED)
    segment = next_segment(world, world.settings.drive, rng, DriveMode(continues=True))
    assert (segment.relocated, segment.continues) == (1, False)
    assert np.hypot(*(segment.pose[0, :2] - world.free_space.start)) < 0.01
    assert next_segment(world, world.settings.drive, rng, segment.mode).relocated == 0


def test_neither_wheels_nor_clock_notice_that_the_robot_is_relocated():
    world = make_world(walls(), (1.0, 0.5, 0.3))
    for _ in range(50):
        world.step(np.array((3.0, 4.0)))
    angle, time = world.wheel_angle(), world.time()
    world.carry(np.random.default_rng(0))
    assert np.array_equal(world.wheel_angle(), angle) and world.time() == time
    assert np.allclose(world.pose()[:2], world.free_space.start)
    for _ in range(50):
        world.step(np.zeros(2))
    assert np.allclose(world.wheel_angle(), angle, atol=1e-3)
    assert np.allclose(world.pose()[:2], world.free_space.start, atol=1e-3)


def test_leaves_a_narrow_pocket():
    room = walls()
    # A bay 0.28 m wide and closed behind: less room than the stopping distance asks for on three sides.
    add_box(room, "back", (-1.0, 0.0, 0.5), (0.05, 0.3, 0.5))
    for name, side in (("left", 1), ("right", -1)):
        add_box(room, name, (-0.8, side * 0.19, 0.5), (0.2, 0.05, 0.5))
    segments = take(make_world(room, (-0.82, 0.0, 2.0)), 12)
    driven = np.concatenate([segment.pose for segment in segments])
    assert np.abs(driven[:, :2] - (-0.82, 0.0)).max() > 0.5


def test_finds_a_narrow_way_out():
    """A closed cell with a mouth 3 cm wider than the strip the body sweeps: few headings lead out."""
    room = walls()
    for name, pos, half in (
        ("back", (-0.25, 0.0, 0.5), (0.05, 0.3, 0.5)),
        ("left", (0.0, 0.25, 0.5), (0.3, 0.05, 0.5)),
        ("right", (0.0, -0.25, 0.5), (0.3, 0.05, 0.5)),
        ("jamb_left", (0.25, 0.178, 0.5), (0.05, 0.05, 0.5)),
        ("jamb_right", (0.25, -0.178, 0.5), (0.05, 0.05, 0.5)),
    ):
        add_box(room, name, pos, half)
    world = make_world(room)
    for segment in drive(world, world.settings.drive, np.random.default_rng(0)):
        if segment.pose[-1, 0] > 0.5:
            break
        assert world.time() < 300.0


def cupboard(mouth_m: float) -> mujoco.MjSpec:
    """The bare room with a place 0.8 m wide and 1.2 m deep in the north, whose mouth is in its middle."""
    room, half = walls(), (0.8 - mouth_m) / 4
    for side, name in ((-1, "west"), (1, "east")):
        add_box(room, f"cupboard_{name}", (side * 0.45, HALF_Y - 0.6, 0.5), (0.05, 0.6, 0.5))
        add_box(room, f"jamb_{name}", (side * (mouth_m / 2 + half), HALF_Y - 1.15, 0.5), (half, 0.05, 0.5))
    return room


def test_turns_into_an_opening_that_it_passes():
    world = make_world(cupboard(0.3), (-1.5, -0.2, 0.0), enter=1.0)
    settings, rng = world.settings.drive, np.random.default_rng(SEED)
    visits = Visits(world.body, world.wheel_angle())
    past = _go_straight(world, settings, rng, Course(), DriveMode(), visits)
    assert past.ended == "gap"
    assert past.mode == DriveMode(True, "enter", 1)
    assert past.pose[-1, 0] == pytest.approx(0.0, abs=0.08)
    inside = next_segment(world, settings, rng, past.mode)
    assert inside.pose[-1, 1] > HALF_Y - 0.3


def test_without_chance_to_enter_or_search_it_never_stops_at_openings():
    segments = take(make_world(cupboard(0.3), headings="random", enter=0.0, search=0.0), 12)
    assert all(segment.ended != "gap" and segment.mode.kind == "chance" for segment in segments)


@pytest.mark.slow
def test_enters_a_region_that_random_headings_seldom_find():
    """A mouth of 0.36 m in a wall of a bare room: in five minutes, from more seeds than by random headings alone."""
    entered = [seconds_to_enter(seed, 0.36) < 300.0 for seed in range(6)]
    chance = {"headings": "random", "enter": 0.0, "search": 0.0}
    at_random = [seconds_to_enter(seed, 0.36, **chance) < 300.0 for seed in range(6)]
    assert sum(entered) > sum(at_random) + 1


def seconds_to_enter(seed: int, mouth_m: float, **drive_settings) -> float:
    """Seconds until the robot is inside the cupboard; at most five minutes."""
    world = make_world(cupboard(mouth_m), (0.0, -0.8, 0.0), **drive_settings)
    for segment in drive(world, world.settings.drive, np.random.default_rng(seed)):
        x, y = segment.pose[-1, :2]
        if world.time() > 300.0 or (y > HALF_Y - 1.0 and abs(x) < 0.3):
            return world.time()
    raise AssertionError


@pytest.mark.parametrize(("duration_s", "share"), [(100.0, 0.5), pytest.param(400.0, 0.9, marks=pytest.mark.slow)])
def test_driving_is_quiet_and_covers_the_room(duration_s, share):
    world = make_world(furnished(), (0.0, -0.8, 0.0))
    places = [world.pose()[None]]
    for segment in drive(world, world.settings.drive, np.random.default_rng(SEED)):
        places.append(segment.pose)
        if world.time() > duration_s:
            break
    assert not world.data.warning.number.any()
    driven = np.concatenate(places)[:, :2]
    assert share_covered(world, driven) > share
    assert world.is_free(driven).mean() > 0.99


@pytest.mark.slow
def test_exploring_covers_a_room_sooner_than_random_headings():
    assert cover_studio(50.0) > cover_studio(50.0, headings="random") + 0.1


def cover_studio(distance_m: float, **drive_settings) -> float:
    """Share of a generated room that is covered after a distance, a mean over two seeds."""
    shares = []
    for seed in range(2):
        settings = SimSettings(room=RoomSettings(kind="studio", seed=34), drive=DriveSettings(**drive_settings))
        world, rng = RoomWorld(settings, drawn=False), np.random.default_rng(seed)
        world.start(rng)
        driven, driven_m = [], 0.0
        for segment in drive(world, settings.drive, rng):
            driven.append(segment.pose[:, :2])
            driven_m += distances(segment)[-1]
            if driven_m > distance_m:
                break
        shares.append(share_covered(world, np.concatenate(driven)))
    return float(np.mean(shares))


def share_covered(world: RoomWorld, driven: np.ndarray) -> float:
    """Share of the reachable floor within 0.25 m of positions (n, 2) [m]."""
    low, high = world.bounds
    x, y = np.meshgrid(np.arange(low[0], high[0], 0.1), np.arange(low[1], high[1], 0.1))
    cells = np.stack([x, y], axis=-1).reshape(-1, 2)
    cells = cells[world.free_space.is_reachable(cells)]
    return float(find_seen(cells, driven).mean())
