"""Surfaces of rooms whose places look alike: a motif that repeats on all walls, and a ceiling of equal panels."""

import mujoco
import numpy as np

from sim.rng import split
from sim.rooms.furniture import ceiling, textures
from sim.rooms.furniture.primitives import box, paper
from sim.rooms.layout import Pose
from sim.rooms.placement import Footprint, Room

PX_PER_M = 60
MOTIF_M, PANEL_M = 0.5, 0.6
"""Periods of the wallpaper and of the ceiling [m]."""
LAMPS_M = 2.4
"""Usual distance between lamps [m]."""


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
            covered = room.layout.is_covered(Footprint(PANEL_M, PANEL_M, 0.0), Pose(float(x), float(y), 0.0))
            if not covered:
                body = room.spec.worldbody.add_body(name=room.name("lamp"), pos=(x, y, room.height_m))
                ceiling.panel_lamp(body, room.rng, room.look, PANEL_M)


def repeat(motif: np.ndarray, size_m: tuple[float, float]) -> np.ndarray:
    """Repeat a seamless motif (rows, columns, 3) over a wall of the size (width, height) [m]."""
    columns, rows = (max(round(PX_PER_M * side), 8) for side in size_m)
    down, across = -(-rows // motif.shape[0]), -(-columns // motif.shape[1])
    return np.tile(motif, (down, across, 1))[:rows, :columns]
