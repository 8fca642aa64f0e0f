"""Wall fittings: doors, window, curtains, radiator, picture, mirror, whiteboard, clock, shelf, tool wall.

A fitting's frame is on its wall: x along the wall, z up from the floor, the room towards -y. Each function draws
around x = 0 and returns the rectangle that the fitting covers as (width, bottom, top) [m].
"""

import numpy as np

from sim.rooms.furniture import pictures, textures
from sim.rooms.furniture.primitives import WOODS, Body, Look, Rng, block, box, paint, paper, pole

Cover = tuple[float, float, float]  # Width, bottom and top of what a fitting covers on its wall [m]


def door(body: Body, rng: Rng, look: Look) -> Cover:
    """A panelled door in its frame."""
    width, height = 1.04, 2.12
    leaf = textures.panels(rng, (192, 96), 0.3 + 0.6 * textures.muted(rng), (3, 2))
    frame = rng.choice(WOODS)
    box(body, (0, -0.02, height / 2), (width, 0.04, height), paper(look.spec, textures.framed(leaf, frame, 0.035)))
    box(body, (rng.choice((-1, 1)) * (width / 2 - 0.15), -0.06, 1.03), (0.14, 0.05, 0.035), look.metal)
    return width, 0.0, height


def window(body: Body, rng: Rng, look: Look, width_m: float) -> Cover:
    """A window with a view through glazing bars, and a sill."""
    low, high = 0.9, rng.uniform(2.05, 2.25)
    bars = int(rng.integers(1, 3))
    view = pictures.window_view(rng, (128, 160))
    view = textures.framed(view, (0.95, 0.95, 0.93), 0.06, [(bar + 1) / (bars + 1) for bar in range(bars)])
    box(body, (0, -0.025, (low + high) / 2), (width_m, 0.05, high - low), paper(look.spec, view, glow=0.5))
    box(body, (0, -0.09, low - 0.02), (width_m + 0.1, 0.18, 0.04), look.white)
    return width_m + 0.1, low - 0.04, high


def curtains(body: Body, rng: Rng, look: Look, width_m: float, top_m: float) -> Cover:
    """A pair of curtains on a rod, drawn aside by uneven widths."""
    cloth = paper(look.spec, textures.folds(rng, (128, 64), textures.muted(rng), textures.vivid(rng)))
    rod_top, outer = top_m + 0.1, width_m / 2 + 0.3
    for side in (-1, 1):
        wide = rng.uniform(0.24, 0.42)
        tall = rod_top - 0.5
        box(body, (side * (outer - wide / 2), -0.11, rod_top - tall / 2), (wide, 0.07, tall), cloth)
    box(body, (0, -0.11, rod_top + 0.015), (2 * outer + 0.15, 0.035, 0.035), look.dark_wood)
    return 2 * outer + 0.15, 0.5, rod_top + 0.04


def dressed_window(body: Body, rng: Rng, look: Look, width_m: float, curtained: bool = True) -> Cover:
    """A window with or without curtains, and often a radiator below."""
    covers = [window(body, rng, look, width_m)]
    if curtained:
        covers.append(curtains(body, rng, look, width_m, covers[0][2]))
    if rng.random() < 0.7:
        covers.append(radiator(body, rng, look, width_m * 0.8))
    widths, bottoms, tops = zip(*covers, strict=True)
    return max(widths), min(bottoms), max(tops)


def radiator(body: Body, rng: Rng, look: Look, width_m: float) -> Cover:
    """A finned radiator with its pipe."""
    ribs = paper(look.spec, textures.fins(rng, (32, 128), (0.93, 0.92, 0.9), int(width_m / 0.07)))
    box(body, (0, -0.07, 0.43), (width_m, 0.1, 0.58), ribs)
    pole(body, (width_m / 2 + 0.03, -0.07, 0.1), 0.012, 0.2, look.white)
    block(body, (0, -0.07, 0.42), (width_m, 0.12, 0.64))
    return width_m + 0.1, 0.0, 0.74


def picture(body: Body, rng: Rng, look: Look, z: float, size: tuple[float, float]) -> Cover:
    """A framed painting, a different one each time."""
    width, tall = size
    image = pictures.painting(rng, (96, int(np.clip(96 * width / tall, 48, 192))))
    frame = textures.framed(image, rng.choice((*WOODS, (0.1, 0.1, 0.1), (0.9, 0.88, 0.8))), 0.07)
    box(body, (0, -0.02, z), (width, 0.04, tall), paper(look.spec, frame))
    return width, z - tall / 2, z + tall / 2


