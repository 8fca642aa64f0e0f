"""Groups of furniture that belong together: a sofa and its television, a table and its chairs, a desk and its chair."""

from functools import partial

import numpy as np

from sim.rooms.furniture import decor, seating, storage
from sim.rooms.furniture import fittings as wall
from sim.rooms.furniture.primitives import Footprint
from sim.rooms.layout import Pose
from sim.rooms.placement import (
    Room,
    around,
    away_from,
    centre,
    facing,
    hang,
    in_a_corner,
    near,
    put,
    set_at,
    spread,
    stand,
)


def enter(room: Room, windows: int, roller: bool = False) -> None:
    """Add what every room has: a door with free floor before it, unless it has one, then windows with curtains and
    radiators."""
    found = hang(room, "door", wall.door, walls=room.outer) if room.layout.entrance is None else None
    if found is not None:
        room.layout.keep_open(*found, width_m=0.9, depth_m=0.9)
    if roller:
        gate = hang(room, "roller_door", wall.roller_door)
        if gate is not None:
            room.layout.keep_open(*gate, width_m=2.0, depth_m=0.8)
    for _ in range(windows):
        width = float(room.rng.uniform(0.9, 1.7))
        hang(room, "window", partial(wall.dressed_window, width_m=width, curtained=not roller), walls=room.outer)


def put_stand(room: Room) -> None:
    """Place a coat stand near the door."""
    entrance = room.layout.entrance
    stand(room, "coat_stand", decor.coat_stand, None if entrance is None else near(entrance))


def sit(room: Room, width_m: float) -> None:
    """Place a sofa facing a television, a coffee table on a rug between them, an armchair and a lamp at the sides."""
    rng = room.rng
    sofa = stand(room, "sofa", partial(seating.sofa, width_m=width_m), away_from(*room.layout.corners))
    if sofa is None:
        return
    stand(room, "television", storage.television, facing(sofa))
    table = put(room, "coffee_table", seating.coffee_table, [sofa.ahead(d) for d in (1.25, 1.4)], False)
    if table is not None:
        spread(room, sofa.ahead(1.25), (float(rng.uniform(2.2, 2.6)), float(rng.uniform(1.5, 1.8))))
    sides = rng.permutation((-1.0, 1.0))
    chairs = [
        sofa.ahead(0.5 + d, float(side) * (width_m / 2 + 0.55), float(side) * np.pi / 2)
        for side in sides
        for d in (0.9, 0.6, 0.3)
    ]
    put(room, "armchair", seating.armchair, chairs)
    lamps = [sofa.ahead(-0.15, float(side) * (width_m / 2 + 0.3)) for side in sides]
    put(room, "floor_lamp", decor.floor_lamp, lamps, False)


def sleep(room: Room, width_m: float) -> None:
    """Place a bed with its head to the wall, a table at each side and a rug at its foot."""
    bed = stand(room, "bed", partial(seating.bed, width_m=width_m), away_from(*room.layout.corners))
    if bed is None:
        return
    for side in (-1, 1):
        put(room, "bedside_table", seating.bedside_table, [bed.ahead(-0.8, side * (width_m / 2 + 0.29))], False)
    spread(room, bed.ahead(0.75), (width_m + 1.0, 1.6))


def dine(room: Room, seats: int) -> None:
    """Place a table with chairs around it away from the walls."""
    rng, layout, clear = room.rng, room.layout, room.layout.clearance()
    small = (0.85, 0.8)
    for size, count in (((float(rng.uniform(1.35, 1.7)), 0.85), 4), (small, 2)):
        if count > seats:
            continue
        piece = partial(_with_chairs, size=size)
        table = centre(room, "dining_table", piece, lambda pose: -float(min(clear[layout.cell(pose)], 1.6)))
        if table is not None:
            chairs = around(table, size, count, rng)
            set_at(room, "chair", seating.chair, chairs, jitter_rad=0.15, at_table=True)
            return


def _with_chairs(body, rng, look, size):
    """Build a dining table whose footprint leaves room for its chairs."""
    it = seating.dining_table(body, rng, look, width_m=size[0], depth_m=size[1])
    return Footprint(it.width_m + 0.1, it.depth_m + 0.7, it.height_m)


def work(room: Room, width_m: float) -> None:
    """Place a desk and its chair."""
    rng, side = room.rng, int(room.rng.choice((-1, 1)))
    desk = stand(room, "desk", partial(seating.desk, width_m=width_m, side=side))
    if desk is None:
        return
    # The chair is where its user left it, or fully pushed in: half-way it would nearly close the space below the desk.
    aside, turn = float(rng.uniform(-0.1, 0.1)), np.pi + float(rng.uniform(-0.5, 0.5))
    left_behind = [desk.ahead(ahead, aside, turn) for ahead in (1.02, 1.1, 1.2)]
    if put(room, "office_chair", seating.office_chair, left_behind) is None:
        pushed_in = desk.ahead(0.22, side * seating.KNEES_M, np.pi)
        set_at(room, "office_chair", seating.office_chair, [pushed_in], at_table=True)


def adorn(room: Room, plants: int, pictures: int, lamp: bool = True) -> None:
    """Add plants in corners, a floor lamp, and pictures of all sizes."""
    rng = room.rng
    grown: list[Pose] = []
    for _ in range(plants):
        plant = stand(room, "plant", decor.plant, in_a_corner(room, grown))
        grown += [] if plant is None else [plant]
    if lamp:
        stand(room, "floor_lamp", decor.floor_lamp, in_a_corner(room))
    for _ in range(pictures):
        size = (float(rng.uniform(0.45, 1.2)), float(rng.uniform(0.45, 0.85)))
        hang(room, "picture", partial(wall.picture, z=float(rng.uniform(1.55, 1.8)), size=size))
