"""Storage furniture: bookshelf, wardrobe, cabinet, television bench, fridge, oven, shelving, filing cabinet."""

import itertools

import numpy as np

from sim.rooms.furniture import pictures, textures
from sim.rooms.furniture.primitives import Body, Footprint, Look, Rng, block, box, paper, pole


def bookshelf(body: Body, rng: Rng, look: Look, width_m: float = 1.0) -> Footprint:
    """An open bookcase full of books; each row of spines is one picture on one box."""
    depth, height, board = 0.32, rng.uniform(1.75, 2.15), 0.03
    wood = look.dark_wood if rng.random() < 0.5 else look.wood
    shelves = 5
    box(body, (0, depth / 2 - 0.01, height / 2), (width_m, 0.02, height), wood)
    for side in (-1, 1):
        box(body, (side * (width_m - board) / 2, 0, height / 2), (board, depth, height), wood)
    box(body, (0, 0, 0.04), (width_m, depth, 0.08), wood)
    box(body, (0, 0, height - board / 2), (width_m, depth, board), wood)
    heights = np.linspace(0.08, height - board, shelves + 1)
    for low, high in itertools.pairwise(heights):
        spines = paper(look.spec, pictures.books(rng, (56, 160)))
        inset = rng.uniform(0.02, 0.06)
        box(body, (0, inset / 2, (low + high) / 2), (width_m - 2 * board, depth - inset - 0.02, high - low), spines)
    block(body, (0, 0, height / 2), (width_m, depth, height))
    return Footprint(width_m, depth, height, front_m=0.4)


def wardrobe(body: Body, rng: Rng, look: Look, width_m: float = 1.5) -> Footprint:
    """A tall cupboard with two or three doors."""
    depth, height = 0.6, rng.uniform(2.0, 2.25)
    box(body, (0, 0.01, height / 2), (width_m, depth - 0.02, height), look.dark_wood)
    box(body, (0, 0, height + 0.02), (width_m + 0.04, depth + 0.02, 0.05), look.wood)
    doors = 3 if width_m > 1.4 else 2
    for door in range(doors):
        x = ((door + 0.5) / doors - 0.5) * width_m
        box(body, (x, -depth / 2, height / 2 + 0.03), (width_m / doors - 0.02, 0.03, height - 0.14), look.wood)
        box(body, (x + 0.35 * width_m / doors, -depth / 2 - 0.025, 1.05), (0.02, 0.02, 0.22), look.metal)
    block(body, (0, 0, height / 2), (width_m, depth, height))
    return Footprint(width_m + 0.04, depth + 0.04, height + 0.05, front_m=0.6)


def cabinet(body: Body, rng: Rng, look: Look, width_m: float = 1.2) -> Footprint:
    """A sideboard with doors, a vase and some books on it."""
    depth, height = 0.45, rng.uniform(0.8, 1.0)
    box(body, (0, 0.01, height / 2 + 0.03), (width_m, depth - 0.02, height - 0.06), look.wood)
    doors = max(int(width_m / 0.45), 2)
    for door in range(doors):
        x = ((door + 0.5) / doors - 0.5) * width_m
        box(
            body,
            (x, -depth / 2 + 0.005, height / 2 + 0.03),
            (width_m / doors - 0.03, 0.02, height - 0.14),
            look.cabinet,
        )
    block(body, (0, 0, height / 2), (width_m, depth, height))
    side = rng.choice((-1, 1))
    pole(body, (side * 0.3 * width_m, 0, height + 0.14), 0.07, 0.28, look.cushion)
    spines = paper(look.spec, pictures.books(rng, (48, 96)))
    box(body, (-side * 0.2 * width_m, 0.05, height + 0.12), (0.4, 0.2, 0.24), spines)
    return Footprint(width_m, depth, height + 0.28, front_m=0.45)


def television(body: Body, rng: Rng, look: Look) -> Footprint:
    """A television on a low bench."""
    width, depth, top, wide = rng.uniform(1.4, 1.8), 0.42, 0.5, rng.uniform(1.1, 1.3)
    tall = wide * 0.58
    box(body, (0, 0, top / 2 + 0.03), (width, depth, top - 0.06), look.dark_wood)
    for side in (-1, 1):
        box(body, (side * width / 4, -depth / 2 - 0.006, 0.28), (width / 2 - 0.06, 0.02, 0.32), look.cabinet)
    block(body, (0, 0, top / 2), (width, depth, top))
    box(body, (0, 0.02, top + 0.02), (0.5, 0.24, 0.04), look.black)
    box(body, (0, 0.06, top + 0.07), (0.1, 0.05, 0.1), look.black)
    lit = textures.framed(pictures.screen(rng, (96, 160)), (0.05, 0.05, 0.05), 0.05)
    box(body, (0, 0.05, top + 0.1 + tall / 2), (wide, 0.05, tall), paper(look.spec, lit, glow=0.6), solid=True)
    return Footprint(width, depth, top + 0.1 + tall, front_m=0.4)


