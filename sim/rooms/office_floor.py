"""What makes a room an office floor: a corridor, a side corridor, and furnished offices behind doors that are alike."""

from copy import copy
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import mujoco
import numpy as np

from sim.rng import split
from sim.rooms.furniture import fittings as wall
from sim.rooms.furniture import storage, textures
from sim.rooms.furniture.primitives import Look, box, turned
from sim.rooms.groups import adorn, work
from sim.rooms.layout import CELL_M, Layout, Pose
from sim.rooms.outline import Wall
from sim.rooms.placement import Room, hang, in_a_corner, near, paper_wall, stand, surface

WALL_M, CORRIDOR_M, SIDE_CORRIDOR_M = 0.1, 1.6, 1.4
"""Thickness of the walls inside, and widths of the corridor and of the side corridor [m]."""
OFFICE_M = 3.6  # Usual width of an office [m]
DOORWAY_M, DOORWAY_HEIGHT_M, FRAME_M = 0.9, 2.05, 0.07
DOORWAY_CLEARANCE_M = 0.6  # Floor before and behind a doorway that stays open [m]
DOORWAY_PROBABILITY = 0.4  # Probability of a doorway between two neighbouring offices
MIN_WALL_M = 0.3  # Parts of walls shorter than this carry nothing [m]


@dataclass(frozen=True)
class Space:
    """A rectangle of floor between walls [m]."""

    left: float
    right: float
    bottom: float
    top: float

    @property
    def corners(self) -> np.ndarray:
        """Corners (4, 2), counter-clockwise [m]."""
        x, y = (self.left, self.right), (self.bottom, self.top)
        return np.array([(x[0], y[0]), (x[1], y[0]), (x[1], y[1]), (x[0], y[1])])


@dataclass(frozen=True)
class Partition:
    """A wall inside, from ``low`` to ``high`` along one axis and ``at`` a place on the other, with doorways [m]."""

    axis: int  # 0: along x; 1: along y
    at: float  # Middle of its thickness
    low: float  # Where it begins
    high: float  # Where it ends
    doorways: tuple[float, ...] = ()  # Middles of its doorways

    def place(self, along: float, aside: float = 0.0) -> np.ndarray:
        """The point (2,) at a distance along it and aside from its middle [m]."""
        point = np.array((along, self.at + aside))
        return point if self.axis == 0 else point[::-1]

    def span(self, low: float, high: float, deep_m: float = WALL_M) -> tuple[float, float, float, float]:
        """Left, right, bottom and top of the part from ``low`` to ``high`` [m]."""
        (left, bottom), (right, top) = self.place(low, -deep_m / 2), self.place(high, deep_m / 2)
        return float(left), float(right), float(bottom), float(top)


def furnish_office_floor(room: Room) -> None:
    """Raise the walls inside, hang a door beside each doorway of the corridor, and furnish the offices."""
    corridor, offices, partitions = _plan(room)
    for partition in partitions:
        _raise(room, partition)
    room.layout.entrance = Pose((corridor.left + corridor.right) / 2, (corridor.bottom + corridor.top) / 2, 0.0)
    hall = _part(room, corridor)
    for partition in partitions:
        if partition.axis == 0:
            _hang_doors(hall, partition)
    for _ in range(2):
        hang(hall, "extinguisher", wall.extinguisher)
    low, high = room.layout.corners[0, 1], room.layout.corners[2, 1]
    for office in offices:
        part = _part(room, office)
        _furnish(part, [side for side in part.layout.walls if side.middle[1] in (low, high)])
        room.layout.cut_off, room.layout.unswept = part.layout.cut_off, part.layout.unswept


def _furnish(room: Room, outer: list[Wall]) -> None:
    """Furnish one office: a desk or two, shelves, files; ``outer`` are its walls with windows."""
    hang(room, "window", partial(wall.dressed_window, width_m=1.2), walls=outer)
    for _ in range(int(room.rng.integers(1, 3))):
        work(room, 1.3)
    stand(room, "bookshelf", partial(storage.bookshelf, width_m=0.9), in_a_corner(room))
    stand(room, "filing_cabinet", storage.filing_cabinet)
    if room.rng.random() < 0.5:
        hang(room, "whiteboard", wall.whiteboard)
    adorn(room, plants=int(room.rng.integers(2)), pictures=1, lamp=False)


def _plan(room: Room) -> tuple[Space, list[Space], list[Partition]]:
    """Draw the corridor along x, the offices on both sides of it, and the walls inside, all on the layout's cells."""
    rng, layout = room.rng, room.layout
    (left, bottom), (right, top) = layout.corners.min(axis=0).tolist(), layout.corners.max(axis=0).tolist()
    low = _snap(layout, 1, (bottom + top - CORRIDOR_M) / 2 + float(rng.uniform(-0.25, 0.25)))
    corridor = Space(left, right, low, low + CORRIDOR_M)
    with_side = int(rng.integers(2))
    offices, partitions = [], []
    strips = ((bottom, corridor.bottom - WALL_M), (corridor.top + WALL_M, top))
    for number, (low, high) in enumerate(strips):
        edges, side = _divide(layout, rng, number == with_side)
        at = high + WALL_M / 2 if number == 0 else low - WALL_M / 2
        for start, end in pairwise(edges):
            office = Space(start + WALL_M / 2 * (start > left), end - WALL_M / 2 * (end < right), low, high)
            if (start, end) == side:
                continue  # the side corridor is open to the corridor
            reach = (office.right - office.left - DOORWAY_M) / 2 - 0.25
            door = _snap(layout, 0, (office.left + office.right) / 2 + float(rng.uniform(-reach, reach)))
            begins = start - WALL_M / 2 * (side is not None and start == side[1])  # round the side corridor's corners
            ends = end + WALL_M / 2 * (side is not None and end == side[0])
            offices.append(office)
            partitions.append(Partition(0, at, begins, ends, (door,)))
        for edge in edges[1:-1]:
            reach = (high - low - DOORWAY_M) / 2 - 0.3
            door = _snap(layout, 1, (low + high) / 2 + float(rng.uniform(-reach, reach)))
            partitions.append(Partition(1, edge, low, high, (door,) if rng.random() < DOORWAY_PROBABILITY else ()))
    return corridor, offices, partitions


