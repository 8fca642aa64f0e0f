"""Building a furnished room from a seed: walls, floor, ceiling, lamps and furniture."""

from pathlib import Path
from typing import get_args

import mujoco
import numpy as np

from sim.errors import InputError
from sim.rng import split
from sim.rooms.furniture import textures
from sim.rooms.furniture.primitives import COLLISION_GROUP, Footprint, block, box, make_look, paper, turned
from sim.rooms.layout import Layout
from sim.rooms.outline import DOORWAY_M, outline, slabs
from sim.rooms.placement import Finish, Room, hang_lamps, panel_ceiling, paper_wall, surface
from sim.rooms.plans import PLANS
from sim.rooms.room_plan import RoomPlan
from sim.settings import RoomKind, RoomSettings, RoomShape

FLOOR = "floor"
WALL_M = 0.15
DOORWAY_HEIGHT_M = 2.05
DRAWS = 10  # Most rooms drawn until one is usable

PILLAR_FINISHES: tuple[Finish, ...] = ("brick", "plaster", "boards")


def build_room(settings: RoomSettings) -> mujoco.MjSpec:
    """Build a room, ready for a robot to be attached.

    Drawn geoms are in group 2 and collide with nothing; colliding geoms are in group 3 and are not drawn. The floor is
    the plane ``floor`` at z = 0; the origin is the middle of the room's extent. Raises InputError if the MJCF file that
    the settings name cannot be used, or no room that is drawn is usable.
    """
    if settings.mjcf is not None:
        from sim.rooms.mjcf import load_room

        return load_room(Path(settings.mjcf))
    accepts = PLANS[settings.kind].accepts
    for number in range(DRAWS):
        spec = _draw(settings, [number] * (number > 0))
        if accepts is None or accepts(spec):
            return spec
    raise InputError(
        f"room.seed {settings.seed}: a robot can reach every room in none of {DRAWS} draws of a {settings.kind}; "
        "another seed or a larger room.width_m and room.depth_m may have one"
    )


def _draw(settings: RoomSettings, again: list[int]) -> mujoco.MjSpec:
    """Draw a room from its seed; ``again`` makes it another one."""
    kind, shape = get_args(RoomKind).index(settings.kind), get_args(RoomShape).index(settings.shape)
    rng = np.random.default_rng([settings.seed, kind, shape, *again])
    plan = PLANS[settings.kind]
    width, depth, height = plan.size_m
    if plan.draw_size is not None:
        width, depth = plan.draw_size(split(rng, "size"))
    width = width if settings.width_m is None else settings.width_m
    depth = depth if settings.depth_m is None else settings.depth_m
    spec = mujoco.MjSpec()
    spec.modelname = f"{settings.kind}_{settings.shape}_{settings.seed}"
    layout = Layout(outline(settings.shape, width, depth, rng))
    look = make_look(spec, rng)
    twins = {} if settings.look_alike else None
    room = Room(spec, rng, look, layout, height + float(rng.uniform(-0.08, 0.12)), [], twins=twins)
    _lay_floor(room, plan)
    _raise_walls(room, plan)
    _close_ceiling(room, plan)
    if settings.shape == "pillar":
        _raise_pillars(room)
    elif settings.shape == "two_rooms":
        _lay_lintel(room, plan)
    plan.furnish(room)
    (plan.finish_ceiling if room.twins is None or plan.panelled else hang_lamps)(room)
    _light(spec)
    return spec


def _lay_floor(room: Room, plan: RoomPlan) -> None:
    world, rng = room.spec.worldbody, room.rng
    width, depth = np.ptp(room.layout.corners, axis=0)
    world.add_geom(
        name=FLOOR, type=mujoco.mjtGeom.mjGEOM_PLANE, size=(width / 2 + 1, depth / 2 + 1, 1), group=COLLISION_GROUP
    )
    material = paper(room.spec, plan.floor(rng))
    for left, right, bottom, top in slabs(room.layout.corners):
        middle = ((left + right) / 2, (bottom + top) / 2, -0.05)
        box(world, middle, (right - left, top - bottom, 0.1), material)


