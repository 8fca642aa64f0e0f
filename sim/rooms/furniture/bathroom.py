"""Furniture of a bathroom: bathtub, shower, toilet, basin below its mirror, washing machine."""

from sim.rooms.furniture import textures
from sim.rooms.furniture.primitives import Body, Footprint, Look, Rng, ball, block, box, paint, paper, pole


def bathtub(body: Body, rng: Rng, look: Look) -> Footprint:
    """A bathtub full of water, its taps at one end."""
    width, depth, top = rng.uniform(1.5, 1.7), 0.72, 0.58
    panels = paper(look.spec, textures.tile(rng, (48, 128), (0.86, 0.87, 0.88), textures.muted(rng), (3, 8)))
    box(body, (0, 0, top / 2 - 0.02), (width, depth, top - 0.04), panels)
    box(body, (0, 0, top - 0.02), (width, depth, 0.04), look.white)
    box(body, (0, 0, top + 0.002), (width - 0.16, depth - 0.16, 0.01), paint(look.spec, (0.62, 0.78, 0.82)))
    block(body, (0, 0, top / 2), (width, depth, top))
    side = rng.choice((-1, 1)) * (width / 2 - 0.05)
    box(body, (side, 0.1, top + 0.1), (0.05, 0.05, 0.2), look.metal)
    return Footprint(width, depth, top + 0.2, front_m=0.4)


def shower(body: Body, rng: Rng, look: Look) -> Footprint:
    """A shower tray between two walls of frosted glass."""
    side, height = 0.9, 2.0
    glass = paint(look.spec, (0.72, 0.82, 0.84))
    box(body, (0, 0, 0.06), (side, side, 0.12), look.white)
    for x in (-1, 1):
        box(body, (x * (side / 2 - 0.015), 0, 1.06), (0.03, side, height - 0.12), glass)
    pole(body, (0, side / 2 - 0.06, 1.1), 0.015, 1.9, look.metal)
    pole(body, (0, side / 2 - 0.2, 2.02), 0.11, 0.03, look.metal)
    block(body, (0, 0, height / 2), (side, side, height))
    return Footprint(side, side, height, front_m=0.4)


def toilet(body: Body, rng: Rng, look: Look) -> Footprint:
    """A toilet with its cistern."""
    lid = paint(look.spec, textures.muted(rng) if rng.random() < 0.4 else (0.85, 0.85, 0.83))
    box(body, (0, 0.26, 0.58), (0.4, 0.16, 0.44), look.white)
    box(body, (0, 0.06, 0.19), (0.24, 0.36, 0.38), look.white)
    ball(body, (0, -0.08, 0.36), (0.18, 0.26, 0.06), look.white)
    ball(body, (0, -0.07, 0.42), (0.17, 0.24, 0.02), lid)
    block(body, (0, 0, 0.4), (0.4, 0.68, 0.8))
    return Footprint(0.42, 0.7, 0.8, front_m=0.45)


def basin(body: Body, rng: Rng, look: Look, width_m: float = 0.8) -> Footprint:
    """A basin on a cupboard below a mirror with a lamp."""
    depth, top = 0.48, 0.86
    box(body, (0, 0.01, 0.45), (width_m - 0.04, depth - 0.06, 0.66), look.wood)
    box(body, (0, 0, top - 0.04), (width_m, depth, 0.08), look.white)
    box(body, (0, -0.03, top + 0.002), (width_m - 0.2, 0.3, 0.008), look.metal)
    pole(body, (0, 0.17, top + 0.09), 0.015, 0.18, look.metal)
    glass = paper(look.spec, textures.plaster(rng, (64, 64), (0.72, 0.8, 0.84), stains=0, cracks=0, depth=0.25))
    box(body, (0, depth / 2 - 0.015, 1.5), (width_m, 0.03, 0.8), glass)
    box(body, (0, depth / 2 - 0.04, 1.96), (0.5, 0.06, 0.06), look.glow)
    block(body, (0, 0, top / 2), (width_m, depth, top))
    return Footprint(width_m, depth, 2.0, front_m=0.5)


def washing_machine(body: Body, rng: Rng, look: Look) -> Footprint:
    """A washing machine with its porthole, and a basket on it."""
    side, top = 0.6, 0.85
    box(body, (0, 0, top / 2), (side, side, top), look.white, solid=True)
    for size, depth, material in ((0.38, 0.012, look.metal), (0.3, 0.02, look.black)):
        box(body, (0, -side / 2, 0.42), (size, 2 * depth, size), material)
    box(body, (0.12, -side / 2, 0.77), (0.26, 0.016, 0.06), look.black)
    box(body, (rng.uniform(-0.05, 0.05), 0, top + 0.13), (0.45, 0.35, 0.26), look.cushion)
    return Footprint(side, side, top + 0.26, front_m=0.5)