def _divide(
    layout: Layout, rng: np.random.Generator, with_side: bool
) -> tuple[list[float], tuple[float, float] | None]:
    """Divide the floor along x: edges from end to end, and the pair between which the side corridor is, or None."""
    left, right = layout.corners[:, 0].min(), layout.corners[:, 0].max()
    taken = SIDE_CORRIDOR_M + WALL_M if with_side else 0.0
    count = max(round((right - left - taken) / OFFICE_M), 2)
    widths = 1.0 + rng.uniform(-0.08, 0.08, count)
    widths *= (right - left - taken) / widths.sum()
    place = int(rng.integers(1, count)) if with_side else None
    if place is not None:
        widths = np.insert(widths, place, taken)
    inner = [_snap(layout, 0, float(edge)) for edge in left + np.cumsum(widths)[:-1]]
    if place is not None:
        inner[place] = _snap(layout, 0, inner[place - 1] + taken)
    edges = [float(left), *inner, float(right)]
    return edges, None if place is None else (edges[place], edges[place + 1])


def _snap(layout: Layout, axis: int, place: float) -> float:
    return float(layout.low[axis] + round((place - layout.low[axis]) / CELL_M) * CELL_M)


def _raise(room: Room, partition: Partition) -> None:
    """Draw a wall with its doorways, their frames and the wall above them; it is no floor."""
    look, height, layout = room.look, room.height_m, room.layout
    body = room.spec.worldbody.add_body(name=room.name("partition"))
    colour = textures.muted(room.rng) * 0.7 + 0.28
    edges = [partition.low, partition.high]
    for door in partition.doorways:
        edges += [door - DOORWAY_M / 2, door + DOORWAY_M / 2]
    edges.sort()
    for number, (low, high) in enumerate(pairwise(edges)):
        above = DOORWAY_HEIGHT_M if number % 2 else 0.0
        size = (high - low, height - above)
        finish = paper_wall(room, size) if room.twins is not None else surface(look, room.rng, "plaster", size, colour)
        _box(body, partition, (low + high) / 2, (above + height) / 2, (*size, WALL_M), finish, solid=True)
        if not number % 2:
            layout.cells(*partition.span(low, high), layout.inside)[:] = False
            layout.cells(*partition.span(low, high), layout.overhead)[:] = True
            continue
        layout.cells(*partition.span(low, high, WALL_M + 2 * DOORWAY_CLEARANCE_M), layout.kept)[:] = True
        for edge in (low, high):
            _box(body, partition, edge, DOORWAY_HEIGHT_M / 2, (FRAME_M, DOORWAY_HEIGHT_M, WALL_M + 0.04), look.wood)
        size = (DOORWAY_M - FRAME_M, FRAME_M, WALL_M + 0.04)
        _box(body, partition, (low + high) / 2, DOORWAY_HEIGHT_M - FRAME_M / 2, size, look.wood)


def _box(
    body: mujoco.MjsBody,
    partition: Partition,
    along: float,
    z: float,
    size: tuple[float, float, float],
    material: str,
    solid: bool = False,
) -> None:
    """Draw a box of the size (along the wall, up, through the wall) [m] with its middle in the wall."""
    x, y = partition.place(along).tolist()
    sides = (size[0], size[2]) if partition.axis == 0 else (size[2], size[0])
    box(body, (x, y, z), (*sides, size[1]), material, solid=solid)


def _hang_doors(hall: Room, partition: Partition) -> None:
    """Hang the leaf of each doorway, all alike, where it is when it is open: on the corridor's wall beside it."""
    line = [side for side in hall.layout.walls if abs(side.middle[1] - partition.at) < WALL_M]
    for door in partition.doorways:
        middle = partition.place(door)
        sides = sorted(line, key=lambda side: side.distance_m(middle))
        hang(hall, "door", partial(_door, room=hall), near(middle), walls=sides)


def _door(body: mujoco.MjsBody, rng: np.random.Generator, look: Look, room: Room) -> tuple[float, float, float]:
    return wall.door(body, split(room.rng, "door"), look)


def _part(room: Room, space: Space) -> Room:
    """The part of a room in one space: the same floor, with the walls of the space alone, without their doorways."""
    layout = copy(room.layout)
    layout.corners = space.corners
    layout.walls = []
    bodies = []
    for start, end in zip(space.corners, np.roll(space.corners, -1, axis=0), strict=True):
        whole = Wall(start, end)
        count = round(whole.length_m / CELL_M)
        steps = (np.arange(count) + 0.5) * CELL_M
        along = (end - start) / whole.length_m
        behind = start + steps[:, None] * along - whole.normal * WALL_M / 2
        closed = ~room.layout.is_floor(behind)
        changes = np.flatnonzero(np.diff(np.concatenate([[0], closed.astype(int), [0]])))
        for first, last in changes.reshape(-1, 2):
            if (last - first) * CELL_M >= MIN_WALL_M:
                layout.walls.append(Wall(start + first * CELL_M * along, start + last * CELL_M * along))
    for side in layout.walls:
        at = (*side.middle, 0.0)
        bodies.append(room.spec.worldbody.add_body(name=room.name("wall_side"), pos=at, quat=turned(side.yaw)))
    return replace(room, layout=layout, wall_bodies=bodies)
