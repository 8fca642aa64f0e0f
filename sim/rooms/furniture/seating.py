"""Furniture to sit and lie on, and tables and worktops: sofa, chairs, bed, dining and coffee table, desk, counter."""

from sim.rooms.furniture import pictures, textures
from sim.rooms.furniture.primitives import Body, Footprint, Look, Rng, ball, block, box, legs, paper, pole, turned


def sofa(body: Body, rng: Rng, look: Look, width_m: float = 2.1) -> Footprint:
    """A sofa with two or three seats, arms and a cushion at each end."""
    depth, arm, seat_top = 0.9, 0.2, 0.43
    inner = width_m - 2 * arm
    back_top = rng.uniform(0.8, 0.92)
    box(body, (0, 0.03, 0.2), (width_m - 0.04, depth - 0.06, 0.26), look.fabric)
    box(body, (0, depth / 2 - 0.11, (0.3 + back_top) / 2), (inner, 0.22, back_top - 0.3), look.fabric)
    for side in (-1, 1):
        box(body, (side * (width_m - arm) / 2, 0, 0.34), (arm, depth, 0.56), look.fabric)
    seats = 3 if inner > 1.5 else 2
    for seat in range(seats):
        x = (seat - (seats - 1) / 2) * inner / seats
        box(body, (x, -0.12, seat_top - 0.06), (inner / seats - 0.02, depth - 0.26, 0.13), look.fabric)
    for side in (-1, 1):
        tilt = turned(rng.uniform(-0.3, -0.2), (1.0, 0.0, 0.0))
        box(body, (side * (inner / 2 - 0.25), 0.13, 0.62), (0.42, 0.12, 0.38), look.cushion, quat=tilt)
    block(body, (0, 0, 0.31), (width_m, depth, 0.62))
    block(body, (0, depth / 2 - 0.11, back_top / 2), (inner, 0.22, back_top))
    return Footprint(width_m, depth, back_top, front_m=0.45)


def armchair(body: Body, rng: Rng, look: Look) -> Footprint:
    """A padded chair with arms."""
    width, depth = rng.uniform(0.8, 0.9), 0.85
    box(body, (0, -0.05, 0.26), (width - 0.3, depth - 0.15, 0.36), look.second_fabric)
    box(body, (0, depth / 2 - 0.1, 0.52), (width - 0.04, 0.2, 0.92), look.second_fabric)
    for side in (-1, 1):
        box(body, (side * (width / 2 - 0.08), -0.04, 0.33), (0.16, depth - 0.1, 0.58), look.second_fabric)
    box(body, (0, 0.15, 0.62), (0.4, 0.12, 0.36), look.cushion, quat=turned(-0.3, (1.0, 0.0, 0.0)))
    block(body, (0, 0, 0.31), (width, depth, 0.62))
    block(body, (0, depth / 2 - 0.1, 0.5), (width, 0.2, 0.98))
    return Footprint(width, depth, 0.98, front_m=0.35)


def chair(body: Body, rng: Rng, look: Look) -> Footprint:
    """A chair with a straight back; stretchers join its legs on all sides, so that no robot drives under the seat."""
    width, depth, back_top = 0.44, 0.46, rng.uniform(0.86, 0.98)
    wood = look.wood
    x, y = width / 2 - 0.022, depth / 2 - 0.022
    for at, tall in (((-x, -y), 0.43), ((x, -y), 0.43), ((-x, y), back_top), ((x, y), back_top)):
        box(body, (*at, tall / 2), (0.045, 0.045, tall), wood, solid=True)
    box(body, (0, 0, 0.45), (width, depth, 0.045), look.cushion, solid=True)
    box(body, (0, y, back_top - 0.13), (width - 0.08, 0.03, 0.22), wood, solid=True)
    for side in (-1, 1):
        box(body, (0, side * y, 0.13), (2 * x, 0.03, 0.06), wood, solid=True)
        box(body, (side * x, 0, 0.13), (0.03, 2 * y, 0.06), wood, solid=True)
    return Footprint(width, depth, back_top)


def office_chair(body: Body, rng: Rng, look: Look) -> Footprint:
    """A swivel chair on a star-shaped base with castors."""
    back_top = rng.uniform(0.95, 1.15)
    for angle in (0.3, 1.35, 2.4):
        box(body, (0, 0, 0.045), (0.58, 0.05, 0.08), look.black, solid=True, quat=turned(angle))
    pole(body, (0, 0, 0.26), 0.03, 0.36, look.metal, solid=True)
    box(body, (0, 0, 0.47), (0.48, 0.48, 0.08), look.second_fabric, solid=True)
    box(body, (0, 0.23, 0.52), (0.06, 0.04, 0.3), look.black)
    box(body, (0, 0.22, (0.6 + back_top) / 2), (0.46, 0.07, back_top - 0.6), look.second_fabric, solid=True)
    return Footprint(0.58, 0.58, back_top)


