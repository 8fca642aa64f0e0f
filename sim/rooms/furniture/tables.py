"""Tables and worktops: dining, coffee and bedside table, desk, workbench, kitchen counter and island."""

import mujoco
import numpy as np

from sim.rooms.furniture import pictures, textures
from sim.rooms.furniture.primitives import Footprint, Look, ball, block, box, legs, paper, pole, turned

TABLE_TOP_M = 0.74
KNEES_M = 0.18
"""Distance from the middle of a desk to the middle of its knee space [m]."""


def dining_table(
    body: mujoco.MjsBody, rng: np.random.Generator, look: Look, width_m: float = 1.5, depth_m: float = 0.85
) -> Footprint:
    """A table on four legs, with a bowl of fruit."""
    box(body, (0, 0, TABLE_TOP_M - 0.02), (width_m, depth_m, 0.04), look.wood, solid=True)
    legs(body, width_m - 0.06, depth_m - 0.06, TABLE_TOP_M - 0.04, 0.07, look.wood)
    x = rng.uniform(-0.25, 0.25) * width_m
    pole(body, (x, 0, TABLE_TOP_M + 0.03), 0.15, 0.06, look.white)
    ball(body, (x, 0, TABLE_TOP_M + 0.08), (0.12, 0.12, 0.05), look.cushion)
    return Footprint(width_m, depth_m, TABLE_TOP_M)


def coffee_table(body: mujoco.MjsBody, rng: np.random.Generator, look: Look) -> Footprint:
    """A low table with a book on it and, between its legs, a shelf too low to drive under."""
    width, depth, top = rng.uniform(0.9, 1.15), rng.uniform(0.5, 0.6), 0.42
    box(body, (0, 0, top - 0.02), (width, depth, 0.04), look.dark_wood, solid=True)
    legs(body, width, depth, top - 0.04, 0.05, look.dark_wood)
    box(body, (0, 0, 0.14), (width - 0.1, depth - 0.04, 0.03), look.dark_wood, solid=True)
    box(body, (width * 0.2, 0, top + 0.015), (0.3, 0.2, 0.03), look.cushion, quat=turned(rng.uniform(-0.6, 0.6)))
    return Footprint(width, depth, top)


def bedside_table(body: mujoco.MjsBody, rng: np.random.Generator, look: Look) -> Footprint:
    """A small chest of two drawers with a lamp."""
    width, depth, top = 0.46, 0.4, rng.uniform(0.48, 0.58)
    box(body, (0, 0, top / 2), (width, depth, top), look.dark_wood, solid=True)
    for z in (0.3 * top, 0.75 * top):
        box(body, (0, -depth / 2 - 0.008, z), (width - 0.06, 0.016, 0.36 * top), look.wood)
    pole(body, (0, 0.03, top + 0.13), 0.02, 0.26, look.metal)
    pole(body, (0, 0.03, top + 0.34), 0.13, 0.2, look.glow)
    return Footprint(width, depth, top + 0.44)


def desk(body: mujoco.MjsBody, rng: np.random.Generator, look: Look, width_m: float = 1.4, side: int = 1) -> Footprint:
    """A desk with a drawer pedestal on one side, 1 or -1 along x, knee space on the other, and a computer."""
    depth, top = 0.7, 0.74
    box(body, (0, 0, top - 0.02), (width_m, depth, 0.04), look.wood, solid=True)
    drawers = paper(look.spec, textures.drawers(rng, (96, 64), 0.5 + 0.4 * textures.muted(rng), 3))
    box(body, (side * (width_m / 2 - 0.22), 0, 0.35), (0.4, depth - 0.08, 0.68), drawers, solid=True)
    box(body, (-side * (width_m / 2 - 0.03), 0, 0.35), (0.05, depth - 0.06, 0.7), look.dark_wood, solid=True)
    _computer(body, rng, look, rng.uniform(-0.15, 0.15) * width_m, top)
    return Footprint(width_m, depth, top + 0.5, front_m=0.35)


def workbench(body: mujoco.MjsBody, rng: np.random.Generator, look: Look, width_m: float = 1.8) -> Footprint:
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


def counter(body: mujoco.MjsBody, rng: np.random.Generator, look: Look, width_m: float = 2.4) -> Footprint:
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


def island(body: mujoco.MjsBody, rng: np.random.Generator, look: Look) -> Footprint:
    """A free-standing kitchen block."""
    width, depth = rng.uniform(1.1, 1.5), 0.7
    box(body, (0, 0, 0.44), (width - 0.1, depth - 0.1, 0.88), look.cabinet, solid=True)
    box(body, (0, 0, 0.91), (width, depth, 0.05), look.wood, solid=True)
    pole(body, (width * 0.25, 0, 1.03), 0.1, 0.2, look.metal)
    return Footprint(width, depth, 1.13)


def _cupboards(body: mujoco.MjsBody, rng: np.random.Generator, look: Look, width_m: float, hob_x: float) -> None:
    side = 1.0 if hob_x < 0 else -1.0
    inner, outer = hob_x + side * 0.33, side * width_m / 2
    span, middle = abs(outer - inner), (inner + outer) / 2
    top = rng.uniform(2.0, 2.15)
    box(body, (middle, 0.14, (1.4 + top) / 2), (span, 0.32, top - 1.4), look.cabinet, solid=True)
    doors = max(int(span / 0.45), 1)
    for door in range(doors):
        x = middle + ((door + 0.5) / doors - 0.5) * span
        box(body, (x, -0.03, (1.4 + top) / 2), (span / doors - 0.02, 0.02, top - 1.44), look.wood)


def _computer(body: mujoco.MjsBody, rng: np.random.Generator, look: Look, x: float, top_m: float) -> None:
    lit = textures.framed(pictures.screen(rng, (64, 96)), (0.05, 0.05, 0.05), 0.06)
    wide = rng.uniform(0.5, 0.68)
    box(body, (x, 0.16, top_m + 0.3), (wide, 0.04, 0.36), paper(look.spec, lit, glow=0.5))
    box(body, (x, 0.18, top_m + 0.07), (0.08, 0.04, 0.14), look.black)
    box(body, (x, -0.1, top_m + 0.01), (0.42, 0.14, 0.02), look.black)
