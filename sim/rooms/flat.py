"""What makes a room a flat: a hall and furnished rooms, each with walls, floor and ceiling of its own, and doors."""

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise

import mujoco
import numpy as np

from sim.rooms.flat_plan import Doorway, draw_plan
from sim.rooms.free_space import find_free_space
from sim.rooms.furniture import textures
from sim.rooms.furniture.primitives import Footprint, box, make_look, paper, turned
from sim.rooms.layout import CELL_M, Layout, wall_pose
from sim.rooms.outline import Wall, slabs
from sim.rooms.placement import Room, surface
from sim.rooms.room_plan import RoomPlan, few_lamps

LINING_M = 0.05  # Thickness of one room's side of a wall [m]
FLOOR_M = 0.001  # Thickness of a room's own floor [m]
DOOR_HEIGHT_M, FRAME_M, LEAF_M = 2.05, 0.05, 0.04  # Height of a doorway, width of its frame, thickness of its door [m]
OPENING_DEG, AJAR_DEG, AJAR_PROBABILITY = (80.0, 90.0), (55.0, 72.0), 0.35  # How far doors are open
APPROACH_M = 0.6  # Floor that stays open on the side of a doorway to which its door does not open [m]
ROBOT_M = (0.15, 0.4)  # Radius and height of a robot that must get into every room [m]
CHECK_M = 0.05  # Side of the cells in which that is checked [m]
MARK, MARK_GROUP = "in_", 5
"""A site of a flat is in the middle of the largest free floor of a room: ``in_<kind>_<number>``; no camera sees it."""
Opening = tuple[Wall, float, float, float]
"""A doorway as a room has it: its wall, its ends along it, and the depth of floor that stays open before it [m]."""


def furnish_rooms(room: Room, plans: Mapping[str, RoomPlan]) -> None:
    """Divide an empty flat into a hall and rooms; raise their walls, hang their doors, and furnish them."""
    low, high = room.layout.corners.min(axis=0), room.layout.corners.max(axis=0)
    plan = draw_plan(room.rng, low, high - low)
    if plan is None:
        return
    parts = [_part(room, corners, (low, high)) for corners in plan.corners]
    leaf = paper(room.spec, textures.panels(room.rng, (192, 96), 0.4 + 0.5 * textures.muted(room.rng), (3, 2)))
    openings: list[list[Opening]] = [[] for _ in parts]
    for door in plan.doorways:
        depths = APPROACH_M, door.width_m + 0.1
        for number, depth in zip(door.rooms, depths, strict=True):
            openings[number].append(_open(parts[number].layout, door, depth))
        _hang(room, door, openings[door.rooms[1]][-1][0].yaw, leaf)
    parts[0].layout.entrance = None  # the front door is still to come
    for part, kind, gaps in zip(parts, plan.kinds, openings, strict=True):
        _raise_walls(part, plans[kind], gaps)
        _lay_floor(part, plans[kind])
        plans[kind].furnish(part)
        few_lamps(part)
        _mark(part, f"{MARK}{kind}", gaps)


def is_reachable(spec: mujoco.MjSpec) -> bool:
    """Whether a robot gets into every room of a flat."""
    rooms = [site.pos[:2] for site in spec.sites if site.name.startswith(MARK)]
    if not rooms:
        return False
    space = find_free_space(spec.compile(), *ROBOT_M, cell_m=CHECK_M)
    return bool(space.is_reachable(np.array(rooms)).all())


def _part(room: Room, corners: np.ndarray, extent: tuple[np.ndarray, np.ndarray]) -> Room:
    """A room of the flat, from corners (V, 2) in the middle of its walls; windows are in walls at the flat's extent."""
    before = [Wall(a, b).normal for a, b in zip(np.roll(corners, 1, axis=0), corners, strict=True)]
    inside = corners + LINING_M * (np.array(before) + np.roll(before, -1, axis=0))
    layout = Layout(inside)
    outer = [wall for wall in layout.walls if np.isclose(wall.middle - LINING_M * wall.normal, extent).any()]
    outer = [outer[number] for number in room.rng.permutation(len(outer))]
    return replace(room, look=make_look(room.spec, room.rng), layout=layout, wall_bodies=[], outer=outer)


