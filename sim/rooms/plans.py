"""What each kind of room is furnished with, in the order in which a person would carry it in."""

from functools import partial

import numpy as np

from sim.furniture import ceiling, decor, seating, storage, tables
from sim.furniture import fittings as wall
from sim.furniture.primitives import Footprint
from sim.rooms.lab import hang_tags, place_posts
from sim.rooms.layout import Cost, Pose
from sim.rooms.placement import (
    Room,
    around,
    away_from,
    beams,
    centre,
    facing,
    fix,
    hang,
    in_a_corner,
    near,
    put,
    set_at,
    spread,
    stand,
    stand_first,
)


def enter(room: Room, windows: int, roller: bool = False) -> None:
    """Every room: a door whose front stays open, then windows with their curtains and radiators."""
    found = hang(room, "door", wall.door)
    if found is not None:
        room.layout.keep_open(*found, width_m=0.9, depth_m=0.9)
    if roller:
        gate = hang(room, "roller_door", wall.roller_door)
        if gate is not None:
            room.layout.keep_open(*gate, width_m=2.0, depth_m=0.8)
    for _ in range(windows):
        width = float(room.rng.uniform(0.9, 1.7))
        hang(room, "window", partial(wall.dressed_window, width_m=width, curtained=not roller))


def furnish_living_room(room: Room) -> None:
    """Sofa, television and coffee table on a rug; a dining corner; books."""
    rng = room.rng
    enter(room, windows=3)
    _sit(room, float(rng.uniform(1.9, 2.3)))
    _dine(room, 4)
    stand(room, "bookshelf", partial(storage.bookshelf, width_m=float(rng.uniform(0.9, 1.3))), in_a_corner(room))
    stand(room, "cabinet", partial(storage.cabinet, width_m=float(rng.uniform(1.0, 1.5))))
    stand(room, "bookshelf", partial(storage.bookshelf, width_m=float(rng.uniform(0.7, 1.0))))
    stand(room, "armchair", seating.armchair)
    _adorn(room, plants=2, pictures=5, lamp=False)


def furnish_bedroom(room: Room) -> None:
    """A bed between two bedside tables on a rug; wardrobe, dressing mirror, a desk to write at."""
    rng = room.rng
    enter(room, windows=2)
    _sleep(room, 1.6)
    wardrobes = [partial(storage.wardrobe, width_m=float(width)) for width in (rng.uniform(1.4, 1.8), 1.1, 0.8)]
    stand_first(room, "wardrobe", wardrobes, in_a_corner(room))
    _work(room, 1.2)
    stand(room, "cabinet", partial(storage.cabinet, width_m=float(rng.uniform(0.9, 1.2))))
    stand(room, "bookshelf", partial(storage.bookshelf, width_m=0.8))
    stand(room, "armchair", seating.armchair)
    hang(room, "mirror", wall.mirror)
    _adorn(room, plants=1, pictures=4)


def furnish_office(room: Room) -> None:
    """Desks with computers and swivel chairs; files, books, a whiteboard."""
    rng = room.rng
    enter(room, windows=2)
    for _ in range(3):
        _work(room, float(rng.uniform(1.3, 1.6)))
    hang(room, "whiteboard", wall.whiteboard)
    stand(room, "bookshelf", partial(storage.bookshelf, width_m=1.1), in_a_corner(room))
    stand(room, "filing_cabinet", storage.filing_cabinet)
    _dine(room, 4)
    hang(room, "cooler", wall.cooler)
    hang(room, "extinguisher", wall.extinguisher)
    put_stand(room)
    _adorn(room, plants=2, pictures=3, lamp=False)


def furnish_kitchen(room: Room) -> None:
    """A counter with wall cupboards, fridge and oven beside it; an island, a table to eat at."""
    rng = room.rng
    enter(room, windows=2)
    longest = max(w.length_m for w in room.layout.walls)
    width = float(np.clip(rng.uniform(2.4, 3.0), 1.2, 0.6 * longest))
    counters = [partial(tables.counter, width_m=share * width) for share in (1.0, 0.8, 0.6, 0.5)]
    counter = stand_first(room, "counter", counters)
    beside = None if counter is None else near(counter)
    stand(room, "fridge", storage.fridge, beside)
    stand(room, "oven", storage.oven, beside)
    _dine(room, 4)
    if counter is not None and room.area_m2 > 16:
        island = centre(room, "island", tables.island, near(counter.ahead(1.9)))
        if island is not None:
            set_at(room, "stool", seating.stool, [island.ahead(0.6, x) for x in (-0.27, 0.27)])
    stand(room, "cabinet", partial(storage.cabinet, width_m=1.2))
    stand(room, "shelving", partial(storage.shelving, width_m=0.9))
    hang(room, "wall_shelf", wall.wall_shelf)
    hang(room, "wall_shelf", wall.wall_shelf)
    hang(room, "clock", wall.clock)
    _adorn(room, plants=1, pictures=3, lamp=False)


