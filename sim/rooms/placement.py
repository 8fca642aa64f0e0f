"""The steps of furnishing: build a piece, find a place for it, put it there, or remove it again; paper the walls."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, TypeVar

import mujoco
import numpy as np

from sim.rng import split
from sim.rooms.furniture import ceiling, textures
from sim.rooms.furniture.decor import rug
from sim.rooms.furniture.primitives import Footprint, Look, box, paper, turned
from sim.rooms.layout import CELL_M, Cost, Layout, Pose
from sim.rooms.outline import Wall

Made = TypeVar("Made")
Piece = Callable[[mujoco.MjsBody, np.random.Generator, Look], Footprint]
Hanging = Callable[[mujoco.MjsBody, np.random.Generator, Look], tuple[float, float, float]]
CHAIR_SPACING_M = 0.58  # Between the middles of chairs: it leaves no dead-end gap [m]
WALKWAY_M = 0.5  # Free floor on each side of a free-standing piece, where the room allows it [m]
Finish = Literal["plaster", "wallpaper", "brick", "tile", "boards"]
Overhead = Callable[[mujoco.MjsBody, np.random.Generator, Look], tuple[float, float]]


@dataclass(frozen=True)
class Room:
    """A room while it is being furnished."""

    spec: mujoco.MjSpec  # Spec that the room is built into
    rng: np.random.Generator  # The room's only random stream
    look: Look  # The room's materials
    layout: Layout  # What is where
    height_m: float  # Height from the floor to the ceiling [m]
    wall_bodies: list[mujoco.MjsBody]  # One body for each wall of the layout; its hangings are children of the body
    names: dict[str, int] = field(default_factory=dict)  # Number of the last body of each name
    # In a room whose places look alike, the first piece of each name, which later ones repeat; None: all pieces
    # differ
    twins: dict[str, Callable[..., Any]] | None = None
    outer: list[Wall] | None = None  # Walls that may have windows; None: all

    @property
    def area_m2(self) -> float:
        """Floor area [m2]."""
        return float(self.layout.inside.mean() * np.prod(np.ptp(self.layout.corners, axis=0)))

    def name(self, kind: str) -> str:
        """A new name for a body of a kind, such as ``desk_2``."""
        self.names[kind] = self.names.get(kind, -1) + 1
        return f"{kind}_{self.names[kind]}"


def stand(room: Room, name: str, piece: Piece, cost: Cost | None = None) -> Pose | None:
    """Place a piece with its back to a wall and, in a room whose places look alike, a twin of it somewhere else."""
    pose = _settle(room, name, piece, lambda it: room.layout.against_wall(it, room.rng, cost))
    if pose is not None and room.twins is not None:
        _settle(room, name, piece, lambda it: room.layout.against_wall(it, room.rng))
    return pose


def stand_first(room: Room, name: str, pieces: Iterable[Piece], cost: Cost | None = None) -> Pose | None:
    """Place the first of the pieces, such as ever narrower ones, for which a wall has room."""
    return next((pose for piece in pieces if (pose := stand(room, name, piece, cost)) is not None), None)


def centre(
    room: Room, name: str, piece: Piece, cost: Cost | None = None, turns: Sequence[float] = (0.0, np.pi / 2)
) -> Pose | None:
    """Place a piece on the open floor, if possible where a person can walk around it."""

    def find(it: Footprint) -> Pose | None:
        roomy = Footprint(it.width_m + 2 * WALKWAY_M, it.depth_m + 2 * WALKWAY_M, it.height_m)
        pose = room.layout.in_the_open(roomy, room.rng, cost, turns)
        return pose if pose is not None else room.layout.in_the_open(it, room.rng, cost, turns)

    return _settle(room, name, piece, find)


def put(room: Room, name: str, piece: Piece, poses: Sequence[Pose], walkable: bool = True) -> Pose | None:
    """Place a piece at the first good one of the given places."""
    return _settle(room, name, piece, lambda it: room.layout.at(it, poses, walkable))


def hang(
    room: Room, name: str, piece: Hanging, cost: Cost | None = None, walls: Sequence[Wall] | None = None
) -> tuple[Wall, float] | None:
    """Hang a fitting on the first wall, in the given or a random order, that has a place for it."""
    choice = room.layout.walls if walls is None else walls
    order = range(len(choice)) if walls is not None else _by_length(room)
    for number in order:
        wall = choice[number]
        body = room.wall_bodies[room.layout.walls.index(wall)].add_body(name=room.name(name))
        x = room.layout.hang(wall, _make(room, name, piece, body), room.rng, cost)
        if x is not None:
            body.pos = (x, 0.0, 0.0)
            _remember(room, name, piece)
            return wall, x
        room.spec.delete(body)
    return None


def fix(room: Room, name: str, piece: Overhead, drop_m: float) -> None:
    """Fix a fitting to the ceiling where no piece is taller than ``drop_m`` [m]."""
    body = room.spec.worldbody.add_body(name=room.name(name))
    at = room.layout.overhang(piece(body, room.rng, room.look), room.rng, drop_m)
    if at is None:
        room.spec.delete(body)
    else:
        body.pos = (at[0], at[1], room.height_m)


def spread(room: Room, at: Pose, size: tuple[float, float]) -> None:
    """Lay a rug around a point, moved and cropped to fit the room's extent."""
    c, s = abs(np.cos(at.yaw)), abs(np.sin(at.yaw))
    extent = np.array((c * size[0] + s * size[1], s * size[0] + c * size[1]))
    middle = np.array((at.x, at.y))
    low, high = room.layout.corners.min(axis=0) + 0.1, room.layout.corners.max(axis=0) - 0.1
    extent = np.minimum(extent, high - low)
    middle = np.clip(middle, low + extent / 2, high - extent / 2)
    body = room.spec.worldbody.add_body(name=room.name("rug"))
    # Where two rugs overlap, the later one is on top.
    body.pos = (middle[0], middle[1], 0.001 * room.names["rug"])
    rug(body, room.rng, room.look, (float(extent[0]), float(extent[1])))


