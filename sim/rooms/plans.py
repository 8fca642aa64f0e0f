"""The furniture of each kind of room, in the order in which a person would carry it in."""

from functools import partial

import numpy as np

from sim.rooms import flat_plan
from sim.rooms.flat import furnish_rooms, is_reachable
from sim.rooms.furniture import bathroom, decor, seating, storage
from sim.rooms.furniture import fittings as wall
from sim.rooms.groups import adorn, dine, enter, put_stand, sit, sleep, work
from sim.rooms.lab import hang_tags, place_posts
from sim.rooms.labyrinth import CELL_M, draw_size, raise_labyrinth
from sim.rooms.office_floor import furnish_office_floor
from sim.rooms.placement import (
    Room,
    centre,
    hang,
    hang_lamps,
    in_a_corner,
    near,
    set_at,
    stand,
    stand_first,
)
from sim.rooms.room_plan import RoomPlan, carpet, concrete, no_lamps, tiled_floor, tubes_and_ducts
from sim.settings import RoomKind


def furnish_living_room(room: Room) -> None:
    """Sofa, television and coffee table on a rug; a dining corner; books."""
    rng = room.rng
    enter(room, windows=3)
    sit(room, float(rng.uniform(1.9, 2.3)))
    dine(room, 4)
    stand(room, "bookshelf", partial(storage.bookshelf, width_m=float(rng.uniform(0.9, 1.3))), in_a_corner(room))
    stand(room, "cabinet", partial(storage.cabinet, width_m=float(rng.uniform(1.0, 1.5))))
    stand(room, "bookshelf", partial(storage.bookshelf, width_m=float(rng.uniform(0.7, 1.0))))
    stand(room, "armchair", seating.armchair)
    adorn(room, plants=2, pictures=5, lamp=False)


def furnish_bedroom(room: Room) -> None:
    """A bed between two bedside tables on a rug; wardrobe, dressing mirror, and a desk."""
    rng = room.rng
    enter(room, windows=2)
    sleep(room, 1.6)
    wardrobes = [partial(storage.wardrobe, width_m=float(width)) for width in (rng.uniform(1.4, 1.8), 1.1, 0.8)]
    stand_first(room, "wardrobe", wardrobes, in_a_corner(room))
    work(room, 1.2)
    stand(room, "cabinet", partial(storage.cabinet, width_m=float(rng.uniform(0.9, 1.2))))
    stand(room, "bookshelf", partial(storage.bookshelf, width_m=0.8))
    stand(room, "armchair", seating.armchair)
    hang(room, "mirror", wall.mirror)
    adorn(room, plants=1, pictures=4)


def furnish_office(room: Room) -> None:
    """Desks with computers and swivel chairs; files, books, a whiteboard."""
    rng = room.rng
    enter(room, windows=2)
    for _ in range(3):
        work(room, float(rng.uniform(1.3, 1.6)))
    hang(room, "whiteboard", wall.whiteboard)
    stand(room, "bookshelf", partial(storage.bookshelf, width_m=1.1), in_a_corner(room))
    stand(room, "filing_cabinet", storage.filing_cabinet)
    dine(room, 4)
    hang(room, "cooler", wall.cooler)
    hang(room, "extinguisher", wall.extinguisher)
    put_stand(room)
    adorn(room, plants=2, pictures=3, lamp=False)


def furnish_kitchen(room: Room) -> None:
    """A counter with wall cupboards, a fridge and an oven next to it; an island and a dining table."""
    rng = room.rng
    enter(room, windows=2)
    longest = max(w.length_m for w in room.layout.walls)
    width = float(np.clip(rng.uniform(2.4, 3.0), 1.2, 0.6 * longest))
    counters = [partial(seating.counter, width_m=share * width) for share in (1.0, 0.8, 0.6, 0.5)]
    counter = stand_first(room, "counter", counters)
    beside = None if counter is None else near(counter)
    stand(room, "fridge", storage.fridge, beside)
    stand(room, "oven", storage.oven, beside)
    dine(room, 4)
    if counter is not None and room.area_m2 > 16:
        island = centre(room, "island", seating.island, near(counter.ahead(1.9)))
        if island is not None:
            set_at(room, "stool", seating.stool, [island.ahead(0.6, x) for x in (-0.27, 0.27)])
    stand(room, "cabinet", partial(storage.cabinet, width_m=1.2))
    stand(room, "shelving", partial(storage.shelving, width_m=0.9))
    hang(room, "wall_shelf", wall.wall_shelf)
    hang(room, "wall_shelf", wall.wall_shelf)
    hang(room, "clock", wall.clock)
    adorn(room, plants=1, pictures=3, lamp=False)


def furnish_studio(room: Room) -> None:
    """One room to live in: bed, sofa and television, a small kitchen, a desk."""
    rng = room.rng
    enter(room, windows=2)
    sleep(room, 1.4)
    sit(room, 1.7)
    counter = stand_first(room, "counter", [partial(seating.counter, width_m=width) for width in (1.8, 1.5, 1.2)])
    stand(room, "fridge", storage.fridge, None if counter is None else near(counter))
    stand(room, "wardrobe", partial(storage.wardrobe, width_m=1.2), in_a_corner(room))
    dine(room, 2)
    work(room, 1.2)
    stand(room, "bookshelf", partial(storage.bookshelf, width_m=float(rng.uniform(0.8, 1.1))))
    hang(room, "clock", wall.clock)
    adorn(room, plants=1, pictures=3, lamp=False)