def stool(body: Body, rng: Rng, look: Look) -> Footprint:
    """A round stool on one foot."""
    height = rng.uniform(0.6, 0.7)
    pole(body, (0, 0, 0.015), 0.18, 0.03, look.metal, solid=True)
    pole(body, (0, 0, height / 2), 0.03, height - 0.04, look.metal, solid=True)
    pole(body, (0, 0, height - 0.03), 0.18, 0.06, look.cushion, solid=True)
    return Footprint(0.36, 0.36, height)


def bed(body: Body, rng: Rng, look: Look, width_m: float = 1.6) -> Footprint:
    """A bed with headboard, footboard, mattress, pillows and a duvet folded back at the head."""
    length, head_top = 2.08, rng.uniform(0.95, 1.25)
    box(body, (0, 0, 0.2), (width_m, length - 0.1, 0.24), look.wood)
    box(body, (0, length / 2 - 0.03, head_top / 2), (width_m + 0.06, 0.06, head_top), look.dark_wood)
    box(body, (0, -length / 2 + 0.03, 0.25), (width_m + 0.04, 0.05, 0.5), look.dark_wood)
    box(body, (0, 0.0, 0.4), (width_m - 0.06, length - 0.14, 0.18), look.white)
    box(body, (0, -0.28, 0.47), (width_m + 0.02, length - 0.66, 0.14), look.fabric)
    box(body, (0, 0.38, 0.56), (width_m - 0.02, 0.24, 0.06), look.second_fabric)
    pillows = 2 if width_m > 1.2 else 1
    for pillow in range(pillows):
        x = (pillow - (pillows - 1) / 2) * width_m / 2
        ball(body, (x, length / 2 - 0.28, 0.56), (0.32, 0.2, 0.1), look.white)
    block(body, (0, 0, 0.27), (width_m + 0.04, length, 0.54))
    block(body, (0, length / 2 - 0.03, head_top / 2), (width_m + 0.06, 0.06, head_top))
    return Footprint(width_m + 0.06, length, head_top, front_m=0.0)


TABLE_TOP_M = 0.74
KNEES_M = 0.18  # Distance from the middle of a desk to the middle of its knee space [m]


def dining_table(body: Body, rng: Rng, look: Look, width_m: float = 1.5, depth_m: float = 0.85) -> Footprint:
    """A table on four legs, with a bowl of fruit."""
    box(body, (0, 0, TABLE_TOP_M - 0.02), (width_m, depth_m, 0.04), look.wood, solid=True)
    legs(body, width_m - 0.06, depth_m - 0.06, TABLE_TOP_M - 0.04, 0.07, look.wood)
    x = rng.uniform(-0.25, 0.25) * width_m
    pole(body, (x, 0, TABLE_TOP_M + 0.03), 0.15, 0.06, look.white)
    ball(body, (x, 0, TABLE_TOP_M + 0.08), (0.12, 0.12, 0.05), look.cushion)
    return Footprint(width_m, depth_m, TABLE_TOP_M)


def coffee_table(body: Body, rng: Rng, look: Look) -> Footprint:
    """A low table with a book on it and, between its legs, a shelf too low to drive under."""
    width, depth, top = rng.uniform(0.9, 1.15), rng.uniform(0.5, 0.6), 0.42
    box(body, (0, 0, top - 0.02), (width, depth, 0.04), look.dark_wood, solid=True)
    legs(body, width, depth, top - 0.04, 0.05, look.dark_wood)
    box(body, (0, 0, 0.14), (width - 0.1, depth - 0.04, 0.03), look.dark_wood, solid=True)
    box(body, (width * 0.2, 0, top + 0.015), (0.3, 0.2, 0.03), look.cushion, quat=turned(rng.uniform(-0.6, 0.6)))
    return Footprint(width, depth, top)


def bedside_table(body: Body, rng: Rng, look: Look) -> Footprint:
    """A small chest of two drawers with a lamp."""
    width, depth, top = 0.46, 0.4, rng.uniform(0.48, 0.58)
    box(body, (0, 0, top / 2), (width, depth, top), look.dark_wood, solid=True)
    for z in (0.3 * top, 0.75 * top):
        box(body, (0, -depth / 2 - 0.008, z), (width - 0.06, 0.016, 0.36 * top), look.wood)
    pole(body, (0, 0.03, top + 0.13), 0.02, 0.26, look.metal)
    pole(body, (0, 0.03, top + 0.34), 0.13, 0.2, look.glow)
    return Footprint(width, depth, top + 0.44)


def desk(body: Body, rng: Rng, look: Look, width_m: float = 1.4, side: int = 1) -> Footprint:
    """A desk with a drawer pedestal on one side, 1 or -1 along x, knee space on the other, and a computer."""
    depth, top = 0.7, 0.74
    box(body, (0, 0, top - 0.02), (width_m, depth, 0.04), look.wood, solid=True)
    drawers = paper(look.spec, textures.drawers(rng, (96, 64), 0.5 + 0.4 * textures.muted(rng), 3))
    box(body, (side * (width_m / 2 - 0.22), 0, 0.35), (0.4, depth - 0.08, 0.68), drawers, solid=True)
    box(body, (-side * (width_m / 2 - 0.03), 0, 0.35), (0.05, depth - 0.06, 0.7), look.dark_wood, solid=True)
    _computer(body, rng, look, rng.uniform(-0.15, 0.15) * width_m, top)
    return Footprint(width_m, depth, top + 0.5, front_m=0.35)