def _raise_walls(room: Room, plan: RoomPlan) -> None:
    finishes = plan.finishes
    shift, first_hue = int(room.rng.integers(len(finishes))), float(room.rng.random())
    walls = room.layout.walls
    for number, wall in enumerate(walls):
        body = room.spec.worldbody.add_body(name=f"wall_{number}", pos=(*wall.middle, 0.0), quat=turned(wall.yaw))
        before = walls[number - 1].overlap_m(wall, WALL_M)
        after = wall.overlap_m(walls[(number + 1) % len(walls)], WALL_M)
        length = wall.length_m + before + after
        middle = (before - after) / 2
        finish = finishes[(number + shift) % len(finishes)]
        # Steps by the golden section keep the hues of neighbouring walls apart, however many walls there are.
        colour = textures.muted(room.rng, first_hue + 0.382 * number) * 0.7 + 0.28 * room.rng.uniform(0.6, 1.0)
        if room.twins is None:
            material = surface(room.look, room.rng, finish, (length, room.height_m), colour)
        else:
            material = paper_wall(room, (length, room.height_m))
        size = (length, WALL_M, room.height_m)
        box(body, (middle, WALL_M / 2, room.height_m / 2), size, material, solid=True)
        room.wall_bodies.append(body)


def _close_ceiling(room: Room, plan: RoomPlan) -> None:
    rng, corners = room.rng, room.layout.corners
    width, depth = (np.ptp(corners, axis=0) + 2 * WALL_M).tolist()
    middle = (corners.max(axis=0) + corners.min(axis=0)) / 2
    body = room.spec.worldbody.add_body(name="ceiling", pos=(0, 0, room.height_m))
    if plan.panelled or room.twins is not None:
        panel_ceiling(room, body, middle, (width, depth))
        return
    shape = (int(np.clip(72 * depth, 128, 512)), int(np.clip(72 * width, 128, 640)))
    if plan.wooden_ceiling and rng.random() < 0.5:
        image = textures.wood(rng, shape, (0.8, 0.68, 0.52), int(rng.integers(14, 24)))
    else:
        colour, second = 0.4 + 0.55 * textures.muted(rng), 0.35 + 0.6 * textures.muted(rng)
        image = textures.plaster(rng, shape, colour, second, stains=int(rng.integers(8, 14)), cracks=9, depth=0.35)
    box(body, (middle[0], middle[1], 0.05), (width, depth, 0.1), paper(room.spec, image))


def _raise_pillars(room: Room) -> None:
    """Add one or two pillars off the middle, where they leave paths."""
    rng = room.rng
    for number in range(int(rng.integers(1, 3))):
        side = float(rng.uniform(0.32, 0.5))
        it = Footprint(side, side, room.height_m)
        clear = Footprint(side + 1.6, side + 1.6, 0.0)
        pose = room.layout.in_the_open(clear, rng, lambda pose: -min(abs(pose.x), 1.0))
        if pose is None:
            continue
        room.layout.take(it, pose)
        body = room.spec.worldbody.add_body(name=f"pillar_{number}", pos=(pose.x, pose.y, 0.0))
        finish: Finish = PILLAR_FINISHES[rng.integers(len(PILLAR_FINISHES))]
        material = surface(room.look, rng, finish, (side, room.height_m), textures.muted(rng))
        box(body, (0, 0, room.height_m / 2), (side, side, room.height_m), material)
        block(body, (0, 0, room.height_m / 2), (side, side, room.height_m))


def _lay_lintel(room: Room, plan: RoomPlan) -> None:
    """Add the wall above the doorway between two rooms."""
    low, high = room.layout.corners[2], room.layout.corners[8]  # where the doorway begins and ends
    size = (*(high - low), room.height_m - DOORWAY_HEIGHT_M)
    colour = textures.muted(room.rng) * 0.7 + 0.25
    material = surface(room.look, room.rng, plan.finishes[0], (DOORWAY_M, size[2]), colour)
    body = room.spec.worldbody.add_body(name="lintel", pos=(*(low + high) / 2, DOORWAY_HEIGHT_M + size[2] / 2))
    box(body, (0, 0, 0), size, material)


def _light(spec: mujoco.MjSpec) -> None:
    """Add two directional lights, from above and more weakly from the floor; neither turns with the view."""
    for direction, strength in (((0.45, 0.3, -0.85), 0.32), ((-0.3, -0.55, 0.8), 0.26)):
        spec.worldbody.add_light(
            type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
            dir=direction,
            diffuse=[strength] * 3,
            ambient=[0.06] * 3,
            specular=[0.0] * 3,
            castshadow=False,
        )