def beams(room: Room, name: str, draw: Callable[..., tuple[float, float]], count: int, width_m: float) -> None:
    """Lay beams or ducts from wall to wall across the room, unevenly spaced."""
    layout, along_x = room.layout, bool(room.rng.random() < 0.5)
    axis = 1 if along_x else 0
    low, high = layout.corners.min(axis=0)[axis], layout.corners.max(axis=0)[axis]
    for number in range(count):
        share = (number + room.rng.uniform(0.2, 0.8)) / count
        place = low + share * (high - low)
        run = _longest_run(layout, place, axis)
        if run is None:
            continue
        middle, length = (run[0] + run[1]) / 2, run[1] - run[0]
        at = (middle, place) if along_x else (place, middle)
        size = (length, width_m) if along_x else (width_m, length)
        body = room.spec.worldbody.add_body(name=room.name(name), pos=(*at, room.height_m))
        draw(body, room.rng, room.look, size)
        layout.footprint(Footprint(*size, 0.0), Pose(*at, 0.0), layout.overhead)[:] = True


def near(point: Pose | np.ndarray) -> Cost:
    """Return a cost: the distance from a pose or a point (2,)."""
    return lambda pose: float(np.hypot(pose.x - point[0], pose.y - point[1]))


def facing(other: Pose) -> Cost:
    """Return a cost for being off the axis of another piece that this one should face."""

    def cost(pose: Pose) -> float:
        away = np.array((pose.x - other.x, pose.y - other.y))
        ahead = float(away @ other.front)
        aside = abs(float(away[0] * other.front[1] - away[1] * other.front[0]))
        turned_away = pose.front @ other.front > -0.9
        return float(aside + 2.0 * turned_away + 3.0 * (ahead < 1.2) + 0.2 * abs(ahead - 3.0))

    return cost