def workbench(body: Body, rng: Rng, look: Look, width_m: float = 1.8) -> Footprint:
    """A heavy bench with a vice, a lower shelf and a tool box on it."""
    depth, top = 0.7, 0.88
    box(body, (0, 0, top - 0.04), (width_m, depth, 0.08), look.wood, solid=True)
    legs(body, width_m - 0.1, depth - 0.06, top - 0.08, 0.1, look.dark_wood)
    box(body, (0, 0, 0.2), (width_m - 0.2, depth - 0.1, 0.04), look.wood, solid=True)
    x = rng.uniform(-0.3, 0.3) * width_m
    box(body, (x, 0.05, 0.33), (0.5, 0.3, 0.22), look.cushion)
    box(body, (-x * 0.8, 0.1, top + 0.13), (0.5, 0.25, 0.26), look.second_fabric)
    box(body, (rng.choice((-0.35, 0.35)) * width_m, -depth / 2 + 0.1, top + 0.05), (0.16, 0.22, 0.16), look.metal)
    return Footprint(width_m, depth, top + 0.26, front_m=0.6)


def counter(body: Body, rng: Rng, look: Look, width_m: float = 2.4) -> Footprint:
    """A kitchen counter with wall cupboards, sink, hob and hood."""
    depth, top, gap = 0.62, 0.9, 0.006
    box(body, (0, 0.02, 0.45), (width_m, depth - 0.04, 0.82), look.cabinet)
    box(body, (0, 0, top - 0.02), (width_m, depth, 0.04), look.dark_wood)
    block(body, (0, 0, top / 2), (width_m, depth, top))
    doors = max(int(width_m / 0.55), 2)
    for door in range(doors):
        x = (door + 0.5) * width_m / doors - width_m / 2
        box(body, (x, -depth / 2 + 0.03, 0.46), (width_m / doors - 2 * gap, 0.025, 0.72), look.wood)
    hob, sink = rng.permutation((-0.28, 0.28)) * width_m
    box(body, (hob, 0, top + 0.004), (0.56, 0.5, 0.012), look.black)
    box(body, (sink, 0.0, top + 0.004), (0.5, 0.4, 0.012), look.metal)
    pole(body, (sink, 0.22, top + 0.14), 0.015, 0.28, look.metal)
    box(body, (sink, 0.14, top + 0.27), (0.03, 0.16, 0.03), look.metal)
    box(body, (hob, 0.1, 1.62), (0.6, 0.42, 0.1), look.metal)
    box(body, (hob, 0.2, 1.98), (0.26, 0.22, 0.62), look.metal)
    _cupboards(body, rng, look, width_m, hob)
    return Footprint(width_m, depth, 2.15, front_m=0.7)


def island(body: Body, rng: Rng, look: Look) -> Footprint:
    """A free-standing kitchen block."""
    width, depth = rng.uniform(1.1, 1.5), 0.7
    box(body, (0, 0, 0.44), (width - 0.1, depth - 0.1, 0.88), look.cabinet, solid=True)
    box(body, (0, 0, 0.91), (width, depth, 0.05), look.wood, solid=True)
    pole(body, (width * 0.25, 0, 1.03), 0.1, 0.2, look.metal)
    return Footprint(width, depth, 1.13)


def _cupboards(body: Body, rng: Rng, look: Look, width_m: float, hob_x: float) -> None:
    side = 1.0 if hob_x < 0 else -1.0
    inner, outer = hob_x + side * 0.33, side * width_m / 2
    span, middle = abs(outer - inner), (inner + outer) / 2
    top = rng.uniform(2.0, 2.15)
    box(body, (middle, 0.14, (1.4 + top) / 2), (span, 0.32, top - 1.4), look.cabinet, solid=True)
    doors = max(int(span / 0.45), 1)
    for door in range(doors):
        x = middle + ((door + 0.5) / doors - 0.5) * span
        box(body, (x, -0.03, (1.4 + top) / 2), (span / doors - 0.02, 0.02, top - 1.44), look.wood)


def _computer(body: Body, rng: Rng, look: Look, x: float, top_m: float) -> None:
    lit = textures.framed(pictures.screen(rng, (64, 96)), (0.05, 0.05, 0.05), 0.06)
    wide = rng.uniform(0.5, 0.68)
    box(body, (x, 0.16, top_m + 0.3), (wide, 0.04, 0.36), paper(look.spec, lit, glow=0.5))
    box(body, (x, 0.18, top_m + 0.07), (0.08, 0.04, 0.14), look.black)
    box(body, (x, -0.1, top_m + 0.01), (0.42, 0.14, 0.02), look.black)