def _open(layout: Layout, door: Doorway, depth_m: float) -> Opening:
    """Keep a doorway open, in the wall and on the floor before it; say where it is."""
    wall = min(layout.walls, key=lambda wall: wall.distance_m(door.middle))
    x, half = float((door.middle - wall.middle) @ wall.along), door.width_m / 2 + FRAME_M
    wall.taken.append((x - half - 0.02, x + half + 0.02, 0.0, DOOR_HEIGHT_M + FRAME_M))
    layout.keep_open(wall, x, door.width_m + 0.2, depth_m)
    return wall, x - half, x + half, depth_m


def _raise_walls(part: Room, plan: RoomPlan, openings: list[Opening]) -> None:
    """Raise a room's side of its walls, around its doorways."""
    walls, height, hue = part.layout.walls, part.height_m, float(part.rng.random())
    for number, wall in enumerate(walls):
        body = part.spec.worldbody.add_body(name=part.name("wall_side"), pos=(*wall.middle, 0.0), quat=turned(wall.yaw))
        part.wall_bodies.append(body)
        finish = plan.finishes[number % len(plan.finishes)]
        colour = textures.muted(part.rng, hue + 0.382 * number) * 0.7 + 0.28 * part.rng.uniform(0.6, 1.0)
        # x runs from the wall's end to its start
        first = -wall.length_m / 2 - wall.overlap_m(walls[(number + 1) % len(walls)], LINING_M)
        last = wall.length_m / 2 + walls[number - 1].overlap_m(wall, LINING_M)
        gaps = sorted(edge for gap in openings if gap[0] is wall for edge in gap[1:3])
        edges = [first, *gaps, last]
        for index, (left, right) in enumerate(pairwise(edges)):
            low = DOOR_HEIGHT_M + FRAME_M if index % 2 else 0.0
            size = (right - left, height - low)
            material = surface(part.look, part.rng, finish, size, colour)
            middle = ((left + right) / 2, LINING_M / 2, (low + height) / 2)
            box(body, middle, (size[0], LINING_M, size[1]), material, solid=True)


def _lay_floor(part: Room, plan: RoomPlan) -> None:
    material = paper(part.spec, plan.floor(part.rng))
    for left, right, bottom, top in slabs(part.layout.corners):
        middle = ((left + right) / 2, (bottom + top) / 2, FLOOR_M / 2)
        box(part.spec.worldbody, middle, (right - left, top - bottom, FLOOR_M), material)


def _hang(room: Room, door: Doorway, yaw: float, leaf: str) -> None:
    """Put a frame into a doorway, and its door, open or ajar, into the room that has its back to ``yaw`` [rad]."""
    rng, look, width = room.rng, room.look, door.width_m
    body = room.spec.worldbody.add_body(name=room.name("doorway"), pos=(*door.middle, 0.0), quat=turned(yaw))
    side, through = int(rng.choice((-1, 1))), 2 * LINING_M + 0.03
    for x in (-1, 1):
        at = (x * (width + FRAME_M) / 2, 0, DOOR_HEIGHT_M / 2)
        box(body, at, (FRAME_M, through, DOOR_HEIGHT_M), look.wood, solid=True)
    box(body, (0, 0, DOOR_HEIGHT_M + FRAME_M / 2), (width + 2 * FRAME_M, through, FRAME_M), look.wood)
    angle = np.radians(rng.uniform(*(AJAR_DEG if rng.random() < AJAR_PROBABILITY else OPENING_DEG)))
    ahead = np.array((-side * np.cos(angle), -np.sin(angle)))
    hinge = np.array((side * width / 2, -through / 2))
    quat = turned(float(np.arctan2(ahead[1], ahead[0])))
    at = hinge + ahead * width / 2
    box(body, (at[0], at[1], DOOR_HEIGHT_M / 2), (width, LEAF_M, DOOR_HEIGHT_M - 0.02), leaf, solid=True, quat=quat)
    at = hinge + ahead * (width - 0.08)
    box(body, (at[0], at[1], 1.03), (0.12, LEAF_M + 0.1, 0.03), look.metal, quat=quat)


def _mark(part: Room, name: str, openings: list[Opening]) -> None:
    """Mark the middle of the largest free floor of a room, away from its doors."""
    layout = part.layout
    for wall, left, right, depth in openings:
        layout.take(Footprint(right - left, depth, 0.0), wall_pose(wall, (left + right) / 2, depth / 2))
    row, column = np.unravel_index(layout.clearance().argmax(), layout.inside.shape)
    x, y = layout.low + (np.array((column, row)) + 0.5) * CELL_M
    part.spec.worldbody.add_site(name=part.name(name), pos=(x, y, 0.0), group=MARK_GROUP)