def furnish_studio(room: Room) -> None:
    """One room to live in: bed, sofa and television, a small kitchen, a desk."""
    rng = room.rng
    enter(room, windows=2)
    _sleep(room, 1.4)
    _sit(room, 1.7)
    counter = stand_first(room, "counter", [partial(tables.counter, width_m=width) for width in (1.8, 1.5, 1.2)])
    stand(room, "fridge", storage.fridge, None if counter is None else near(counter))
    stand(room, "wardrobe", partial(storage.wardrobe, width_m=1.2), in_a_corner(room))
    _dine(room, 2)
    _work(room, 1.2)
    stand(room, "bookshelf", partial(storage.bookshelf, width_m=float(rng.uniform(0.8, 1.1))))
    hang(room, "clock", wall.clock)
    _adorn(room, plants=1, pictures=3, lamp=False)


def furnish_workshop(room: Room) -> None:
    """Workbenches below tools, racks, a tool chest, drums, a ladder, a door that rolls up."""
    rng = room.rng
    enter(room, windows=1, roller=True)
    for _ in range(2):
        bench = stand(room, "workbench", partial(tables.workbench, width_m=float(rng.uniform(1.6, 2.1))))
        if bench is not None:
            hang(room, "tool_wall", wall.tool_wall, near(bench))
            set_at(room, "stool", seating.stool, [bench.ahead(0.9, rng.uniform(-0.4, 0.4))])
    for _ in range(2):
        stand(room, "shelving", partial(storage.shelving, width_m=float(rng.uniform(1.1, 1.5))))
    centre(room, "workbench", partial(tables.workbench, width_m=1.6))
    stand(room, "tool_chest", storage.tool_chest)
    stand(room, "wardrobe", partial(storage.wardrobe, width_m=1.2))
    stand(room, "filing_cabinet", storage.filing_cabinet)
    stand(room, "cabinet", partial(storage.cabinet, width_m=1.3))
    for _ in range(2):
        stand(room, "barrel", decor.barrel, in_a_corner(room))
    stand(room, "ladder", decor.ladder)
    stand(room, "crates", decor.crates)
    hang(room, "clock", wall.clock)
    hang(room, "extinguisher", wall.extinguisher)
    hang(room, "whiteboard", wall.whiteboard)
    _adorn(room, plants=0, pictures=2, lamp=False)


def furnish_lab(room: Room) -> None:
    """Desks, a bench and racks around an open floor with posts; AprilTags wherever a wall has room."""
    enter(room, windows=1)
    tags = place_posts(room)
    _work(room, 1.4)
    stand(room, "workbench", partial(tables.workbench, width_m=1.6))
    stand(room, "shelving", partial(storage.shelving, width_m=1.1), in_a_corner(room))
    stand(room, "filing_cabinet", storage.filing_cabinet)
    hang(room, "whiteboard", wall.whiteboard)
    hang(room, "clock", wall.clock)
    hang(room, "extinguisher", wall.extinguisher)
    hang_tags(room, tags)
    _adorn(room, plants=1, pictures=2, lamp=False)


def finish_ceiling(room: Room, kind: str) -> None:
    """Beams or a duct, lamps of different kinds, vents, a smoke detector; nothing in a pattern."""
    rng, height = room.rng, room.height_m
    if kind in ("office", "workshop", "lab"):
        beams(room, "duct", ceiling.duct, 1, 0.4)
        lamps = [ceiling.tube, ceiling.tube, ceiling.tube, ceiling.dish, ceiling.spots]
    else:
        beams(room, "beam", ceiling.beam, int(rng.integers(2, 4)), float(rng.uniform(0.12, 0.2)))
        lamps = [ceiling.globe, ceiling.dish, ceiling.spots, ceiling.chandelier, ceiling.pendant]
        if height > 2.55:
            lamps.append(ceiling.fan)
    count = int(np.clip(round(room.area_m2 / 7.5), 3, 6))
    order = [lamps[i % len(lamps)] for i in rng.permutation(max(count, len(lamps)))[:count]]
    for lamp in order:
        fix(room, lamp.__name__, lamp, height - 1.0)
    for piece in (ceiling.vent, ceiling.vent, ceiling.hatch, ceiling.smoke_detector):
        fix(room, piece.__name__, piece, height - 0.1)