def in_a_corner(room: Room, others: Sequence[Pose] = ()) -> Cost:
    """Return a cost: the distance from the nearest corner of the room without one of the other pieces."""
    corners = room.layout.corners
    for other in others:
        far = np.hypot(*(corners - (other.x, other.y)).T) > 1.5
        corners = corners[far] if far.any() else corners
    return lambda pose: float(np.hypot(*(corners - (pose.x, pose.y)).T).min())


def away_from(*points: np.ndarray) -> Cost:
    """Return a cost for being near any of the points (2,)."""
    return lambda pose: -float(min(np.hypot(pose.x - p[0], pose.y - p[1]) for p in points))


def around(table: Pose, size: tuple[float, float], seats: int, rng: np.random.Generator) -> list[Pose]:
    """Return places for half pushed-in chairs: the long sides, then the ends, of a table of ``size`` (width, depth)."""
    c, s = np.cos(table.yaw), np.sin(table.yaw)
    along = 1 if size[0] < 1.3 else 2
    offsets = [((i - (along - 1) / 2) * CHAIR_SPACING_M, side) for i in range(along) for side in (-1, 1)]
    places = [(x, side * (size[1] / 2 + 0.13), 0.0 if side > 0 else np.pi) for x, side in offsets]
    places += [(side * (size[0] / 2 + 0.13), 0.0, -side * np.pi / 2) for side in (-1, 1)]
    poses = []
    for x, y, turn in places[:seats]:
        yaw = float(table.yaw + turn)
        poses.append(Pose(float(table.x + c * x - s * y), float(table.y + s * x + c * y), yaw))
    return poses


def set_at(
    room: Room, name: str, piece: Piece, poses: Sequence[Pose], jitter_rad: float = 0.0, at_table: bool = False
) -> None:
    """Place a seat, slightly turned, at each of the places that is clear or that its table keeps free."""
    good = room.layout.is_inside if at_table else room.layout.is_clear
    for pose in poses:
        if _settle(room, name, piece, lambda it, pose=pose: pose if good(it, pose) else None):
            turn = pose.yaw + room.rng.uniform(-jitter_rad, jitter_rad)
            room.spec.body(f"{name}_{room.names[name]}").quat = turned(turn)


def surface(
    look: Look, rng: np.random.Generator, finish: Finish, size_m: tuple[float, float], colour: np.ndarray
) -> str:
    """Add a material for one wall of the size (width, height) [m] and return its name."""
    width, height = size_m
    shape = (int(np.clip(60 * height, 64, 256)), int(np.clip(60 * width, 64, 512)))
    if finish == "wallpaper":
        image = textures.wallpaper(rng, shape, colour, textures.vivid(rng), max(int(2 * width), 2))
    elif finish == "brick":
        clay = np.array((0.72, 0.38, 0.28)) * rng.uniform(0.8, 1.15, 3)
        image = textures.brick(rng, shape, clay, int(height / 0.1), width / 0.28)
    elif finish == "tile":
        grid = (int(height / 0.2), max(int(width / 0.2), 2))
        image = textures.tile(rng, shape, 0.5 * colour + 0.45, textures.vivid(rng), grid)
    elif finish == "boards":
        image = textures.wood(rng, (shape[1], shape[0]), colour * (0.95, 0.8, 0.6), max(int(width / 0.2), 3)).transpose(
            1, 0, 2
        )
    else:
        image = textures.plaster(rng, shape, colour, colour[[2, 0, 1]] if rng.random() < 0.3 else None)
    return paper(look.spec, image)


def _settle(room: Room, name: str, piece: Piece, find: Callable[[Footprint], Pose | None]) -> Pose | None:
    body = room.spec.worldbody.add_body(name=room.name(name))
    it = _make(room, name, piece, body)
    pose = find(it)
    if pose is None:
        room.spec.delete(body)
        return None
    _remember(room, name, piece)
    room.layout.take(it, pose)
    body.pos, body.quat = (pose.x, pose.y, 0.0), turned(pose.yaw)
    return pose


