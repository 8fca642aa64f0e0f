"""Ceiling fittings: lamps of several kinds, beams, duct, vent, smoke detector, hatch, fan.

A fitting's frame has its origin on the ceiling, z up; everything hangs below z = 0. Each function returns the size
that its fitting covers on the ceiling as (along x, along y) [m].
"""

import numpy as np

from sim.rooms.furniture import textures
from sim.rooms.furniture.primitives import Body, Look, Rng, ball, box, paint, paper, pole, turned

Cover = tuple[float, float]  # Extent along x and y on the ceiling [m]


def pendant(body: Body, rng: Rng, look: Look) -> Cover:
    """A hanging lamp with a coloured shade."""
    drop, radius = rng.uniform(0.35, 0.6), rng.uniform(0.16, 0.28)
    shade = paint(look.spec, textures.vivid(rng), glow=0.25)
    box(body, (0, 0, -drop / 2), (0.02, 0.02, drop), look.black)
    pole(body, (0, 0, -drop - 0.1), radius, 0.2, shade)
    pole(body, (0, 0, -drop - 0.2), radius * 0.8, 0.02, look.glow)
    return 2 * radius, 2 * radius


def globe(body: Body, rng: Rng, look: Look) -> Cover:
    """A glass globe on a short rod."""
    radius, drop = rng.uniform(0.13, 0.2), rng.uniform(0.2, 0.4)
    box(body, (0, 0, -drop / 2), (0.025, 0.025, drop), look.metal)
    ball(body, (0, 0, -drop - radius), (radius, radius, radius), look.glow)
    return 2 * radius, 2 * radius


def dish(body: Body, rng: Rng, look: Look) -> Cover:
    """A flat round lamp."""
    radius = rng.uniform(0.2, 0.32)
    pole(body, (0, 0, -0.04), radius, 0.08, look.metal)
    pole(body, (0, 0, -0.06), radius * 0.86, 0.08, look.glow)
    return 2 * radius, 2 * radius


def tube(body: Body, rng: Rng, look: Look) -> Cover:
    """A fluorescent lamp with two tubes, along x or y."""
    length = rng.uniform(1.1, 1.5)
    along = rng.random() < 0.5

    def size(a: float, b: float, c: float) -> tuple[float, float, float]:
        return (a, b, c) if along else (b, a, c)

    box(body, (0, 0, -0.04), size(length, 0.24, 0.08), look.white)
    for side in (-0.06, 0.06):
        middle = (0.0, side, -0.1) if along else (side, 0.0, -0.1)
        box(body, middle, size(length - 0.1, 0.04, 0.04), look.glow)
    return size(length, 0.24, 0)[:2]


def spots(body: Body, rng: Rng, look: Look) -> Cover:
    """A rail with three spot lamps that point in different directions."""
    box(body, (0, 0, -0.03), (1.0, 0.05, 0.04), look.black)
    for x in (-0.38, rng.uniform(-0.15, 0.15), 0.38):
        lamp = rng.uniform(-0.5, 0.5)
        box(body, (x, 0, -0.12), (0.09, 0.09, 0.14), look.metal, quat=turned(lamp, (1.0, 0.0, 0.0)))
        box(body, (x, 0.085 * np.sin(lamp), -0.2), (0.07, 0.07, 0.02), look.glow)
    return 1.0, 0.25


def chandelier(body: Body, rng: Rng, look: Look) -> Cover:
    """Crossed arms with a candle at each end."""
    drop, reach = rng.uniform(0.35, 0.5), rng.uniform(0.3, 0.4)
    box(body, (0, 0, -drop / 2), (0.03, 0.03, drop), look.metal)
    start = rng.uniform(0, np.pi / 2)
    for arm in (0.0, np.pi / 2):
        box(body, (0, 0, -drop), (2 * reach, 0.035, 0.035), look.metal, quat=turned(start + arm))
    for arm in np.arange(4) * np.pi / 2 + start:
        box(body, (reach * np.cos(arm), reach * np.sin(arm), -drop + 0.05), (0.06, 0.06, 0.12), look.glow)
    return 2 * reach, 2 * reach


def fan(body: Body, rng: Rng, look: Look) -> Cover:
    """A ceiling fan with four or five blades."""
    drop, reach = 0.28, rng.uniform(0.5, 0.62)
    box(body, (0, 0, -drop / 2), (0.03, 0.03, drop), look.metal)
    pole(body, (0, 0, -drop), 0.1, 0.12, look.metal)
    blades = int(rng.integers(4, 6))
    for blade in np.arange(blades) * 2 * np.pi / blades + rng.uniform(0, 1):
        at = (0.5 * reach * np.cos(blade), 0.5 * reach * np.sin(blade), -drop)
        box(body, at, (reach, 0.13, 0.015), look.dark_wood, quat=turned(blade))
    return 2 * reach, 2 * reach


def vent(body: Body, rng: Rng, look: Look) -> Cover:
    """A grille of slats."""
    width, depth = rng.uniform(0.3, 0.7), rng.uniform(0.25, 0.4)
    slats = paper(look.spec, textures.fins(rng, (64, 64), (0.55, 0.56, 0.58), int(rng.integers(5, 10))))
    box(body, (0, 0, -0.015), (width, depth, 0.03), slats)
    return width, depth


def smoke_detector(body: Body, rng: Rng, look: Look) -> Cover:
    """A small white disc with a red light."""
    pole(body, (0, 0, -0.025), 0.07, 0.05, look.white)
    box(body, (0.04, 0, -0.052), (0.02, 0.02, 0.01), paint(look.spec, (0.9, 0.1, 0.1), glow=0.8))
    return 0.14, 0.14


def hatch(body: Body, rng: Rng, look: Look) -> Cover:
    """A framed trapdoor to the attic."""
    width, depth = rng.uniform(0.6, 0.8), rng.uniform(0.6, 1.0)
    box(body, (0, 0, -0.01), (width, depth, 0.02), look.wood)
    box(body, (0, 0, -0.018), (width - 0.1, depth - 0.1, 0.02), look.cabinet)
    return width, depth


def panel_lamp(body: Body, rng: Rng, look: Look, side_m: float) -> Cover:
    """A square lamp of the size of a panel of the ceiling."""
    box(body, (0, 0, -0.01), (side_m, side_m, 0.02), look.white)
    box(body, (0, 0, -0.018), (side_m - 0.06, side_m - 0.06, 0.02), look.glow)
    return side_m, side_m


def beam(body: Body, rng: Rng, look: Look, size: tuple[float, float]) -> Cover:
    """A wooden beam; ``size`` is its extent along x and y [m]."""
    tall = rng.uniform(0.12, 0.2)
    box(body, (0, 0, -tall / 2), (*size, tall), look.dark_wood)
    return size


def duct(body: Body, rng: Rng, look: Look, size: tuple[float, float]) -> Cover:
    """A sheet-metal air duct; ``size`` is its extent along x and y [m]."""
    tall = rng.uniform(0.22, 0.32)
    box(body, (0, 0, -tall / 2 - 0.03), (*size, tall), look.metal)
    return size
