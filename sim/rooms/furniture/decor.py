"""Decoration and clutter: rug, floor lamp, plant, coat stand, barrel, ladder, boxes."""

import numpy as np

from sim.rooms.furniture import textures
from sim.rooms.furniture.primitives import (
    Body,
    Footprint,
    Look,
    Rng,
    ball,
    block,
    box,
    multiply,
    paint,
    paper,
    pole,
    turned,
)


def rug(body: Body, rng: Rng, look: Look, size: tuple[float, float]) -> Footprint:
    """A thin rug that collides with nothing; ``size`` is its extent along x and y [m]."""
    weave = paper(
        look.spec, textures.carpet(rng, (96, 144), textures.muted(rng), textures.vivid(rng), textures.muted(rng))
    )
    box(body, (0, 0, 0.002), (*size, 0.004), weave)
    return Footprint(*size, 0.0)


def floor_lamp(body: Body, rng: Rng, look: Look) -> Footprint:
    """A lamp on a pole with a glowing shade."""
    height = rng.uniform(1.5, 1.75)
    pole(body, (0, 0, 0.015), 0.15, 0.03, look.black, solid=True)
    box(body, (0, 0, height / 2), (0.03, 0.03, height), look.black, solid=True)
    pole(body, (0, 0, height), 0.2, 0.28, look.glow)
    return Footprint(0.4, 0.4, height + 0.14)


def plant(body: Body, rng: Rng, look: Look) -> Footprint:
    """A potted plant: a bush, or a small palm with drooping leaves."""
    pot = paint(look.spec, 0.7 * textures.vivid(rng))
    pole(body, (0, 0, 0.18), 0.17, 0.36, pot, solid=True)
    height = rng.uniform(0.9, 1.6)
    box(body, (0, 0, 0.36 + height / 4), (0.04, 0.04, height / 2), look.dark_wood, solid=True)
    if rng.random() < 0.5:
        for _ in range(2):
            at = (*rng.uniform(-0.08, 0.08, 2), 0.36 + height * rng.uniform(0.45, 0.8))
            ball(body, (float(at[0]), float(at[1]), float(at[2])), (0.26, 0.26, 0.32 * height / 1.2), look.leaves)
        return Footprint(0.64, 0.64, 0.36 + height)
    for leaf in np.arange(6) * 2 * np.pi / 6 + rng.uniform(0, 1):
        # Each leaf is tilted about its own y axis and then turned about z.
        w, x, y, z = multiply(turned(float(leaf)), turned(-rng.uniform(0.2, 1.1), (0.0, 1.0, 0.0)))
        lift = 0.36 + height * rng.uniform(0.5, 0.75)
        at = (0.12 * np.cos(leaf), 0.12 * np.sin(leaf), lift)
        box(body, at, (0.34, 0.1, 0.012), look.leaves, quat=(w, x, y, z))
    return Footprint(0.64, 0.64, 0.36 + height)


def coat_stand(body: Body, rng: Rng, look: Look) -> Footprint:
    """A stand with two coats on it."""
    pole(body, (0, 0, 0.02), 0.19, 0.04, look.dark_wood, solid=True)
    box(body, (0, 0, 0.9), (0.05, 0.05, 1.8), look.dark_wood, solid=True)
    for angle in (0.3, 0.3 + np.pi / 2):
        box(body, (0, 0, 1.72), (0.4, 0.03, 0.03), look.dark_wood, quat=turned(angle))
    for side, cloth in ((-1, look.fabric), (1, look.cushion)):
        box(body, (side * 0.13, 0, 1.3), (0.18, 0.32, 0.8), cloth, quat=turned(rng.uniform(0, 0.6)))
    return Footprint(0.58, 0.58, 1.8)


def barrel(body: Body, rng: Rng, look: Look) -> Footprint:
    """A steel drum."""
    colour = paint(look.spec, 0.8 * textures.vivid(rng))
    pole(body, (0, 0, 0.44), 0.29, 0.88, colour, solid=True)
    pole(body, (0, 0, 0.44), 0.3, 0.04, look.metal)
    return Footprint(0.6, 0.6, 0.88)


def ladder(body: Body, rng: Rng, look: Look) -> Footprint:
    """A ladder that leans against the wall behind it."""
    height = rng.uniform(1.9, 2.2)
    lean = turned(-0.13, (1.0, 0.0, 0.0))
    for side in (-1, 1):
        box(body, (side * 0.2, 0.0, height / 2), (0.04, 0.05, height), look.wood, quat=lean)
    for rung in np.linspace(-0.4, 0.4, 6) * height:
        y, z = np.sin(0.13) * rung, height / 2 + np.cos(0.13) * rung
        box(body, (0, y, z), (0.4, 0.03, 0.03), look.wood)
    block(body, (0, 0, height / 2), (0.46, 0.32, height))
    return Footprint(0.46, 0.32, height)


def crates(body: Body, rng: Rng, look: Look) -> Footprint:
    """Two boxes stacked slightly askew."""
    card = paint(look.spec, (0.66, 0.5, 0.33))
    box(body, (0, 0, 0.22), (0.56, 0.46, 0.44), card, solid=True)
    box(body, (0.03, 0, 0.58), (0.42, 0.38, 0.28), look.cushion, quat=turned(rng.uniform(-0.3, 0.3)), solid=True)
    return Footprint(0.58, 0.5, 0.72)