def _make(room: Room, name: str, piece: Callable[..., Made], body: mujoco.MjsBody) -> Made:
    """Build a piece into a body; its twins are built from the same random numbers."""
    if room.twins is None:
        return piece(body, room.rng, room.look)
    return room.twins.get(name, piece)(body, split(room.rng, "twins", name), room.look)


def _remember(room: Room, name: str, piece: Callable[..., Any]) -> None:
    if room.twins is not None:
        room.twins.setdefault(name, piece)


def _by_length(room: Room) -> list[int]:
    """Return the walls in a random order in which long ones tend to be first."""
    walls = room.layout.walls
    weight = [wall.length_m * room.rng.uniform(0.3, 1.0) for wall in walls]
    return [int(i) for i in np.argsort(weight)[::-1]]


def _longest_run(layout: Layout, place: float, axis: int) -> tuple[float, float] | None:
    """Return start and end of the longest stretch of room along a line at ``place`` on the given axis [m]."""
    index = int((place - layout.low[axis]) / CELL_M)
    line = layout.inside[index] if axis == 1 else layout.inside[:, index]
    edges = np.flatnonzero(np.diff(np.concatenate([[0], line.astype(int), [0]])))
    runs = edges.reshape(-1, 2)
    if len(runs) == 0:
        return None
    first, last = runs[np.argmax(runs[:, 1] - runs[:, 0])]
    start = layout.low[1 - axis]
    return float(start + first * CELL_M), float(start + last * CELL_M)


PX_PER_M = 60
MOTIF_M, PANEL_M = 0.5, 0.6  # Periods of the wallpaper and of the ceiling [m]
LAMPS_M = 2.4  # Usual distance between lamps [m]


def paper_wall(room: Room, size_m: tuple[float, float]) -> str:
    """Add a material for a wall of the size (width, height) [m] with the room's one motif; return its name."""
    rng = split(room.rng, "wallpaper")
    side = round(MOTIF_M * PX_PER_M)
    colour, second = (0.25 + 0.7 * textures.muted(rng) for _ in range(2))
    return paper(room.spec, repeat(textures.motif(rng, (side, side), colour, second), size_m))


def panel_ceiling(room: Room, body: mujoco.MjsBody, middle: np.ndarray, size_m: tuple[float, float]) -> None:
    """Draw a suspended ceiling of the size (width, depth) [m] into its body, its panels all the same."""
    side = round(PANEL_M * PX_PER_M)
    panel = textures.panel(split(room.rng, "ceiling"), (side, side))
    box(body, (float(middle[0]), float(middle[1]), 0.05), (*size_m, 0.1), paper(room.spec, repeat(panel, size_m)))


def hang_lamps(room: Room, every_m: float = LAMPS_M) -> None:
    """Put the same flat lamp into the ceiling about every ``every_m`` [m], except where an inner wall is in its way."""
    low, high = room.layout.corners.min(axis=0), room.layout.corners.max(axis=0)
    count = np.maximum(np.rint((high - low) / every_m).astype(int), 1)
    step = (high - low) / count
    for x in low[0] + step[0] * (np.arange(count[0]) + 0.5):
        for y in low[1] + step[1] * (np.arange(count[1]) + 0.5):
            at = Pose(float(x), float(y), 0.0)
            if not room.layout.footprint(Footprint(PANEL_M, PANEL_M, 0.0), at, room.layout.overhead).any():
                body = room.spec.worldbody.add_body(name=room.name("lamp"), pos=(x, y, room.height_m))
                ceiling.panel_lamp(body, room.rng, room.look, PANEL_M)


def repeat(motif: np.ndarray, size_m: tuple[float, float]) -> np.ndarray:
    """Repeat a seamless motif (rows, columns, 3) over a wall of the size (width, height) [m]."""
    columns, rows = (max(round(PX_PER_M * side), 8) for side in size_m)
    down, across = -(-rows // motif.shape[0]), -(-columns // motif.shape[1])
    return np.tile(motif, (down, across, 1))[:rows, :columns]
