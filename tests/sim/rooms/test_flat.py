"""Flats: whatever the seed, a home whose rooms a robot can all reach."""

from dataclasses import replace
from functools import cache

import mujoco
import numpy as np
import pytest

from sim.errors import InputError
from sim.rooms import build, flat_plan
from sim.rooms.build import build_room
from sim.rooms.flat import MARK, is_reachable
from sim.rooms.flat_plan import DOOR_M, FlatPlan, draw_plan, draw_size
from sim.rooms.free_space import find_free_space
from sim.rooms.plans import PLANS
from sim.settings import RoomSettings

RADIUS_M, HEIGHT_M = 0.105, 0.37
SMALL_FLAT = RoomSettings(kind="flat", width_m=7.0, depth_m=7.3)


@pytest.fixture(autouse=True)
def _few_plans(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """What holds for the best of a few plans holds for the best of many."""
    if request.node.get_closest_marker("slow") is None:
        monkeypatch.setattr(flat_plan, "DRAWS", 12)


@cache
def draw(seed: int) -> tuple[np.ndarray, FlatPlan]:
    rng = np.random.default_rng(seed)
    size = np.array(draw_size(rng))
    plan = draw_plan(rng, -size / 2, size)
    assert plan is not None
    return size, plan


@cache
def small() -> mujoco.MjSpec:
    return build_room(SMALL_FLAT)


def area(corners: np.ndarray) -> float:
    x, y = corners.T
    return float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum() / 2)


def sides_at(corners: np.ndarray, point: np.ndarray, half_m: float) -> int:
    """Number of sides of a room in whose middle part a doorway is, at least its half width from their ends."""
    found = 0
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        along = (end - start) / np.linalg.norm(end - start)
        x, away = (point - start) @ along, (point - start) @ (-along[1], along[0])
        found += abs(away) < 1e-9 and half_m < x < np.linalg.norm(end - start) - half_m
    return found


def test_twenty_flats_have_the_sizes_the_rooms_and_the_doors_of_homes() -> None:
    for size, plan in map(draw, range(20)):
        assert 60.0 <= np.prod(size) <= 120.0
        assert plan.kinds[0] == "hall"
        assert 4 <= len(plan.kinds) - 1 <= 7
        assert {"living_room", "kitchen", "bedroom", "bathroom"} <= set(plan.kinds)
        areas = [area(corners) for corners in plan.corners]
        assert min(areas) > 1.4
        assert 0.9 * np.prod(size) < sum(areas) < np.prod(size) + 1e-6
        for door in plan.doorways:
            assert DOOR_M[0] <= door.width_m <= DOOR_M[1]
            assert [sides_at(plan.corners[room], door.middle, door.width_m / 2) for room in door.rooms] == [1, 1]


def test_every_room_is_reached_and_a_bathroom_only_from_the_hall() -> None:
    for _, plan in map(draw, range(20)):
        pairs = [door.rooms for door in plan.doorways]
        reached = {0}
        for _ in plan.kinds:
            reached |= {room for pair in pairs if reached & set(pair) for room in pair}
        assert reached == set(range(len(plan.kinds)))
        for room, kind in enumerate(plan.kinds):
            if kind == "bathroom":
                assert [set(pair) for pair in pairs if room in pair] == [{0, room}]


def test_flats_differ_and_some_rooms_are_l_shaped() -> None:
    plans = [draw(seed)[1] for seed in range(20)]
    assert len({len(plan.kinds) for plan in plans}) > 2
    assert len({plan.corners[0].tobytes() for plan in plans}) == len(plans)
    corners = {len(corners) for plan in plans for corners in plan.corners}
    assert corners == {4, 6}


@pytest.mark.parametrize(
    "settings",
    [SMALL_FLAT, *(pytest.param(RoomSettings(kind="flat", seed=seed), marks=pytest.mark.slow) for seed in range(20))],
)
def test_the_robot_gets_through_every_door_into_every_room(settings: RoomSettings) -> None:
    spec = small() if settings is SMALL_FLAT else build_room(settings)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    space = find_free_space(model, RADIUS_M, HEIGHT_M, cell_m=0.05)
    rooms = np.array([site.pos[:2] for site in spec.sites if site.name.startswith(MARK)])
    doors = [body for body in range(model.nbody) if model.body(body).name.startswith("doorway_")]
    assert len(rooms) >= 5
    assert len(doors) >= len(rooms) - 1
    assert space.is_reachable(rooms).all()
    assert space.is_reachable(data.xpos[doors, :2]).all()
    for door in doors:
        place, along = data.xpos[door] + (0.0, 0.0, 1.5), data.xmat[door].reshape(3, 3)[:, 0]
        hit = np.zeros(1, np.int32)
        width = sum(mujoco.mj_ray(model, data, place, side * along, None, 1, -1, hit) for side in (-1, 1))
        assert DOOR_M[0] - 1e-6 <= width <= DOOR_M[1] + 1e-6


def test_a_flat_whose_room_is_shut_is_noticed() -> None:
    spec = small().copy()
    assert is_reachable(spec)
    size, place = (0.6, 0.02, 1.0), (0.0, 0.0, 1.0)
    spec.body("doorway_0").add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=size, pos=place)
    assert not is_reachable(spec)


def test_the_seed_decides_every_byte() -> None:
    def save(spec: mujoco.MjSpec) -> bytes:
        model = spec.compile()
        buffer = np.empty(mujoco.mj_sizeModel(model), np.uint8)
        mujoco.mj_saveModel(model, None, buffer)
        return buffer.tobytes()

    assert save(build_room(SMALL_FLAT)) == save(small())


def test_an_unusable_room_is_drawn_again_and_too_many_are_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    settings, drawn = RoomSettings(kind="labyrinth", width_m=3.0, depth_m=3.0), []

    def accept(after: int) -> None:
        drawn.clear()
        plan = replace(PLANS["labyrinth"], accepts=lambda spec: drawn.append(spec.compile()) or len(drawn) >= after)
        monkeypatch.setitem(PLANS, "labyrinth", plan)

    accept(2)
    taken = build_room(settings).compile()
    np.testing.assert_array_equal(taken.tex_data, drawn[1].tex_data)
    assert taken.tex_data.tobytes() != drawn[0].tex_data.tobytes()
    accept(build.DRAWS + 1)
    with pytest.raises(InputError, match=r"room.seed 0: .* none of 10 draws of a labyrinth"):
        build_room(settings)