def mirror(body: Body, rng: Rng, look: Look) -> Cover:
    """A tall mirror: pale glass with a slanting highlight."""
    glass = paper(look.spec, textures.plaster(rng, (96, 48), (0.72, 0.8, 0.84), stains=0, cracks=0, depth=0.25))
    width, low, high = rng.uniform(0.5, 0.7), 0.6, rng.uniform(1.75, 1.95)
    box(body, (0, -0.015, (low + high) / 2), (width, 0.03, high - low), look.wood)
    box(body, (0, -0.028, (low + high) / 2), (width - 0.08, 0.012, high - low - 0.08), glass)
    return width, low, high


def whiteboard(body: Body, rng: Rng, look: Look) -> Cover:
    """A whiteboard with writing and a pen tray."""
    width, low, high = rng.uniform(1.4, 1.9), 0.95, 1.95
    board = paper(look.spec, pictures.sheet(rng, (96, 160)))
    box(body, (0, -0.012, (low + high) / 2), (width, 0.024, high - low), look.metal)
    box(body, (0, -0.024, (low + high) / 2), (width - 0.05, 0.012, high - low - 0.05), board)
    box(body, (0, -0.05, low), (0.5 * width, 0.08, 0.025), look.metal)
    return width, low - 0.02, high


def tool_wall(body: Body, rng: Rng, look: Look, width_m: float = 1.5) -> Cover:
    """A board with tools hanging on it."""
    low, high = 1.2, 2.05
    board = paper(look.spec, pictures.pegboard(rng, (96, int(96 * width_m / (high - low)))))
    box(body, (0, -0.015, (low + high) / 2), (width_m, 0.03, high - low), board)
    return width_m, low, high


def clock(body: Body, rng: Rng, look: Look) -> Cover:
    """A wall clock."""
    size, z = rng.uniform(0.28, 0.38), rng.uniform(1.85, 2.05)
    dial = paper(look.spec, pictures.clock_face(rng, (64, 64)))
    box(body, (0, -0.02, z), (size, 0.04, size), dial)
    return size, z - size / 2, z + size / 2


def wall_shelf(body: Body, rng: Rng, look: Look, width_m: float = 0.9) -> Cover:
    """A board on the wall with books and a jar on it."""
    z = rng.uniform(1.45, 1.75)
    box(body, (0, -0.12, z), (width_m, 0.24, 0.03), look.wood, solid=True)
    spines = paper(look.spec, pictures.books(rng, (48, 96)))
    side = rng.choice((-1, 1))
    box(body, (side * 0.15 * width_m, -0.1, z + 0.135), (0.6 * width_m, 0.17, 0.24), spines)
    pole(body, (-side * 0.35 * width_m, -0.12, z + 0.1), 0.06, 0.17, look.cushion)
    return width_m, z - 0.02, z + 0.27


def cooler(body: Body, rng: Rng, look: Look) -> Cover:
    """An air conditioner high on the wall."""
    width, z = rng.uniform(0.75, 0.95), 2.15
    slats = paper(look.spec, textures.fins(rng, (64, 32), (0.9, 0.91, 0.92), 7).transpose(1, 0, 2))
    box(body, (0, -0.1, z), (width, 0.2, 0.27), slats)
    box(body, (0, -0.2, z - 0.1), (width - 0.1, 0.02, 0.05), look.black)
    return width, z - 0.14, z + 0.14


def roller_door(body: Body, rng: Rng, look: Look) -> Cover:
    """A wide door of slats that rolls up."""
    width, height = 2.2, 2.2
    slats = paper(look.spec, textures.fins(rng, (96, 64), 0.4 + 0.5 * textures.muted(rng), 14).transpose(1, 0, 2))
    box(body, (0, -0.012, height / 2), (width, 0.024, height), slats)
    for side in (-1, 1):
        box(body, (side * (width / 2 + 0.04), -0.03, height / 2), (0.08, 0.06, height), look.metal)
    box(body, (0, -0.12, height + 0.1), (width + 0.16, 0.24, 0.22), look.metal)
    return width + 0.16, 0.0, height + 0.21


def extinguisher(body: Body, rng: Rng, look: Look) -> Cover:
    """A red fire extinguisher below its sign."""
    red = paint(look.spec, (0.8, 0.1, 0.08))
    pole(body, (0, -0.1, 0.95), 0.08, 0.45, red)
    box(body, (0, -0.1, 1.22), (0.1, 0.05, 0.1), look.black)
    box(body, (0, -0.01, 1.75), (0.22, 0.02, 0.22), red)
    return 0.24, 0.0, 1.9
