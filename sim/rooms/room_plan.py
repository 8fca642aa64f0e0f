"""What a kind of room is: its furniture, and the floors, lamps and ceilings that kinds share."""

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np

from sim.rooms.furniture import ceiling, textures
from sim.rooms.placement import Finish, Room, beams, fix

FLOOR_PX = (256, 320)


def lamps_and_beams(room: Room) -> None:
    """Beams and domestic lamps."""
    rng = room.rng
    beams(room, "beam", ceiling.beam, int(rng.integers(2, 4)), float(rng.uniform(0.12, 0.2)))
    lamps = [ceiling.globe, ceiling.dish, ceiling.spots, ceiling.chandelier, ceiling.pendant]
    if room.height_m > 2.55:
        lamps.append(ceiling.fan)
    _finish_ceiling(room, lamps)


def tubes_and_ducts(room: Room) -> None:
    """A duct and workplace lamps."""
    beams(room, "duct", ceiling.duct, 1, 0.4)
    _finish_ceiling(room, [ceiling.tube, ceiling.tube, ceiling.tube, ceiling.dish, ceiling.spots])


def few_lamps(room: Room) -> None:
    """One to three domestic lamps, by the room's size, and a smoke detector."""
    lamps = (ceiling.globe, ceiling.dish, ceiling.spots, ceiling.chandelier, ceiling.pendant)
    for _ in range(int(np.clip(round(room.area_m2 / 9.0), 1, 3))):
        lamp = lamps[room.rng.integers(len(lamps))]
        fix(room, lamp.__name__, lamp, room.height_m - 1.0)
    fix(room, "smoke_detector", ceiling.smoke_detector, room.height_m - 0.1)


def no_lamps(room: Room) -> None:
    """Nothing: each part of the room has its own."""


def _finish_ceiling(room: Room, lamps: list) -> None:
    """Lamps of different kinds, vents, a hatch and a smoke detector, in no regular pattern."""
    rng, height = room.rng, room.height_m
    count = int(np.clip(round(room.area_m2 / 7.5), 3, 6))
    order = [lamps[i % len(lamps)] for i in rng.permutation(max(count, len(lamps)))[:count]]
    for lamp in order:
        fix(room, lamp.__name__, lamp, height - 1.0)
    for piece in (ceiling.vent, ceiling.vent, ceiling.hatch, ceiling.smoke_detector):
        fix(room, piece.__name__, piece, height - 0.1)


def wooden_floor(rng: np.random.Generator) -> np.ndarray:
    """Boards, lighter or darker."""
    return textures.wood(rng, FLOOR_PX, np.multiply((0.66, 0.47, 0.3), rng.uniform(0.75, 1.1)), 22)


def carpet(rng: np.random.Generator) -> np.ndarray:
    """Grey fabric."""
    return textures.fabric(rng, FLOOR_PX, (0.42, 0.45, 0.5), (0.36, 0.4, 0.47))


def tiled_floor(rng: np.random.Generator) -> np.ndarray:
    """Tiles of two colours."""
    return textures.tile(rng, FLOOR_PX, (0.75, 0.7, 0.62), textures.muted(rng), (12, 16))


def concrete(rng: np.random.Generator) -> np.ndarray:
    """Stained screed with cracks."""
    return textures.plaster(rng, FLOOR_PX, (0.55, 0.55, 0.53), stains=14, cracks=6)


@dataclass(frozen=True)
class RoomPlan:
    """A kind of room."""

    size_m: tuple[float, float, float]  # Width, depth and height [m]
    finishes: tuple[Finish, ...]  # Finishes of the walls, in turn
    furnish: Callable[[Room], None]  # Furnishes the empty room: all that is on the floor or on walls
    floor: Callable[[np.random.Generator], np.ndarray] = wooden_floor  # Draws the floor's texture
    finish_ceiling: Callable[[Room], None] = lamps_and_beams  # Adds lamps and whatever else is on the ceiling
    wooden_ceiling: bool = False  # Whether half of the ceilings, at random, are of boards
    panelled: bool = False  # Whether the ceiling consists of equal panels
    # Draws width and depth [m] of a room whose settings give none; None: those of ``size_m``
    draw_size: Callable[[np.random.Generator], tuple[float, float]] | None = None
    # Whether a drawn room is usable, else the next one is drawn; None: all are
    accepts: Callable[[mujoco.MjSpec], bool] | None = None