def fridge(body: Body, rng: Rng, look: Look) -> Footprint:
    """A fridge with a freezer below, and a note on its door."""
    width, depth, height = 0.62, 0.66, rng.uniform(1.75, 1.95)
    box(body, (0, 0.02, height / 2), (width, depth - 0.04, height), look.white, solid=True)
    box(body, (0, -depth / 2 + 0.01, 0.33), (width - 0.01, 0.03, 0.58), look.metal)
    box(body, (0, -depth / 2 + 0.01, (0.65 + height) / 2), (width - 0.01, 0.03, height - 0.67), look.metal)
    for low, high in ((0.42, 0.58), (0.72, 1.15)):
        box(body, (-width / 2 + 0.06, -depth / 2 - 0.02, (low + high) / 2), (0.03, 0.03, high - low), look.black)
    note = paper(look.spec, pictures.sheet(rng, (64, 64)))
    box(body, (0.08, -depth / 2 - 0.01, 1.4), (0.22, 0.012, 0.28), note)
    return Footprint(width, depth, height, front_m=0.7)


def oven(body: Body, rng: Rng, look: Look) -> Footprint:
    """A tall cupboard with an oven and a microwave built in."""
    width, depth, height = 0.62, 0.62, rng.uniform(2.0, 2.15)
    box(body, (0, 0.02, height / 2), (width, depth - 0.04, height), look.cabinet, solid=True)
    box(body, (0, -depth / 2 + 0.015, 0.4), (width - 0.03, 0.02, 0.66), look.wood)
    box(body, (0, -depth / 2 + 0.01, 1.05), (width - 0.04, 0.03, 0.56), look.black)
    box(body, (0, -depth / 2 - 0.02, 1.26), (0.44, 0.02, 0.03), look.metal)
    box(body, (0, -depth / 2 + 0.01, 1.53), (width - 0.04, 0.03, 0.34), look.metal)
    box(body, (0, -depth / 2 + 0.015, (1.75 + height) / 2), (width - 0.03, 0.02, height - 1.78), look.wood)
    return Footprint(width, depth, height, front_m=0.7)


def shelving(body: Body, rng: Rng, look: Look, width_m: float = 1.3) -> Footprint:
    """An open metal rack with crates and tins."""
    depth, height = 0.45, rng.uniform(1.8, 2.2)
    for x in (-1, 1):
        for y in (-1, 1):
            box(body, (x * (width_m / 2 - 0.02), y * (depth / 2 - 0.02), height / 2), (0.04, 0.04, height), look.metal)
    for z in np.linspace(0.12, height - 0.05, 4):
        box(body, (0, 0, z), (width_m, depth, 0.03), look.metal)
        place = -width_m / 2 + 0.06
        while z < height - 0.3:
            wide, tall = rng.uniform(0.25, 0.5), rng.uniform(0.2, 0.38)
            if place + wide > width_m / 2 - 0.05:
                break
            crate = rng.choice((look.wood, look.cushion, look.second_fabric, look.cabinet, look.dark_wood))
            box(body, (place + wide / 2, 0, z + 0.015 + tall / 2), (wide, depth - 0.1, tall), crate)
            place += wide + rng.uniform(0.04, 0.15)
    block(body, (0, 0, height / 2), (width_m, depth, height))
    return Footprint(width_m, depth, height, front_m=0.5)


def filing_cabinet(body: Body, rng: Rng, look: Look) -> Footprint:
    """A steel cabinet with four drawers."""
    width, depth, height = 0.5, 0.6, 1.32
    drawers = paper(look.spec, textures.drawers(rng, (128, 48), 0.4 + 0.4 * textures.muted(rng), 4))
    box(body, (0, 0, height / 2), (width, depth, height), drawers, solid=True)
    if rng.random() < 0.6:
        box(body, (0, 0, height + 0.14), (0.4, 0.36, 0.28), look.cushion)
    return Footprint(width, depth, height + 0.28, front_m=0.5)


def tool_chest(body: Body, rng: Rng, look: Look) -> Footprint:
    """A mechanic's painted chest of drawers on castors."""
    width, depth, height = 0.7, 0.5, rng.uniform(0.95, 1.15)
    drawers = paper(look.spec, textures.drawers(rng, (96, 64), textures.vivid(rng), 6))
    box(body, (0, 0, height / 2 + 0.04), (width, depth, height - 0.08), drawers)
    box(body, (0, 0, height + 0.01), (width + 0.02, depth + 0.02, 0.03), look.black)
    block(body, (0, 0, height / 2), (width, depth, height))
    return Footprint(width, depth, height + 0.03, front_m=0.5)
