import inspect
from collections.abc import Callable
from functools import partial
from itertools import product
from types import ModuleType

import mujoco
import numpy as np

from sim.rooms.free_space import find_free_space
from sim.rooms.furniture import bathroom, ceiling, decor, fittings, seating, storage
from sim.rooms.furniture.primitives import COLLISION_GROUP, make_look

SIZES = {
    "dressed_window": {"width_m": 1.3},
    "picture": {"z": 1.6, "size": (0.8, 0.6)},
    "panel_lamp": {"side_m": 0.6},
    "beam": {"size": (3.0, 0.15)},
    "duct": {"size": (0.4, 3.0)},
}
PARTS = {"window", "curtains", "radiator", "rug"}
"""Pieces of others, or without a height."""


def _list_pieces(*modules: ModuleType) -> dict[str, Callable]:
    """Every public piece of some modules, with its size if it needs one."""
    found = {
        name: partial(piece, **SIZES.get(name, {}))
        for module in modules
        for name, piece in inspect.getmembers(module, inspect.isfunction)
        if piece.__module__ == module.__name__ and not name.startswith("_") and name not in PARTS
    }
    assert len(found) >= 11
    return found


STANDING_PIECES = _list_pieces(seating, storage, decor, bathroom)
HANGING_PIECES = _list_pieces(fittings)
OVERHEAD_PIECES = _list_pieces(ceiling)
SEEDS = range(4)


def _build(piece, seed: int):
    spec, rng = mujoco.MjSpec(), np.random.default_rng(seed)
    body = spec.worldbody.add_body(name="piece")
    cover = piece(body, rng, make_look(spec, rng))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    turn = data.geom_xmat.reshape(-1, 3, 3)
    half = np.einsum("nij,nj->ni", np.abs(turn), model.geom_aabb[:, 3:])
    return cover, model, data.geom_xpos - half, data.geom_xpos + half


def test_a_standing_piece_keeps_to_its_footprint_and_stands_on_the_floor():
    for name, seed in product(STANDING_PIECES, SEEDS):
        it, model, low, high = _build(STANDING_PIECES[name], seed)
        slack = np.array((it.width_m / 2 + 0.04, it.depth_m / 2 + 0.04))
        assert (low[:, :2] > -slack).all()
        assert (high[:, :2] < slack).all()
        assert -1e-6 < low[:, 2].min() < 0.01
        assert high[:, 2].max() < it.height_m + 0.15
        solid = model.geom_contype != 0
        assert solid.any()
        assert (model.geom_group[solid] == COLLISION_GROUP).all()
        # What collides covers what is drawn, up to what stands on it, to within a few centimetres.
        assert low[solid, :2].min() < low[~solid, :2].min() + 0.16
        assert high[solid, :2].max() > high[~solid, :2].max() - 0.16


def test_a_hanging_piece_keeps_to_its_rectangle_on_the_wall():
    for name, seed in product(HANGING_PIECES, SEEDS):
        (width, bottom, top), _, low, high = _build(HANGING_PIECES[name], seed)
        assert low[:, 0].min() > -width / 2 - 0.02
        assert high[:, 0].max() < width / 2 + 0.02
        assert bottom - 0.02 < low[:, 2].min()
        assert high[:, 2].max() < top + 0.02
        assert high[:, 1].max() < 1e-6
        assert low[:, 1].min() > -0.26


def test_a_ceiling_piece_hangs_below_the_ceiling():
    for name, seed in product(OVERHEAD_PIECES, SEEDS):
        size, model, low, high = _build(OVERHEAD_PIECES[name], seed)
        assert high[:, 2].max() < 0.011
        assert low[:, 2].min() > -1.0
        assert (high[:, :2].max(axis=0) < np.array(size) / 2 + 0.2).all()
        assert not model.geom_contype.any()


def _drive_under(piece) -> np.ndarray:
    """Where a robot of 0.105 m radius and 0.37 m height gets to, as offsets (N, 2) from the middle of a piece."""
    spec, rng = mujoco.MjSpec(), np.random.default_rng(0)
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=(0, 0, 1))
    for x, y, w, d in ((2, 0, 0.1, 2), (-2, 0, 0.1, 2), (0, 2, 2, 0.1), (0, -2, 2, 0.1)):
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, pos=(x, y, 0.5), size=(w, d, 0.5))
    piece(spec.worldbody.add_body(), rng, make_look(spec, rng))
    space = find_free_space(spec.compile(), 0.105, 0.37)
    row, column = np.nonzero(space.reachable)
    return space.origin + np.stack((column, row), axis=1) * space.cell_m


def test_one_drives_under_tables_and_benches_but_not_under_seats():
    def nearest(piece) -> float:
        return float(np.abs(_drive_under(piece)).max(axis=1).min())

    assert nearest(seating.dining_table) < 0.02
    assert nearest(seating.chair) > 0.12
    assert nearest(seating.office_chair) > 0.12
    assert nearest(seating.coffee_table) > 0.3
    assert nearest(seating.sofa) > 0.5


def test_a_desk_has_room_for_knees():
    places = _drive_under(seating.desk)
    under = (np.abs(places[:, 0]) < 0.6) & (np.abs(places[:, 1]) < 0.2)
    assert under.sum() > 200