def furnish_workshop(room: Room) -> None:
    """Workbenches below tools, racks, a tool chest, drums, a ladder, a door that rolls up."""
    rng = room.rng
    enter(room, windows=1, roller=True)
    for _ in range(2):
        bench = stand(room, "workbench", partial(seating.workbench, width_m=float(rng.uniform(1.6, 2.1))))
        if bench is not None:
            hang(room, "tool_wall", wall.tool_wall, near(bench))
            set_at(room, "stool", seating.stool, [bench.ahead(0.9, rng.uniform(-0.4, 0.4))])
    for _ in range(2):
        stand(room, "shelving", partial(storage.shelving, width_m=float(rng.uniform(1.1, 1.5))))
    centre(room, "workbench", partial(seating.workbench, width_m=1.6))
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
    adorn(room, plants=0, pictures=2, lamp=False)


def furnish_lab(room: Room) -> None:
    """A desk, a bench and a rack around an open floor with posts; AprilTags wherever a wall has room."""
    enter(room, windows=1)
    tags = place_posts(room)
    work(room, 1.4)
    stand(room, "workbench", partial(seating.workbench, width_m=1.6))
    stand(room, "shelving", partial(storage.shelving, width_m=1.1), in_a_corner(room))
    stand(room, "filing_cabinet", storage.filing_cabinet)
    hang(room, "whiteboard", wall.whiteboard)
    hang(room, "clock", wall.clock)
    hang(room, "extinguisher", wall.extinguisher)
    hang_tags(room, tags)
    adorn(room, plants=1, pictures=2, lamp=False)


def furnish_bathroom(room: Room) -> None:
    """A basin, a toilet, a bathtub or a shower, a washing machine."""
    enter(room, windows=1)
    stand(room, "basin", partial(bathroom.basin, width_m=float(room.rng.uniform(0.55, 0.9))))
    stand(room, "toilet", bathroom.toilet)
    wet = [("bathtub", bathroom.bathtub), ("shower", bathroom.shower)]
    for name, piece in wet[:: int(room.rng.choice((-1, 1)))]:
        if stand(room, name, piece, in_a_corner(room)) is not None:
            break
    stand(room, "washing_machine", bathroom.washing_machine)
    adorn(room, plants=0, pictures=1, lamp=False)


def furnish_hall(room: Room) -> None:
    """The front door, coats, shoes and a mirror."""
    enter(room, windows=0)
    put_stand(room)
    hang(room, "mirror", wall.mirror)
    stand(room, "cabinet", partial(storage.cabinet, width_m=0.9))
    adorn(room, plants=1, pictures=4, lamp=False)


def furnish_flat(room: Room) -> None:
    """A hall, and rooms of several kinds behind its doors."""
    furnish_rooms(room, {**PLANS, **FLAT_PLANS})


PLANS: dict[RoomKind, RoomPlan] = {
    "living_room": RoomPlan((7.0, 4.3, 2.65), ("plaster", "wallpaper", "plaster", "brick"), furnish_living_room),
    "bedroom": RoomPlan(
        (5.2, 4.4, 2.5), ("wallpaper", "plaster", "boards", "plaster"), furnish_bedroom, wooden_ceiling=True
    ),
    "office": RoomPlan(
        (7.2, 5.0, 2.8), ("plaster", "plaster", "boards", "plaster"), furnish_office, carpet, tubes_and_ducts
    ),
    "kitchen": RoomPlan((6.0, 4.6, 2.6), ("tile", "plaster", "plaster", "wallpaper"), furnish_kitchen, tiled_floor),
    "studio": RoomPlan(
        (7.4, 5.2, 2.8), ("brick", "plaster", "plaster", "wallpaper"), furnish_studio, wooden_ceiling=True
    ),
    "workshop": RoomPlan(
        (8.0, 5.6, 3.1), ("brick", "plaster", "boards", "brick"), furnish_workshop, concrete, tubes_and_ducts
    ),
    "lab": RoomPlan((6.0, 5.0, 2.8), ("plaster", "brick", "plaster", "boards"), furnish_lab, carpet, tubes_and_ducts),
    "corridor": RoomPlan((15.0, 8.0, 2.7), ("plaster",), furnish_office_floor, carpet, hang_lamps, panelled=True),
    "labyrinth": RoomPlan(
        (9.0, 7.0, 2.0),
        ("plaster",),
        raise_labyrinth,
        concrete,
        partial(hang_lamps, every_m=CELL_M),
        panelled=True,
        draw_size=draw_size,
    ),
    "flat": RoomPlan(
        (10.0, 8.0, 2.6),
        ("plaster",),
        furnish_flat,
        finish_ceiling=no_lamps,
        draw_size=flat_plan.draw_size,
        accepts=is_reachable,
    ),
}
"""Every kind of room, in the order of ``RoomKind``; new ones go last, as the position is part of the random seed."""
FLAT_PLANS = {
    "hall": RoomPlan((6.0, 1.4, 2.6), ("plaster", "wallpaper"), furnish_hall),
    "bathroom": RoomPlan((3.0, 2.4, 2.6), ("tile", "tile", "plaster"), furnish_bathroom, tiled_floor),
}
"""Kinds that are only parts of a flat."""
