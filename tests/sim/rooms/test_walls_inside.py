"""Labyrinths and office floors: whatever the seed, the robot gets everywhere."""

from itertools import product

import mujoco
import numpy as np
import pytest
from pydantic import ValidationError
from scipy import ndimage

from sim.geometry import FreeSpace
from sim.rooms.build import build_room
from sim.rooms.free_space import find_free_space
from sim.rooms.labyrinth import COLUMNS, ROWS, draw_passages
from sim.settings import RoomSettings
from tests.sim.rooms.test_look_alike import texture_of

RADIUS_M, HEIGHT_M = 0.105, 0.37


def build(**settings: object) -> tuple[mujoco.MjModel, FreeSpace]:
    model = build_room(RoomSettings.model_validate(settings)).compile()
    return model, find_free_space(model, RADIUS_M, HEIGHT_M, cell_m=0.05)


def bodies(model: mujoco.MjModel, kind: str) -> list[int]:
    return [body for body in range(model.nbody) if model.body(body).name.rsplit("_", 1)[0] == kind]


def enclosed(space: FreeSpace) -> np.ndarray:
    """The free cells that walls separate from what is outside the room."""
    label = np.zeros(space.free.shape, np.int32)
    ndimage.label(space.free, output=label)
    return space.free & (label != label[0, 0])


def test_passages_lead_from_each_cell_to_each_other_one() -> None:
    for (columns, rows), loops in product([(2, 2), (1, 9), (7, 5), (11, 9)], [0.0, 0.1, 1.0]):
        passages = draw_passages(columns, rows, np.random.default_rng(columns), loops)
        found, new = {(0, 0)}, {(0, 0)}
        while new:
            new = {cell for passage in passages if passage & new for cell in passage} - found
            found |= new
        assert len(found) == columns * rows
        every = columns * (rows - 1) + rows * (columns - 1)
        assert loops > 0.0 or len(passages) == columns * rows - 1
        assert loops < 1.0 or len(passages) == every


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(1, 6))])
def test_the_robot_gets_into_every_cell_of_a_labyrinth(seed: int) -> None:
    model, space = build(kind="labyrinth", seed=seed)
    walls = [body for body in range(model.nbody) if model.body(body).name.startswith("wall_")]
    low, high = model.body_pos[walls, :2].min(axis=0), model.body_pos[walls, :2].max(axis=0)
    columns, rows = np.rint(high - low).astype(int)
    assert COLUMNS[0] <= columns <= COLUMNS[1]
    assert ROWS[0] <= rows <= ROWS[1]
    middles = low + 0.5 + np.stack(np.meshgrid(range(columns), range(rows)), axis=-1)
    assert space.is_reachable(middles).all()
    np.testing.assert_array_equal(space.reachable, enclosed(space))


def test_labyrinths_differ_in_size_textures_and_passages() -> None:
    models = [build_room(RoomSettings(kind="labyrinth", seed=seed)).compile() for seed in range(8)]
    panels = [{texture_of(model, body) for body in bodies(model, "partition")} - {None} for model in models]
    assert {len(textures) for textures in panels} == {2, 3, 4}
    assert len({model.body_pos.tobytes() for model in models}) == len(models)
    plain = build_room(RoomSettings(kind="labyrinth", look_alike=True)).compile()
    assert len({texture_of(plain, body) for body in bodies(plain, "partition")} - {None}) == 1


@pytest.mark.parametrize(
    ("seed", "look_alike"),
    [(0, False), *(pytest.param(seed, seed % 2 == 1, marks=pytest.mark.slow) for seed in (1, 2, 3))],
)
def test_the_robot_gets_into_every_office(seed: int, look_alike: bool) -> None:
    model, space = build(kind="corridor", seed=seed, look_alike=look_alike)
    free = enclosed(space)
    assert space.reachable.sum() > 0.98 * free.sum()
    assert space.reachable.sum() * space.cell_m**2 > 0.5 * 15 * 8
    walk = find_free_space(model, 0.27, 1.7, cell_m=0.1)
    offices = len(bodies(model, "window"))
    assert offices >= 6
    desks = model.body_pos[bodies(model, "desk"), :2]
    assert len(desks) >= offices - 1
    away = np.asarray(ndimage.distance_transform_edt(~walk.reachable)) * walk.cell_m
    column, row = np.rint((desks - walk.origin) / walk.cell_m).astype(int).T
    assert away[row, column].max() < 1.6


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_the_doors_of_an_office_floor_are_alike_and_at_the_corridor(seed: int) -> None:
    model, space = build(kind="corridor", seed=seed)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    doors = bodies(model, "door")
    assert len(doors) >= 6
    assert len({texture_of(model, body) for body in doors}) == 1
    y = data.xpos[doors, 1]
    assert {round(place, 3) for place in y - y.min()} == {0.0, 1.6}
    before = data.xpos[doors, :2] - 0.3 * data.xmat[doors].reshape(-1, 3, 3)[:, :2, 1]
    assert space.is_reachable(before).all()


def test_a_shape_or_size_without_room_for_the_walls_is_refused() -> None:
    for settings, told in (
        ({"kind": "labyrinth", "shape": "l"}, "shape l: a labyrinth"),
        ({"kind": "corridor", "depth_m": 4}, "depth_m 4: a corridor needs at least 6 m"),
        ({"kind": "labyrinth", "width_m": 2.5}, "width_m 2.5: a labyrinth needs at least 3 m"),
        ({"kind": "flat", "width_m": 6}, "width_m 6: a flat needs at least 7 m"),
        ({"kind": "flat", "look_alike": True}, "look_alike: a flat has rooms that are all different"),
    ):
        with pytest.raises(ValidationError, match=told):
            RoomSettings.model_validate(settings)


@pytest.mark.parametrize(
    ("kind", "size"),
    [
        *(("labyrinth", (6.0, 6.0)), pytest.param("corridor", (6.0, 6.0), marks=pytest.mark.slow)),
        *(pytest.param(kind, (15.3, 8.03), marks=pytest.mark.slow) for kind in ("labyrinth", "corridor")),
        *(pytest.param("corridor", size, marks=pytest.mark.slow) for size in ((20.0, 10.0), (28.0, 14.0))),
    ],
)
def test_any_size_works(kind: str, size: tuple[float, float]) -> None:
    _, space = build(kind=kind, width_m=size[0], depth_m=size[1], look_alike=True)
    assert space.reachable.sum() > 0.97 * enclosed(space).sum()
    assert space.reachable.sum() * space.cell_m**2 > 0.3 * size[0] * size[1]