FURNISH = {
    "living_room": furnish_living_room,
    "bedroom": furnish_bedroom,
    "office": furnish_office,
    "kitchen": furnish_kitchen,
    "studio": furnish_studio,
    "workshop": furnish_workshop,
    "lab": furnish_lab,
}


def put_stand(room: Room) -> None:
    """A coat stand near the door."""
    entrance = room.layout.entrance
    stand(room, "coat_stand", decor.coat_stand, None if entrance is None else near(entrance))


def _sit(room: Room, width_m: float) -> None:
    """A sofa, a television that it faces, a coffee table on a rug between them, an armchair at its side."""
    rng = room.rng
    sofa = stand(room, "sofa", partial(seating.sofa, width_m=width_m), _not_in_a_corner(room))
    if sofa is None:
        return
    stand(room, "television", storage.television, facing(sofa))
    table = put(room, "coffee_table", tables.coffee_table, [sofa.ahead(d) for d in (1.25, 1.4)], False)
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


def _sleep(room: Room, width_m: float) -> None:
    """A bed with its head to the wall, a table at each side, a rug at its foot."""
    bed = stand(room, "bed", partial(seating.bed, width_m=width_m), _not_in_a_corner(room))
    if bed is None:
        return
    for side in (-1, 1):
        put(
            room,
            "bedside_table",
            tables.bedside_table,
            [bed.ahead(-0.8, side * (width_m / 2 + 0.29))],
            False,
        )
    spread(room, bed.ahead(0.75), (width_m + 1.0, 1.6))


def _dine(room: Room, seats: int) -> None:
    """A table in the open with chairs around it."""
    rng = room.rng
    small = (0.85, 0.8)
    for size, count in (((float(rng.uniform(1.35, 1.7)), 0.85), 4), (small, 2)):
        if count > seats:
            continue
        piece = partial(_with_chairs, size=size)
        table = centre(room, "dining_table", piece, _open_cost(room), turns=(0.0, np.pi / 2))
        if table is not None:
            chairs = around(table, size, count, rng)
            set_at(room, "chair", seating.chair, chairs, jitter_rad=0.15, at_table=True)
            return


def _with_chairs(body, rng, look, size):
    """A dining table whose footprint leaves room for its chairs."""
    it = tables.dining_table(body, rng, look, width_m=size[0], depth_m=size[1])
    return Footprint(it.width_m + 0.1, it.depth_m + 0.7, it.height_m)


def _work(room: Room, width_m: float) -> None:
    """A desk with its chair, and something on the wall above it."""
    rng, side = room.rng, int(room.rng.choice((-1, 1)))
    desk = stand(room, "desk", partial(tables.desk, width_m=width_m, side=side))
    if desk is None:
        return
    # Left where its owner stood up, or pushed in whole: half-way it all but closes the place below the desk.
    aside, turn = float(rng.uniform(-0.1, 0.1)), np.pi + float(rng.uniform(-0.5, 0.5))
    left_behind = [desk.ahead(ahead, aside, turn) for ahead in (1.02, 1.1, 1.2)]
    if put(room, "office_chair", seating.office_chair, left_behind) is None:
        pushed_in = desk.ahead(0.22, side * tables.KNEES_M, np.pi)
        set_at(room, "office_chair", seating.office_chair, [pushed_in], at_table=True)


def _adorn(room: Room, plants: int, pictures: int, lamp: bool = True) -> None:
    """Plants in corners, a lamp, pictures of all sizes."""
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


def _not_in_a_corner(room: Room):
    return away_from(*room.layout.corners)


def _open_cost(room: Room) -> Cost:
    """A cost: standing close to anything."""
    layout = room.layout
    clear = layout.clearance()
    return lambda pose: -float(min(clear[layout.cell(pose)], 1.6))
